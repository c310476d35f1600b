"""An affine map with a smooth local residual on top, for what no model of a few numbers follows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from featreg.errors import InputError
from featreg.geometry.base import DerivedModel, coefficient_array, normalise
from featreg.geometry.matrix import Affine
from featreg.interfaces import FailedFit, Model
from featreg.registry import register
from featreg.types import FloatArray, IntArray

#: Most cells along a side, and points that a cell should hold on average.
MOST_CELLS, POINTS_PER_CELL = 12, 8
#: Smoothing that is tried, relative to the weight of the points.
SMOOTHING = 10.0 ** np.arange(-4, 5)
#: Weight, relative to that of the points, that keeps coefficients that no point sees determined.
RIDGE = 1e-9
#: How many times the least miss of what is left out ends the search for a smoothing.
WORSE = 1.5
#: Squares along the longer side of the points' box that are left out together to judge a smoothing, and the folds of
#: them along either axis.
SQUARES, FOLDS = 6, 3


@register("residual-field")
@dataclass(frozen=True, eq=False)
class ResidualField(Model):
    """Affine map plus a smooth residual displacement, a penalised cubic B-spline on a regular grid.

    Parameters
    ----------
    matrix_rows : (2, 3) float64, the affine part, reference -> secondary pixels
    field : (2, R, C) float64 px, spline coefficients of the displacement along x and y; R, C >= 4
    frame : (left, top, right, bottom) reference px that the grid's cells span
    bound : largest displacement, px; None for the largest coefficient

    Raises
    ------
    InputError
        Another shape, a value that is not finite, an empty frame.

    Notes
    -----
    P-splines [1]_ in two dimensions: the second differences of neighbouring coefficients are penalised, by as much as
    foretells best the points of whole squares that are left out, each a sixth of the longer side. Points left out one
    by one would not do: windows that overlap share their errors, and a field that follows these foretells them. Grid
    cells hold about eight points each, at most 12 x 12. The frame is the box of the points; beyond it the displacement
    of the rim goes on, and no displacement exceeds the largest residual of the points from the affine part. Give it
    points without outliers, or fit it robustly.

    References
    ----------
    .. [1] P. Eilers, B. Marx, "Flexible smoothing with B-splines and penalties", Statist. Sci. 11(2), 1996,
       DOI 10.1214/ss/1038425655
    """

    matrix_rows: FloatArray
    field: FloatArray
    frame: tuple[float, float, float, float]
    bound: float | None = None
    minimum: ClassVar[int] = 16

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "matrix_rows", coefficient_array(self.matrix_rows, (2, 3), "ResidualField.matrix_rows"))
        shape = np.shape(self.field)
        if len(shape) != 3 or shape[0] != 2 or min(shape[1:]) < 4:
            raise InputError(f"ResidualField.field must be (2, R, C) with R, C >= 4, got shape {shape}")
        put(self, "field", coefficient_array(self.field, shape, "ResidualField.field"))
        left, top, right, bottom = coefficient_array(self.frame, (4,), "ResidualField.frame").tolist()
        if not (left < right and top < bottom):
            raise InputError(f"ResidualField.frame must be left < right and top < bottom, got {self.frame}")
        put(self, "frame", (left, top, right, bottom))
        put(self, "bound", float(np.hypot(*self.field).max() if self.bound is None else self.bound))
        if not (0 <= self.limit < np.inf):
            raise InputError(f"ResidualField.bound must be >= 0 px, got {self.bound}")

    @classmethod
    def from_estimate(
        cls, reference_xy: FloatArray, secondary_xy: FloatArray, weights: FloatArray | None = None
    ) -> Self | FailedFit:
        """Return the least-squares affine map and the smoothed residual from it."""
        n = normalise(reference_xy, secondary_xy, weights, cls.minimum)
        if isinstance(n, FailedFit):
            return n
        here = n.reference * n.reference_scale + n.reference_centre
        there = n.secondary * n.secondary_scale + n.secondary_centre
        plane = Affine.from_estimate(here, there, n.weights)
        if isinstance(plane, FailedFit):
            return plane
        low, high = here.min(axis=0), here.max(axis=0)
        residual = there - plane(here)
        side = np.sqrt(np.prod(high - low) * POINTS_PER_CELL / len(here))
        cells = np.clip(np.floor((high - low) / side), 1, MOST_CELLS).astype(int)
        shape = int(cells[1]) + 3, int(cells[0]) + 3
        frame = (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
        coefficients = _smoothed(here, frame, residual, n.weights, shape, _folds(here, low, high))
        if coefficients is None:
            return FailedFit(f"the {len(here)} points do not determine {shape[0]} x {shape[1]} coefficients")
        bound = float(np.hypot(*residual.T).max())
        return cls(plane.matrix[:2], coefficients.T.reshape(2, *shape), frame, bound)

    def __call__(self, xy: ArrayLike) -> FloatArray:
        p = np.asarray(xy, np.float64)
        flat = p.reshape(-1, 2)
        m = self.matrix_rows
        return (flat @ m[:, :2].T + m[:, 2] + self.displacement(flat)).reshape(p.shape)

    def displacement(self, xy: FloatArray) -> FloatArray:
        """(N, 2) px by which the residual moves the mapped (N, 2) reference points."""
        from featreg.geometry import residual_field_kernels as kernels

        lost = np.asarray(~np.isfinite(xy).all(axis=1))
        shape = self.field.shape[1], self.field.shape[2]
        moved = np.empty((len(xy), 2))
        first, values = _splines(np.where(lost[:, None], 0.0, xy), self.frame, shape)
        kernels.displaced(first, values, shape[1], self.field.reshape(2, -1).T.copy(), moved)
        size = np.hypot(*moved.T)
        moved *= np.minimum(1.0, self.limit / np.maximum(size, 1e-300))[:, None]
        moved[lost] = np.nan
        return moved

    @property
    def inverse(self) -> Model:
        return InverseField(self)

    @property
    def parameters(self) -> Mapping[str, Any]:
        return {
            "matrix_rows": self.matrix_rows.tolist(),
            "field": self.field.tolist(),
            "frame": list(self.frame),
            "bound": self.limit,
        }

    @property
    def limit(self) -> float:
        """Largest displacement in pixels; that of the coefficients where none was given."""
        return self.bound  # type: ignore[return-value]  # a number once it is checked


@dataclass(frozen=True, eq=False)
class InverseField(DerivedModel):
    """Secondary -> reference of a residual field, by fixed-point iteration; NaN where it does not settle."""

    forward: ResidualField

    def __call__(self, xy: ArrayLike) -> FloatArray:
        p = np.asarray(xy, np.float64)
        wanted = p.reshape(-1, 2)
        back = Affine(self.forward.matrix_rows).inverse
        found = back(wanted)
        step = np.full(len(found), np.inf)
        for _ in range(60):
            new = back(wanted - self.forward.displacement(found))
            step, found = np.abs(new - found).max(axis=1, initial=0.0), new
            if not (step > 1e-10).any():
                break
        found[~(step <= 1e-6)] = np.nan
        return found.reshape(p.shape)

    @property
    def inverse(self) -> ResidualField:
        return self.forward

    @property
    def parameters(self) -> Mapping[str, Any]:
        return {"forward": self.forward}


def _splines(
    xy: FloatArray, frame: tuple[float, float, float, float], shape: tuple[int, int]
) -> tuple[IntArray, FloatArray]:
    """(N, 2) numbers of the first column and row of splines that are not zero at each point, (N, 2, 4) values of four.

    Points outside the frame count as on its rim.
    """
    left, top, right, bottom = frame
    lines = _line(xy[:, 0], left, right, shape[1]), _line(xy[:, 1], top, bottom, shape[0])
    return np.stack([first for first, _ in lines], axis=1), np.stack([values for _, values in lines], axis=1)


def _line(at: FloatArray, start: float, stop: float, count: int) -> tuple[IntArray, FloatArray]:
    """(N,) number of the first of the four splines of `count` that are not zero at each point, (N, 4) their values."""
    cells = count - 3
    t = np.clip((at - start) / (stop - start), 0.0, 1.0) * cells
    first = np.minimum(np.floor(t), cells - 1).astype(np.int64)
    u = t - first
    values = np.stack([(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3], axis=1) / 6
    return first, values


def _smoothed(
    xy: FloatArray, frame: tuple[float, float, float, float], residual: FloatArray, weights: FloatArray,
    shape: tuple[int, int], fold: IntArray,
) -> FloatArray | None:  # fmt: skip
    """(R C, 2) coefficients at the smoothing that foretells best what lies in folds (N,) of the points left out."""
    from featreg.geometry import residual_field_kernels as kernels

    first, values = _splines(xy, frame, shape)
    out = np.empty((shape[0] * shape[1], 2))
    determined = kernels.smoothed(
        first, values, np.ascontiguousarray(residual), np.ascontiguousarray(weights), fold, shape[1], _penalty(shape),
        RIDGE, np.ascontiguousarray(SMOOTHING[::-1], np.float64), WORSE, out,
    )  # fmt: skip
    return out if determined else None


def _penalty(shape: tuple[int, int]) -> FloatArray:
    """(R C, 3 C + 4) band, as of the kernels, of the squared second differences of coefficients along both axes."""
    count = shape[0] * shape[1]
    band = np.zeros((count, 3 * shape[1] + 4))
    place = np.arange(count).reshape(shape)
    for step, first in ((1, place[:, :-2]), (shape[1], place[:-2])):
        for i, one in enumerate((1.0, -2.0, 1.0)):
            for j, other in enumerate((1.0, -2.0, 1.0)[i:]):
                band[first + i * step, j * step] += one * other
    return band


def _folds(xy: FloatArray, low: FloatArray, high: FloatArray) -> IntArray:
    """(N,) number of the fold of each point: squares, so that those of one fold lie apart."""
    side = float((high - low).max()) / SQUARES
    column, row = np.minimum((xy - low) / side, SQUARES - 1).astype(np.int64).T
    return np.asarray((row % FOLDS) * FOLDS + column % FOLDS)
