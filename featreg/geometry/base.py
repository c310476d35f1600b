"""What the models share: checked and normalised points, the linear part, the base classes."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from featreg.errors import InputError
from featreg.interfaces import FailedFit, Model
from featreg.types import FloatArray, read_only

#: Smallest ratio of the two spreads of a point set that still determines a model.
FLAT = 1e-6
#: Coordinates beyond this are no pixels; their squares would overflow long before float64 ends.
FARTHEST = 1e12


@dataclass(frozen=True, eq=False)
class Normalised:
    """Points and weights fit for a fit: checked, rows of weight 0 dropped, centred and scaled.

    `reference` and `secondary` (M, 2) have weighted mean 0 and weighted mean square length 1; the pixel coordinates are
    ``points * scale + centre``. `weights` (M,) have mean 1.
    """

    reference: FloatArray
    secondary: FloatArray
    weights: FloatArray
    reference_centre: FloatArray
    secondary_centre: FloatArray
    reference_scale: float
    secondary_scale: float


def normalise(
    reference_xy: ArrayLike, secondary_xy: ArrayLike, weights: ArrayLike | None, minimum: int, *, spread: bool = True
) -> Normalised | FailedFit:
    """Check and normalise the points of a fit.

    Parameters
    ----------
    reference_xy, secondary_xy : (M, 2) float64 px
    weights : (M,) of the squared residuals, or None for equal ones
    minimum : fewest points of positive weight
    spread : whether points that all coincide are a failure

    Returns
    -------
    The normalised points, or a `FailedFit` with the numbers that forbid a fit.

    Raises
    ------
    InputError
        The arrays do not fit together.
    """
    r, s = np.asarray(reference_xy, np.float64), np.asarray(secondary_xy, np.float64)
    if r.size == 0 and s.size == 0:
        return FailedFit(f"too few points: {minimum} needed, none given")
    if r.ndim != 2 or r.shape[1] != 2 or r.shape != s.shape:
        raise InputError(f"a fit needs two (M, 2) arrays of (x, y), got shapes {r.shape} and {s.shape}")
    w = np.ones(len(r)) if weights is None else np.asarray(weights, np.float64)
    if w.shape != (len(r),):
        raise InputError(f"a fit of {len(r)} points needs weights of shape ({len(r)},), got {w.shape}")
    from featreg.geometry.normalise_kernels import normalised

    here, there, scaled, numbers = np.empty(r.shape), np.empty(r.shape), np.empty(len(r)), np.zeros(6)
    r, s, w = np.ascontiguousarray(r), np.ascontiguousarray(s), np.ascontiguousarray(w)
    count = normalised(r, s, w, FARTHEST, here, there, scaled, numbers)
    if count < 0:
        usable = (np.abs(r) < FARTHEST).all(axis=1) & (np.abs(s) < FARTHEST).all(axis=1) & np.isfinite(w)
        if not usable.all():
            return FailedFit(f"{int((~usable).sum())} of {len(r)} points or weights are not finite")
        return FailedFit(f"{int((w < 0).sum())} of {len(r)} weights are negative")
    if count < max(minimum, 1):
        found = f"got {len(r)}" if count == len(r) else f"got {count}" if count else f"none of {len(r)}"
        return FailedFit(f"too few points: {minimum} needed, {found} of positive weight")
    rc, sc, (rs, ss) = numbers[:2], numbers[2:4], numbers[4:].tolist()
    for size, centre, image in ((rs, rc, "reference"), (ss, sc, "secondary")):
        if spread and size <= 1e-10 * (1.0 + np.abs(centre).max()):
            return FailedFit(f"the {count} {image} points coincide: spread {size:.3g} px")
    return Normalised(here[:count], there[:count], scaled[:count], rc, sc, rs or 1.0, ss or 1.0)


class LinearPart(NamedTuple):
    """What a (2, 2) linear part does.

    Parameters
    ----------
    rotation_deg : of the nearest rotation (polar decomposition), counter-clockwise as seen; NaN for a reflection
    scale : sqrt |det|
    anisotropy : ratio of the singular values, >= 1; inf where the part is flat
    shear_deg : by how many degrees the angle between the mapped axes falls short of 90
    """

    rotation_deg: float
    scale: float
    anisotropy: float
    shear_deg: float


def decompose(linear: ArrayLike) -> LinearPart:
    """Return what a (2, 2) linear part does: its rotation, scale, anisotropy and shear."""
    (a, b), (c, d) = np.asarray(linear, np.float64).tolist()
    det = a * d - b * c
    rotation = math.degrees(math.atan2(b - c, a + d)) if det > 0 else math.nan
    # Singular values are half the sum and half the difference of these two lengths.
    turn, squeeze = math.hypot(a + d, b - c), math.hypot(a - d, b + c)
    large, small = 0.5 * (turn + squeeze), 0.5 * abs(turn - squeeze)
    shear = math.degrees(math.atan2(a * b + c * d, abs(det)))
    return LinearPart(rotation, math.sqrt(abs(det)), large / small if small > 0 else math.inf, shear)


class DerivedModel(Model):
    """A model that follows from others and is never fitted by itself; `instead` says what to do."""

    minimum: ClassVar[int] = 0
    instead: ClassVar[str] = "fit the forward model and take its .inverse"

    @classmethod
    def from_estimate(
        cls, reference_xy: FloatArray, secondary_xy: FloatArray, weights: FloatArray | None = None
    ) -> NoReturn:
        """Refuse.

        Raises
        ------
        InputError
            Always.
        """
        raise InputError(f"{cls.__name__} is not fitted: {cls.instead}")


class MatrixModel(Model):
    """A model that is a matrix."""

    @property
    @abstractmethod
    def matrix(self) -> FloatArray:
        """The (3, 3) homogeneous matrix."""

    def __call__(self, xy: ArrayLike) -> FloatArray:
        p = np.asarray(xy, np.float64)
        out = np.empty_like(p)
        out[..., 0], out[..., 1] = self._mapped(p)
        return out

    def residuals(self, reference_xy: ArrayLike, secondary_xy: ArrayLike) -> FloatArray:
        if type(self).__call__ is not MatrixModel.__call__:
            return super().residuals(reference_xy, secondary_xy)
        q = np.asarray(secondary_xy, np.float64)
        x, y = self._mapped(np.asarray(reference_xy, np.float64))
        return np.asarray(np.hypot(x - q[..., 0], y - q[..., 1]))

    def _mapped(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The coordinates of points (..., 2) by the first two rows of the matrix."""
        x, y = p[..., 0], p[..., 1]
        along, down = self.matrix[:2].tolist()
        mapped = []
        for a, b, shift in (along, down):
            out = a * x
            out += b * y
            out += shift
            mapped.append(out)
        return mapped[0], mapped[1]

    def _linear(self) -> FloatArray:
        return self.matrix[:2, :2]

    @property
    def anisotropy(self) -> float:
        """Ratio of the singular values of the linear part, >= 1."""
        return decompose(self._linear()).anisotropy

    @property
    def shear_deg(self) -> float:
        """Degrees by which the angle between the mapped axes falls short of 90."""
        return decompose(self._linear()).shear_deg


def finite_numbers(model: Any, *names: str) -> None:
    for name in names:
        value = float(getattr(model, name))
        if not math.isfinite(value):
            raise InputError(f"{type(model).__name__}.{name} must be finite, got {value}")
        object.__setattr__(model, name, value)


def coefficient_array(values: ArrayLike, shape: tuple[int, ...], what: str) -> FloatArray:
    """Return `values` as a read-only finite float64 array of `shape`, or raise `InputError`."""
    array = np.array(values, np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise InputError(f"{what} must be a finite array of shape {shape}, got shape {array.shape}")
    return read_only(array)


class GeneralMatrixModel(MatrixModel):
    """A matrix whose rotation and scale are read off its linear part."""

    @property
    def rotation_deg(self) -> float:
        """Counter-clockwise as seen, of the nearest rotation; NaN for a reflection."""
        return decompose(self._linear()).rotation_deg

    @property
    def scale(self) -> float:
        """Square root of the magnification of areas."""
        return decompose(self._linear()).scale
