"""Tie points: pairs of homologous points of two images."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from featreg.errors import InputError
from featreg.runtime.optional import import_pandas
from featreg.runtime.showing import Shown, figure_of
from featreg.types.arrays import FloatArray, IntArray, ReadOnlyArrays, column, numbers, points, read_only


@dataclass(frozen=True, eq=False)
class Matches(ReadOnlyArrays, Shown):
    """Tie points: pairs of homologous points of the two images.

    Parameters
    ----------
    reference_xy, secondary_xy : (M, 2) float64 pixel coordinates
    score : (M,) float64, higher is better, NaN where unknown
    covariance : (M, 2, 2) float64 px^2 of the secondary position, or None
    origin : (M,) int64 row of the match that a refined one came from, else -1
    rotation : (M,) float64 radians, secondary minus reference feature angle, or None where unknown
    scale_ratio : (M,) float64 secondary over reference feature scale, or None where unknown
    """

    reference_xy: FloatArray
    secondary_xy: FloatArray
    score: FloatArray
    covariance: FloatArray | None = None
    origin: IntArray = -1  # type: ignore[assignment]  # one number stands for all rows until it is checked
    rotation: FloatArray | None = None
    scale_ratio: FloatArray | None = None

    if TYPE_CHECKING:
        # What it is given may be any numbers; what it holds are arrays of one kind.
        def __init__(
            self,
            reference_xy: ArrayLike,
            secondary_xy: ArrayLike,
            score: ArrayLike,
            covariance: ArrayLike | None = None,
            origin: ArrayLike = -1,
            rotation: ArrayLike | None = None,
            scale_ratio: ArrayLike | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "reference_xy", points(self.reference_xy, "Matches.reference_xy"))
        put(self, "secondary_xy", points(self.secondary_xy, "Matches.secondary_xy"))
        m = len(self.reference_xy)
        if len(self.secondary_xy) != m:
            raise InputError(f"as many reference as secondary points are needed, got {m} and {len(self.secondary_xy)}")
        put(self, "score", column(self.score, m, "Matches.score"))
        put(self, "origin", column(self.origin, m, "Matches.origin", np.int64))
        for name in ("rotation", "scale_ratio"):
            if getattr(self, name) is not None:
                put(self, name, column(getattr(self, name), m, f"Matches.{name}"))
        if self.covariance is not None:
            covariance = numbers(self.covariance, "Matches.covariance")
            if covariance.shape != (m, 2, 2):
                raise InputError(f"Matches.covariance must be ({m}, 2, 2), got {covariance.shape}")
            put(self, "covariance", read_only(covariance))

    @classmethod
    def empty(cls) -> Self:
        return cls(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))

    def __len__(self) -> int:
        return len(self.reference_xy)

    def __repr__(self) -> str:
        refined = int((self.origin >= 0).sum())
        more = [f"{refined} refined"] if refined else []
        more += ["with covariance"] if self.covariance is not None else []
        return f"Matches({', '.join([f'{len(self)} tie points', *more])})"

    def to_dataframe(self) -> Any:
        """Return a `pandas.DataFrame` of one row per tie point, with the columns of a result's table that are known."""
        xy = np.hstack([self.reference_xy, self.secondary_xy]).T
        names = ("reference_x", "reference_y", "secondary_x", "secondary_y")
        columns: dict[str, Any] = {**dict(zip(names, xy, strict=True)), "score": self.score, "origin": self.origin}
        if self.covariance is not None:
            columns |= {f"cov_{'xy'[i]}{'xy'[j]}": self.covariance[:, i, j] for i, j in ((0, 0), (0, 1), (1, 1))}
        columns |= {n: getattr(self, n) for n in ("rotation", "scale_ratio") if getattr(self, n) is not None}
        return import_pandas().DataFrame(columns)

    def plot(self, reference: Any = None, secondary: Any = None) -> Any:
        """Return a `matplotlib.figure.Figure` of the tie points, on the images where these are given.

        Parameters
        ----------
        reference, secondary : whatever `featreg.as_image` takes; without both, empty frames
        """
        return figure_of(self, reference=reference, secondary=secondary)

    def take(self, rows: NDArray[Any]) -> Self:
        """The matches of the given rows (indices or a bool mask), in that order."""
        return self._with_rows(rows)

    def appended(self, more: Matches) -> Matches:
        """These matches followed by `more`; covariances unknown on one side are NaN, other extras are dropped there."""

        def join(name: str, blank: tuple[int, ...]) -> FloatArray | None:
            a, b = getattr(self, name), getattr(more, name)
            if a is None and b is None:
                return None
            a = np.full((len(self), *blank), np.nan) if a is None else a
            b = np.full((len(more), *blank), np.nan) if b is None else b
            return read_only(np.concatenate([a, b]))

        return Matches(
            read_only(np.concatenate([self.reference_xy, more.reference_xy])),
            read_only(np.concatenate([self.secondary_xy, more.secondary_xy])),
            read_only(np.concatenate([self.score, more.score])),
            join("covariance", (2, 2)),
            read_only(np.concatenate([self.origin, more.origin])),
            join("rotation", ()),
            join("scale_ratio", ()),
        )
