"""Translation, rigid, similarity and affine: linear maps with a closed-form least-squares fit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.geometry.base import (
    FLAT,
    GeneralMatrixModel,
    MatrixModel,
    Normalised,
    coefficient_array,
    decompose,
    finite_numbers,
    normalise,
)
from featreg.interfaces import FailedFit
from featreg.registry import register
from featreg.types import FloatArray


def _turning(rotation_deg: float, scale: float, dx: float, dy: float) -> FloatArray:
    # y points down: counter-clockwise as seen is exp(-j theta) on x + j y.
    c = scale * math.cos(math.radians(rotation_deg))
    s = scale * math.sin(math.radians(rotation_deg))
    return np.array([[c, s, dx], [-s, c, dy], [0.0, 0.0, 1.0]])


def _onto(linear: NDArray[Any], n: Normalised) -> tuple[float, float]:
    """The shift that takes the reference centre to the secondary centre."""
    dx, dy = n.secondary_centre - linear @ n.reference_centre
    return float(dx), float(dy)


@register("translation")
@dataclass(frozen=True)
class Translation(MatrixModel):
    """Shift by (dx, dy) pixels.

    Raises
    ------
    InputError
        A value is not finite.
    """

    dx: float
    dy: float
    minimum: ClassVar[int] = 1

    def __post_init__(self) -> None:
        finite_numbers(self, "dx", "dy")

    @classmethod
    def from_estimate(
        cls, reference_xy: FloatArray, secondary_xy: FloatArray, weights: FloatArray | None = None
    ) -> Self | FailedFit:
        """Return the difference of the weighted means."""
        n = normalise(reference_xy, secondary_xy, weights, cls.minimum, spread=False)
        return n if isinstance(n, FailedFit) else cls(*_onto(np.eye(2), n))

    @property
    def matrix(self) -> FloatArray:
        return _turning(0.0, 1.0, self.dx, self.dy)

    @property
    def inverse(self) -> Translation:
        return Translation(-self.dx, -self.dy)

    @property
    def parameters(self) -> Mapping[str, Any]:
        return {"dx": self.dx, "dy": self.dy}

    @property
    def rotation_deg(self) -> float:
        """0."""
        return 0.0

    @property
    def scale(self) -> float:
        """1."""
        return 1.0


@register("rigid")
@dataclass(frozen=True)
class Rigid(MatrixModel):
    """Rotation and shift without zoom, the constrained least squares of SAR co-registration.

    Parameters
    ----------
    rotation_deg : counter-clockwise as seen on the displayed image
    dx, dy : shift of the pixel (0, 0) in pixels; `shift_at` gives it anywhere else, at the image centre for example

    Raises
    ------
    InputError
        A value is not finite.

    Notes
    -----
    With z = x + j y the model is s = alpha z + delta under |alpha| = 1 (Eq. 2 of [1]_, solved in [2]_). Its closed
    form with weights w of the squared residuals: alpha = u / |u|, u = sum w conj(z - zm) (s - sm),
    delta = sm - alpha zm, with the weighted means zm and sm. The paper's weights multiply the equations, so they are
    the square roots of these; its coordinates start at the image centre, which changes delta but neither alpha nor
    the residuals.

    References
    ----------
    .. [1] L. Pallotta, G. Giunta, C. Clemente, J. J. Soraghan, "SAR coregistration by robust selection of extended
       targets and iterative outlier cancellation", IEEE Geosci. Remote Sens. Lett.
    .. [2] L. Pallotta, G. Giunta, C. Clemente, "SAR image registration in the presence of rotation and translation: a
       constrained least squares approach", IEEE Geosci. Remote Sens. Lett. 18(9), 1595-1599, 2021
    """

    rotation_deg: float
    dx: float = 0.0
    dy: float = 0.0
    minimum: ClassVar[int] = 2

    def __post_init__(self) -> None:
        finite_numbers(self, "rotation_deg", "dx", "dy")

    @classmethod
    def from_estimate(
        cls, reference_xy: FloatArray, secondary_xy: FloatArray, weights: FloatArray | None = None
    ) -> Self | FailedFit:
        """Return the constrained least-squares model; see the class for the formula."""
        n = normalise(reference_xy, secondary_xy, weights, cls.minimum)
        if isinstance(n, FailedFit):
            return n
        u = _correlation(n)
        if abs(u) <= 1e-9:
            return FailedFit(f"no rotation fits better than another: the points correlate by {abs(u):.3g} of 1")
        rotation = -math.degrees(math.atan2(u.imag, u.real))
        return cls(rotation, *_onto(_turning(rotation, 1.0, 0.0, 0.0)[:2, :2], n))

    @property
    def matrix(self) -> FloatArray:
        return _turning(self.rotation_deg, 1.0, self.dx, self.dy)

    @property
    def inverse(self) -> Rigid:
        back = _turning(-self.rotation_deg, 1.0, 0.0, 0.0)[:2, :2]
        dx, dy = -(back @ (self.dx, self.dy))
        return Rigid(-self.rotation_deg, float(dx), float(dy))

    @property
    def parameters(self) -> Mapping[str, Any]:
        return {"rotation_deg": self.rotation_deg, "dx": self.dx, "dy": self.dy}

    @property
    def scale(self) -> float:
        """1."""
        return 1.0


@register("similarity")
@dataclass(frozen=True)
class Similarity(MatrixModel):
    """Rotation, one scale and shift.

    Parameters
    ----------
    rotation_deg : counter-clockwise as seen on the displayed image
    scale : secondary over reference lengths, > 0
    dx, dy : shift of the pixel (0, 0) in pixels

    Raises
    ------
    InputError
        A value is not finite, or the scale is not positive.
    """

    rotation_deg: float
    scale: float = 1.0
    dx: float = 0.0
    dy: float = 0.0
    minimum: ClassVar[int] = 2

    def __post_init__(self) -> None:
        finite_numbers(self, "rotation_deg", "scale", "dx", "dy")
        if self.scale <= 0:
            raise InputError(f"Similarity.scale must be > 0, got {self.scale}")

    @classmethod
    def from_estimate(
        cls, reference_xy: FloatArray, secondary_xy: FloatArray, weights: FloatArray | None = None
    ) -> Self | FailedFit:
        """Return the complex-linear least-squares model s = a z + b."""
        n = normalise(reference_xy, secondary_xy, weights, cls.minimum)
        if isinstance(n, FailedFit):
            return n
        u = _correlation(n)
        if abs(u) <= 1e-9:
            return FailedFit(f"no rotation fits better than another: the points correlate by {abs(u):.3g} of 1")
        rotation, scale = -math.degrees(math.atan2(u.imag, u.real)), abs(u) * n.secondary_scale / n.reference_scale
        return cls(rotation, scale, *_onto(_turning(rotation, scale, 0.0, 0.0)[:2, :2], n))

    @property
    def matrix(self) -> FloatArray:
        return _turning(self.rotation_deg, self.scale, self.dx, self.dy)

    @property
    def inverse(self) -> Similarity:
        back = _turning(-self.rotation_deg, 1.0 / self.scale, 0.0, 0.0)[:2, :2]
        dx, dy = -(back @ (self.dx, self.dy))
        return Similarity(-self.rotation_deg, 1.0 / self.scale, float(dx), float(dy))

    @property
    def parameters(self) -> Mapping[str, Any]:
        return {"rotation_deg": self.rotation_deg, "scale": self.scale, "dx": self.dx, "dy": self.dy}


def _correlation(n: Normalised) -> complex:
    """Mean of w conj(z) s of the normalised points; its modulus is 1 where a similarity fits exactly."""
    z, s = n.reference @ (1, 1j), n.secondary @ (1, 1j)
    return complex((n.weights * z.conj()) @ s) / len(z)


def _well_spread(n: Normalised) -> FloatArray | None:
    """(2, 2) least-squares solution secondary = reference @ solution by its normal equations; None of a thin set."""
    weighted = (n.reference * n.weights[:, None]).T
    (a, b), (_, d) = (weighted @ n.reference).tolist()
    determinant = a * d - b * b
    # Spreads in the ratio of about 1 to 20: two digits less than by orthogonal steps, of sixteen.
    if not determinant > 2.5e-3 * (a + d) ** 2:
        return None
    return np.asarray(np.array([[d, -b], [-b, a]]) @ (weighted @ n.secondary) / determinant)


@register("affine")
@dataclass(frozen=True, eq=False)
class Affine(GeneralMatrixModel):
    """Linear map and shift: ``xy @ coefficients[:, :2].T + coefficients[:, 2]``.

    Parameters
    ----------
    coefficients : (2, 3) float64

    Raises
    ------
    InputError
        Another shape, a value that is not finite, or a map that cannot be inverted.
    """

    coefficients: FloatArray
    minimum: ClassVar[int] = 3

    def __post_init__(self) -> None:
        c = coefficient_array(self.coefficients, (2, 3), "Affine.coefficients")
        if not decompose(c[:, :2]).anisotropy < 1e12:
            raise InputError(f"an affine model must be invertible, got the linear part {c[:, :2].tolist()}")
        object.__setattr__(self, "coefficients", c)

    @classmethod
    def from_estimate(
        cls, reference_xy: FloatArray, secondary_xy: FloatArray, weights: FloatArray | None = None
    ) -> Self | FailedFit:
        """Return the linear least-squares model."""
        n = normalise(reference_xy, secondary_xy, weights, cls.minimum)
        if isinstance(n, FailedFit):
            return n
        solution = _well_spread(n)
        if solution is None:
            root = np.sqrt(n.weights)[:, None]
            found, _, _, singular = np.linalg.lstsq(root * n.reference, root * n.secondary, rcond=None)
            if singular[1] < FLAT * singular[0]:
                spreads = singular[1] / singular[0]
                return FailedFit(f"the {len(root)} reference points lie on a line: spreads in the ratio {spreads:.3g}")
            solution = np.asarray(found, np.float64)
        flatness = decompose(solution).anisotropy
        if not flatness < 1 / FLAT:
            return FailedFit(f"the fit maps the plane onto a line: singular values in the ratio {1 / flatness:.3g}")
        linear = solution.T * (n.secondary_scale / n.reference_scale)
        return cls(np.column_stack([linear, _onto(linear, n)]))

    @property
    def matrix(self) -> FloatArray:
        whole = np.zeros((3, 3))
        whole[:2], whole[2, 2] = self.coefficients, 1.0
        return whole

    @property
    def inverse(self) -> Affine:
        (a, b, dx), (c, d, dy) = self.coefficients
        back = np.array([[d, -b], [-c, a]]) / (a * d - b * c)
        return Affine(np.column_stack([back, -(back @ (dx, dy))]))

    @property
    def parameters(self) -> Mapping[str, Any]:
        return {"coefficients": self.coefficients.tolist()}
