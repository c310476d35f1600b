"""Polynomials of degree 2 and 3, and their inverse by Newton's iteration."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from featreg.errors import InputError
from featreg.geometry.base import DerivedModel, coefficient_array, decompose, normalise
from featreg.geometry.least_squares import least_squares
from featreg.interfaces import FailedFit, Model
from featreg.registry import register
from featreg.types import FloatArray

#: Largest condition number of the (normalised, equilibrated) design that still determines the coefficients.
ILL = 1e7


class Polynomial(Model):
    """Polynomial in u = (x - centre_x) / scale and v = (y - centre_y) / scale, with values in secondary pixels.

    Subclasses hold `coefficients` (2, terms), `centre` (2,) px and `scale` px; the terms are
    1, u, v, u^2, u v, v^2, u^3, u^2 v, u v^2, v^3 up to the degree.
    """

    coefficients: FloatArray
    centre: tuple[float, float]
    scale: float

    @property
    @abstractmethod
    def degree(self) -> int:
        """2 or 3."""

    @classmethod
    def from_estimate(
        cls, reference_xy: FloatArray, secondary_xy: FloatArray, weights: FloatArray | None = None
    ) -> Self | FailedFit:
        """Return the linear least-squares model; points on a curve of the degree, which leave it open, fail."""
        n = normalise(reference_xy, secondary_xy, weights, cls.minimum)
        if isinstance(n, FailedFit):
            return n
        terms = polynomial_terms(n.reference, cls.minimum)
        length = np.sqrt(n.weights @ (terms * terms) / len(terms))
        root = np.sqrt(n.weights)[:, None]
        if not length.all():
            return FailedFit(f"the {len(terms)} reference points lie on a line")
        solution, singular = least_squares(root * terms / length, root * n.secondary)
        if singular[-1] * ILL < singular[0]:
            return FailedFit(
                f"the {len(terms)} reference points do not determine {cls.minimum} terms (on a line or another curve "
                f"of the degree): singular values in the ratio {singular[-1] / singular[0]:.3g}"
            )
        coefficients = (solution / length[:, None]).T * n.secondary_scale
        coefficients[:, 0] += n.secondary_centre
        flatness = decompose(coefficients[:, 1:3]).anisotropy
        if not flatness < 1e6:
            return FailedFit(f"the fit maps the plane onto a line: singular values in the ratio {1 / flatness:.3g}")
        x, y = n.reference_centre.tolist()
        return cls(coefficients=coefficients, centre=(x, y), scale=n.reference_scale)  # type: ignore[call-arg]  # a field of the classes derived from this one

    def __call__(self, xy: ArrayLike) -> FloatArray:
        p = np.asarray(xy, np.float64)
        u, v = (p[..., 0] - self.centre[0]) / self.scale, (p[..., 1] - self.centre[1]) / self.scale
        out = np.empty_like(p)
        for axis, c in enumerate(self.coefficients):
            if self.degree == 2:
                out[..., axis] = c[0] + v * (c[2] + v * c[5]) + u * (c[1] + v * c[4] + u * c[3])
            else:
                slope = c[1] + v * (c[4] + v * c[8]) + u * (c[3] + v * c[7] + u * c[6])
                out[..., axis] = c[0] + v * (c[2] + v * (c[5] + v * c[9])) + u * slope
        return out

    def jacobian(self, xy: FloatArray) -> FloatArray:
        """(N, 2, 2) derivative of the secondary by the reference coordinates at (N, 2) reference points."""
        p = np.asarray(xy, np.float64)
        u, v = (p[:, 0] - self.centre[0]) / self.scale, (p[:, 1] - self.centre[1]) / self.scale
        out = np.empty((len(p), 2, 2))
        for axis, c in enumerate(self.coefficients):
            out[:, axis, 0] = c[1] + 2 * c[3] * u + c[4] * v
            out[:, axis, 1] = c[2] + c[4] * u + 2 * c[5] * v
            if self.degree == 3:
                out[:, axis, 0] += 3 * c[6] * u * u + 2 * c[7] * u * v + c[8] * v * v
                out[:, axis, 1] += c[7] * u * u + 2 * c[8] * u * v + 3 * c[9] * v * v
        return out / self.scale

    @property
    def inverse(self) -> InverseModel:
        return InverseModel(self)

    @property
    def parameters(self) -> Mapping[str, Any]:
        return {"coefficients": self.coefficients.tolist(), "centre": list(self.centre), "scale": self.scale}

    def _check(self) -> None:
        name, put = type(self).__name__, object.__setattr__
        put(self, "coefficients", coefficient_array(self.coefficients, (2, self.minimum), f"{name}.coefficients"))
        x, y = coefficient_array(self.centre, (2,), f"{name}.centre").tolist()
        put(self, "centre", (x, y))
        put(self, "scale", float(self.scale))
        if not (self.scale > 0 and math.isfinite(self.scale)):
            raise InputError(f"{name}.scale must be > 0, got {self.scale}")


def polynomial_terms(points: FloatArray, count: int) -> FloatArray:
    """(N, count) values of the first `count` terms at (N, 2) normalised points; 6 for degree 2, 10 for degree 3."""
    u, v = points.T
    quadratic = [np.ones_like(u), u, v, u * u, u * v, v * v]
    cubic = [] if count == 6 else [u**3, u * u * v, u * v * v, v**3]
    return np.column_stack(quadratic + cubic)


@register("polynomial2")
@dataclass(frozen=True, eq=False)
class Polynomial2(Polynomial):
    """Polynomial of degree 2.

    Parameters
    ----------
    coefficients : (2, 6) float64 secondary px per term 1, u, v, u^2, u v, v^2
    centre, scale : px; u = (x - centre[0]) / scale, v = (y - centre[1]) / scale

    Raises
    ------
    InputError
        Another shape, a value that is not finite, a scale that is not positive.
    """

    coefficients: FloatArray
    centre: tuple[float, float] = (0.0, 0.0)
    scale: float = 1.0
    minimum: ClassVar[int] = 6

    def __post_init__(self) -> None:
        self._check()

    @property
    def degree(self) -> int:
        return 2


@register("polynomial3")
@dataclass(frozen=True, eq=False)
class Polynomial3(Polynomial):
    """Polynomial of degree 3.

    Parameters
    ----------
    coefficients : (2, 10) float64 secondary px per term 1, u, v, u^2, u v, v^2, u^3, u^2 v, u v^2, v^3
    centre, scale : px; u = (x - centre[0]) / scale, v = (y - centre[1]) / scale

    Raises
    ------
    InputError
        Another shape, a value that is not finite, a scale that is not positive.
    """

    coefficients: FloatArray
    centre: tuple[float, float] = (0.0, 0.0)
    scale: float = 1.0
    minimum: ClassVar[int] = 10

    def __post_init__(self) -> None:
        self._check()

    @property
    def degree(self) -> int:
        return 3


@dataclass(frozen=True, eq=False)
class InverseModel(DerivedModel):
    """Secondary -> reference of a polynomial, by Newton's iteration from its linear part.

    Points that the forward model does not reach, or where the iteration does not converge, are NaN.
    The inverse of this model is the forward one.
    """

    forward: Polynomial

    def __call__(self, xy: ArrayLike) -> FloatArray:
        wanted = np.asarray(xy, np.float64)
        flat = wanted.reshape(-1, 2)
        model = self.forward
        centre = np.array([model.centre])
        found = centre + (flat - model(centre)) @ np.linalg.pinv(model.jacobian(centre)[0]).T
        # Two orders above the rounding of the coordinates involved, in reference pixels.
        tolerance = 1e-14 * (np.abs(flat).max(initial=1.0) + model.scale + np.abs(centre).max())
        converged = np.zeros(len(flat), bool)
        with np.errstate(all="ignore"):
            for _ in range(30):
                open_ = np.flatnonzero(~converged)
                if not len(open_):
                    break
                step = _solve(model.jacobian(found[open_]), flat[open_] - model(found[open_]))
                found[open_] += step
                converged[open_] = np.abs(step).max(axis=1) < max(tolerance, 1e-10)
        found[~converged] = np.nan
        return found.reshape(wanted.shape)

    @property
    def inverse(self) -> Model:
        return self.forward

    @property
    def parameters(self) -> Mapping[str, Any]:
        return {"forward": self.forward}


def _solve(linear: FloatArray, right: FloatArray) -> FloatArray:
    """Solve (N, 2, 2) systems by Cramer's rule; singular ones give values that are not finite."""
    a, b, c, d = linear[:, 0, 0], linear[:, 0, 1], linear[:, 1, 0], linear[:, 1, 1]
    e, f = right.T
    return np.asarray(np.column_stack([d * e - b * f, a * f - c * e]) / (a * d - b * c)[:, None])
