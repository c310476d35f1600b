"""Homography: normalised direct linear transform, then Gauss-Newton on the reprojection error."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from featreg.errors import InputError
from featreg.geometry.base import FLAT, GeneralMatrixModel, Normalised, coefficient_array, normalise
from featreg.geometry.least_squares import triangle
from featreg.interfaces import FailedFit
from featreg.registry import register
from featreg.types import FloatArray

# Least volume (see `_volume`) of a matrix that is taken for invertible.
LEAST_VOLUME = 1e-15


@register("homography")
@dataclass(frozen=True, eq=False)
class Homography(GeneralMatrixModel):
    """Projective map of the plane.

    Parameters
    ----------
    coefficients : (3, 3) float64, homogeneous

    Raises
    ------
    InputError
        Another shape, a value that is not finite, or a map that cannot be inverted.

    Notes
    -----
    `rotation_deg`, `scale`, `anisotropy` and `shear_deg` describe the map around the reference pixel (0, 0);
    `featreg.geometry.local_linear` gives the linear part anywhere else. A point on the horizon maps to infinity.
    """

    coefficients: FloatArray
    minimum: ClassVar[int] = 4

    def __post_init__(self) -> None:
        c = coefficient_array(self.coefficients, (3, 3), "Homography.coefficients")
        if _volume(c) < LEAST_VOLUME:
            raise InputError(f"a homography must be invertible, got {c.tolist()}")
        object.__setattr__(self, "coefficients", c)

    @classmethod
    def from_estimate(
        cls, reference_xy: FloatArray, secondary_xy: FloatArray, weights: FloatArray | None = None
    ) -> Self | FailedFit:
        """Return the least-squares model of the reprojection error in the secondary image.

        Notes
        -----
        The normalised direct linear transform (R. Hartley, "In defense of the eight-point algorithm", IEEE TPAMI
        19(6), 1997, DOI 10.1109/34.601246) gives the start, Gauss-Newton steps the minimum.
        """
        n = normalise(reference_xy, secondary_xy, weights, cls.minimum)
        if isinstance(n, FailedFit):
            return n
        h = _direct_linear(n)
        if isinstance(h, FailedFit):
            return h
        h = _reprojection_minimum(h, n)
        depth = n.reference @ h[2, :2] + h[2, 2]
        if depth.min() <= 0:
            return FailedFit(
                f"the horizon of the fit runs between the points: depths {depth.min():.3g}..{depth.max():.3g}"
            )
        condition = np.linalg.cond(h)
        if not condition < 1 / FLAT:
            return FailedFit(f"the fit maps the plane onto a line: condition number {condition:.3g}")
        back = np.diag([n.secondary_scale, n.secondary_scale, 1.0])
        back[:2, 2] = n.secondary_centre
        there = np.diag([1 / n.reference_scale, 1 / n.reference_scale, 1.0])
        there[:2, 2] = -n.reference_centre / n.reference_scale
        found = _unit_corner(back @ h @ there)
        if _volume(found) < LEAST_VOLUME:
            return FailedFit("the fit maps the plane onto a line as seen from the origin of the coordinates")
        return cls(found)

    def __call__(self, xy: ArrayLike) -> FloatArray:
        p = np.asarray(xy, np.float64)
        h = self.coefficients
        x, y = p[..., 0], p[..., 1]
        out = np.empty_like(p)
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = h[2, 0] * x + h[2, 1] * y + h[2, 2]
            out[..., 0] = (h[0, 0] * x + h[0, 1] * y + h[0, 2]) / depth
            out[..., 1] = (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / depth
        return out

    def _linear(self) -> FloatArray:
        h = self.coefficients
        if h[2, 2] == 0:
            return np.full((2, 2), np.nan)
        corner = h[:2, 2] / h[2, 2]
        return np.asarray((h[:2, :2] - np.outer(corner, h[2, :2])) / h[2, 2])

    @property
    def matrix(self) -> FloatArray:
        return self.coefficients

    @property
    def inverse(self) -> Homography:
        a, b, c = self.coefficients
        # The adjugate: a homography is known up to a factor, so no division is needed and none is rounded.
        return Homography(_unit_corner(np.column_stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)])))

    @property
    def parameters(self) -> Mapping[str, Any]:
        return {"coefficients": self.coefficients.tolist()}


def _volume(h: FloatArray) -> float:
    """Determinant of a (3, 3) matrix whose columns, then rows, are brought to unit length: 1 where they are orthogonal.

    The columns first: the last one holds coordinates, which may be far from 0.
    """
    columns = h / np.maximum(np.linalg.norm(h, axis=0), 1e-300)
    rows = columns / np.maximum(np.linalg.norm(columns, axis=1), 1e-300)[:, None]
    return abs(float(np.linalg.det(rows)))


def _unit_corner(h: FloatArray) -> FloatArray:
    """Divide by the last element where that is safe, else by the norm."""
    norm = float(np.linalg.norm(h[2]))
    return np.asarray(h / (h[2, 2] if abs(h[2, 2]) > 1e-9 * norm else norm))


def _direct_linear(n: Normalised) -> FloatArray | FailedFit:
    """Return the (3, 3) homography of normalised points, last element 1, of the smallest algebraic error."""
    (x, y), (u, v), m = n.reference.T, n.secondary.T, len(n.weights)
    one, zero = np.ones(m), np.zeros(m)
    equations = np.empty((2 * m, 9))
    equations[0::2] = np.column_stack([x, y, one, zero, zero, zero, -u * x, -u * y, -u])
    equations[1::2] = np.column_stack([zero, zero, zero, x, y, one, -v * x, -v * y, -v])
    equations *= np.repeat(np.sqrt(n.weights), 2)[:, None]
    # The triangular factor has the same right singular vectors and at most nine rows.
    _, singular, basis = np.linalg.svd(triangle(equations), full_matrices=True)
    if singular[7] < FLAT * singular[0]:
        return FailedFit(
            f"the {m} points do not determine a homography (three of four on a line, or coincident): "
            f"singular values in the ratio {singular[7] / singular[0]:.3g}"
        )
    h = basis[8].reshape(3, 3)
    if abs(h[2, 2]) < FLAT * np.abs(h).max():
        return FailedFit("the horizon of the fit runs through the middle of the points")
    return np.asarray(h / h[2, 2])


def _reprojection_minimum(h: FloatArray, n: Normalised, steps: int = 10) -> FloatArray:
    """Gauss-Newton on the weighted squared reprojection error; a step that does not lower it ends the search."""
    from featreg.geometry.reweighting_kernels import reprojection_minimum

    found = h.ravel().copy()
    x, y, u, v = (np.ascontiguousarray(column) for column in (*n.reference.T, *n.secondary.T))
    if reprojection_minimum(found, x, y, u, v, n.weights):
        return found.reshape(3, 3)
    return plain_reprojection_minimum(h, n, steps)


def plain_reprojection_minimum(h: FloatArray, n: Normalised, steps: int = 10) -> FloatArray:
    """The same by orthogonal factors, which hold also where the points hardly determine a homography."""
    x, y = n.reference.T
    m, root = len(x), np.sqrt(n.weights)

    def errors(h: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, float]:
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            depth = h[2, 0] * x + h[2, 1] * y + 1.0
            mapped = (n.reference @ h[:2, :2].T + h[:2, 2]) / depth[:, None]
            difference = (n.secondary - mapped) * root[:, None]
        return depth, mapped, difference, float((difference * difference).sum())

    depth, mapped, difference, cost = errors(h)
    for _ in range(steps):
        if not math.isfinite(cost) or cost < 1e-28 * m:
            break
        base = (root / depth)[:, None] * np.column_stack([x, y, np.ones(m)])
        jacobian = np.zeros((2 * m, 8))
        jacobian[0::2, 0:3] = jacobian[1::2, 3:6] = base
        jacobian[0::2, 6:8] = -base[:, :2] * mapped[:, :1]
        jacobian[1::2, 6:8] = -base[:, :2] * mapped[:, 1:]
        step = np.linalg.lstsq(jacobian, difference.reshape(-1), rcond=None)[0]
        trial = h + np.append(step, 0.0).reshape(3, 3)
        depth, mapped, difference, new = errors(trial)
        if not new < cost:
            break
        gain, h, cost = cost - new, trial, new
        if gain < 1e-12 * cost:
            break
    return h
