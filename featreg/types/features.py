"""The keypoints of one image and their descriptors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from featreg.errors import InputError
from featreg.runtime.optional import import_pandas
from featreg.runtime.showing import Shown
from featreg.types import keypoints as opencv_keypoints
from featreg.types import lafs as kornia_lafs
from featreg.types.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    ReadOnlyArrays,
    column,
    finite,
    kept,
    points,
    read_only,
)

if TYPE_CHECKING:
    from torch import Tensor

#: Column -> kind of its numbers, beside the points themselves; of descriptors the norm decides.
COLUMNS: Mapping[str, Any] = {
    "scale": np.float64,
    "angle": np.float64,
    "score": np.float64,
    "level": np.int64,
    "descriptors": None,
    "index": np.int64,
    "subpixel": np.bool_,
}
OPTIONAL = ("descriptors", "index", "subpixel")


@dataclass(frozen=True, eq=False)
class Features(ReadOnlyArrays, Shown):
    """Keypoints of one image and, once described, their descriptors.

    Parameters
    ----------
    xy : (N, 2) float64 pixel coordinates
    scale : (N,) float64 radius in pixels of the support from which the point is described
    angle : (N,) float64 radians, counter-clockwise as seen
    score : (N,) float64, higher is better
    level : (N,) int64 pyramid level or octave
    descriptors : (N, D) float32, or uint8 holding packed bits, or None before description
    norm : "l2" or "hamming", of the descriptors
    index : (N,) int64 rows of the features a descriptor was given, where it dropped or doubled some; else None
    subpixel : (N,) bool, False where the sub-pixel position could not be found and is that of the pixel; else None
    """

    xy: FloatArray
    scale: FloatArray
    angle: FloatArray
    score: FloatArray
    level: IntArray
    descriptors: NDArray[np.float32] | NDArray[np.uint8] | None = None
    norm: str = "l2"
    index: IntArray | None = None
    subpixel: BoolArray | None = None

    if TYPE_CHECKING:
        # What it is given may be any numbers; what it holds are arrays of one kind.
        def __init__(
            self,
            xy: ArrayLike,
            scale: ArrayLike,
            angle: ArrayLike,
            score: ArrayLike,
            level: ArrayLike,
            descriptors: NDArray[np.float32] | NDArray[np.uint8] | None = None,
            norm: str = "l2",
            index: ArrayLike | None = None,
            subpixel: ArrayLike | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        object.__setattr__(self, "xy", points(self.xy, "Features.xy"))
        if self.norm not in ("l2", "hamming"):
            raise InputError(f"Features.norm must be 'l2' or 'hamming', got '{self.norm}'")
        self.__dict__.update(self._checked({name: vars(self)[name] for name in COLUMNS}, self.norm))

    def _checked(self, columns: Mapping[str, Any], norm: str) -> dict[str, Any]:
        """Columns of these points as they are kept, descriptors of that norm; None stays None where it may be."""
        n = len(self.xy)
        checked: dict[str, Any] = {}
        for name, values in columns.items():
            if values is None and name in OPTIONAL:
                checked[name] = None
            elif name == "descriptors":
                checked[name] = _descriptors(values, n, norm)
            else:
                what = f"Features.{name}"
                held = column(values, n, what, COLUMNS[name])
                checked[name] = finite(held, what) if COLUMNS[name] is np.float64 else held
        return checked

    @classmethod
    def empty(cls) -> Self:
        none = np.zeros(0)
        return cls(xy=np.zeros((0, 2)), scale=none, angle=none, score=none, level=np.zeros(0, np.int64))

    @classmethod
    def concatenate(cls, parts: Sequence[Features]) -> Features:
        """The undescribed features of all parts, one after the other."""
        if not parts:
            return cls.empty()
        names = ["xy", "scale", "angle", "score", "level"]
        names += [] if any(part.subpixel is None for part in parts) else ["subpixel"]
        columns: dict[str, Any] = {
            name: read_only(np.concatenate([getattr(part, name) for part in parts])) for name in names
        }
        return cls(**columns)

    def __len__(self) -> int:
        return len(self.xy)

    def __repr__(self) -> str:
        return f"Features({len(self)} points, {self.described_as})"

    @property
    def described_as(self) -> str:
        """The form of the descriptors in words."""
        if self.descriptors is None:
            return "not described"
        form = "numbers" if self.norm == "l2" else "bytes of packed bits"
        return f"descriptors of {self.descriptors.shape[1]} {form}"

    def to_dataframe(self) -> Any:
        """Return a `pandas.DataFrame` of one row per point: x, y, scale, angle, score, level, subpixel if known."""
        columns: dict[str, Any] = {"x": self.xy[:, 0], "y": self.xy[:, 1]}
        columns |= {name: getattr(self, name) for name in ("scale", "angle", "score", "level")}
        columns |= {} if self.subpixel is None else {"subpixel": self.subpixel}
        return import_pandas().DataFrame(columns)

    def take(self, rows: NDArray[Any], **new: Any) -> Self:
        """The features of the given rows (indices or a bool mask), in that order; with other columns where given."""
        found = self._with_rows(rows)
        return found.having(**new) if new else found

    def having(self, **new: Any) -> Self:
        """The same points with other columns; only these are checked. Other points (`xy`) are other features."""
        if "xy" in new or not new.keys() <= self.__dict__.keys():
            return replace(self, **new)
        norm = new.pop("norm", self.norm)
        if norm != self.norm and self.descriptors is not None and "descriptors" not in new:
            return replace(self, norm=norm, **new)
        if norm not in ("l2", "hamming"):
            raise InputError(f"Features.norm must be 'l2' or 'hamming', got '{norm}'")
        return self._with_columns({**self._checked(new, norm), "norm": norm})

    def best(self, count: int) -> Self:
        """At most `count` features of the highest score, best first, ties in the order given."""
        if len(self) <= count and (self.score[1:] <= self.score[:-1]).all():
            return self
        return self.take(np.argsort(-self.score, kind="stable")[:count])

    def to_keypoints(self, *, octave: ArrayLike | None = None, class_id: ArrayLike = -1) -> list[Any]:
        """As `cv2.KeyPoint` (size = diameter, angle in degrees clockwise as OpenCV has it).

        `octave` and `class_id` are (N,) or one int for the fields of that name; without `octave` the low byte of
        `level`.
        """
        low = self.level & 255 if octave is None else octave
        return opencv_keypoints.to_keypoints(self.xy, self.scale, self.angle, self.score, low, class_id)

    @classmethod
    def from_keypoints(cls, keypoints: Sequence[Any], descriptors: NDArray[Any] | None = None) -> Self:
        """From N `cv2.KeyPoint` and (N, D) descriptors; the inverse of `to_keypoints`.

        Raises
        ------
        InputError
            The number of descriptors is not N.
        """
        return cls(**opencv_keypoints.from_keypoints(keypoints, descriptors))

    def to_lafs(self) -> Tensor:
        """As (1, N, 2, 3) float64 local affine frames of kornia; see `featreg.types.lafs`."""
        return kornia_lafs.to_lafs(self.xy, self.scale, self.angle)

    @classmethod
    def from_lafs(cls, lafs: Tensor, score: Any = None, descriptors: Any = None) -> Self:
        """From kornia's local affine frames; the inverse of `to_lafs`, in which an elongated frame becomes a circle.

        Raises
        ------
        InputError
            Frames of another shape than (1, N, 2, 3) or (N, 2, 3).
        """
        return cls(**kornia_lafs.from_lafs(lafs, score, descriptors))


def _descriptors(given: Any, rows: int, norm: str) -> NDArray[Any]:
    """The descriptors as they are kept, or an `InputError`."""
    wanted = np.float32 if norm == "l2" else np.uint8
    if not isinstance(given, np.ndarray):
        raise InputError(f"descriptors must be ({rows}, D) {np.dtype(wanted)}, got {type(given).__name__}")
    if given.ndim != 2 or len(given) != rows or given.dtype != wanted:
        raise InputError(f"descriptors must be ({rows}, D) {np.dtype(wanted)}, got {given.dtype} {given.shape}")
    return kept(given)
