"""How well the points of a fit determine the model: standard errors of a rigid one, prediction errors of any."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from featreg.errors import InputError
from featreg.geometry.base import Normalised, normalise
from featreg.geometry.corrected import CorrectedModel
from featreg.geometry.homography import Homography
from featreg.geometry.least_squares import triangle
from featreg.geometry.matrix import Affine, Rigid, Similarity, Translation
from featreg.geometry.polynomial import Polynomial, polynomial_terms
from featreg.interfaces import FailedFit, Model
from featreg.types import FloatArray, IntArray

#: No tie point is known better than this, px.
FINEST_PX = 0.05
#: Points determine a model where no pivot of its normal equations is less than so much of what it was.
LEAST_PIVOT = 1e-12
#: Models by whose matrices derivatives are compiled: the number by which `featreg.geometry.robust_kernels` knows each,
#: and its parameters.
COMPILED: Mapping[type[Model], tuple[int, int]] = {
    Translation: (0, 2), Rigid: (1, 3), Similarity: (2, 4), Affine: (3, 6), Homography: (4, 8),
}  # fmt: skip
#: Parts of the points of which one after the other is left out of a fit.
GROUPS = 16


@dataclass(frozen=True)
class RigidUncertainty:
    """Standard errors of a rigid fit.

    Parameters
    ----------
    rotation_deg : standard deviation of the rotation in degrees
    shift : standard deviations of the shift (dx, dy) at the stated point, px
    sigma : standard deviation of one secondary coordinate of weight 1, px
    dof : degrees of freedom of `sigma`, 2 M - 3; intervals take Student's t of that many
    """

    rotation_deg: float
    shift: tuple[float, float]
    sigma: float
    dof: int


def rigid_uncertainty(
    reference_xy: FloatArray, secondary_xy: FloatArray, weights: FloatArray | None = None, *, at: ArrayLike
) -> RigidUncertainty | FailedFit:
    """Return the standard errors of the rigid fit of these points.

    Parameters
    ----------
    reference_xy, secondary_xy : (M, 2) float64 px
    weights : (M,) relative inverse variances, as in the fit; None for equal ones
    at : (x, y) reference point at which the shift is judged, the image centre for example

    Returns
    -------
    The standard errors, or a `FailedFit` where the fit fails.

    Notes
    -----
    Errors of the secondary positions are taken as independent, equal along both axes and with variance sigma^2 / w;
    sigma^2 is estimated without bias as sum w r^2 / (2 M - 3). To first order var(angle) = sigma^2 / sum w |z - zm|^2,
    and the shift at p has covariance sigma^2 (I / sum w + q q^T / sum w |z - zm|^2) with q the offset of p from the
    mean point, turned by 90 degrees more than the model turns. Errors of the reference positions of the same size add
    to the residuals and so are counted through sigma.
    """
    n = normalise(reference_xy, secondary_xy, weights, Rigid.minimum)
    if isinstance(n, FailedFit):
        return n
    model = Rigid.from_estimate(reference_xy, secondary_xy, weights)
    if isinstance(model, FailedFit):
        return model
    m = len(n.weights)
    reference = n.reference * n.reference_scale + n.reference_centre
    secondary = n.secondary * n.secondary_scale + n.secondary_centre
    dof = 2 * m - 3
    variance = float(n.weights @ model.residuals(reference, secondary) ** 2) / dof
    inertia = m * n.reference_scale**2
    q = model.matrix[:2, :2] @ (np.asarray(at, np.float64) - n.reference_centre)
    sx = math.sqrt(variance * (1.0 / m + q[1] ** 2 / inertia))
    sy = math.sqrt(variance * (1.0 / m + q[0] ** 2 / inertia))
    return RigidUncertainty(math.degrees(math.sqrt(variance / inertia)), (sx, sy), math.sqrt(variance), dof)


def prediction_covariance(
    model: Model,
    reference_xy: FloatArray,
    secondary_xy: FloatArray,
    weights: FloatArray | None = None,
    *,
    at: ArrayLike,
    sigma: float | None = None,
) -> FloatArray | FailedFit:
    """Return the covariance of where a fitted model maps points, from the residuals of its own fit.

    Parameters
    ----------
    model : the least-squares model of these points
    reference_xy, secondary_xy : (M, 2) float64 px
    weights : (M,) relative inverse variances, as in the fit; None for equal ones
    at : (N, 2) reference points, or (2,) for one
    sigma : standard deviation of a secondary coordinate of weight 1, px; None for that of the residuals

    Returns
    -------
    (N, 2, 2) float64 px^2 (or (2, 2)), or a `FailedFit` where the points leave no degree of freedom

    Raises
    ------
    InputError
        A model without known derivatives.

    Notes
    -----
    Errors of the secondary positions are taken as independent, equal along both axes and with variance sigma^2 / w.
    With T the derivatives of the mapped points by the P parameters the covariance is sigma^2 T (sum w T^T T)^-1 T^T,
    and sigma^2 = sum w r^2 / (2 M - P). Points that a consensus selected away do not count: the residuals are cut off
    at its threshold, and sigma comes out a little small.
    """
    points = np.asarray(at, np.float64)
    if isinstance(model, CorrectedModel):
        mapped, there = model.known(reference_xy), model.known(points.reshape(-1, 2)).reshape(points.shape)
        if not (np.isfinite(mapped).all() and np.isfinite(there).all()):
            return FailedFit("the known map does not reach all points")
        return prediction_covariance(model.correction, mapped, secondary_xy, weights, at=there, sigma=sigma)
    n = normalise(reference_xy, secondary_xy, weights, model.minimum, spread=False)
    if isinstance(n, FailedFit):
        return n
    reference = n.reference * n.reference_scale + n.reference_centre
    secondary = n.secondary * n.secondary_scale + n.secondary_centre
    design = derivatives(model, reference, n)
    m, _, count = design.shape
    dof = 2 * m - count
    if dof < 1:
        return FailedFit(f"{m} points leave no degree of freedom beside {count} parameters")
    if sigma is None:
        variance = float(n.weights @ model.residuals(reference, secondary) ** 2) / dof
    else:
        # Of weight 1 as it was given; the normalised weights have mean 1.
        given = 1.0 if weights is None else float(np.mean(np.asarray(weights, np.float64)[np.asarray(weights) > 0]))
        variance = sigma**2 / given
    rows = (design * np.sqrt(n.weights)[:, None, None]).reshape(2 * m, count)
    factor = triangle(rows)
    diagonal = np.abs(np.diag(factor))
    if diagonal.min() <= 1e-12 * diagonal.max():
        return FailedFit(f"the {m} points do not determine the {count} parameters")
    there = derivatives(model, points.reshape(-1, 2), n)
    root = np.linalg.solve(factor.T, there.reshape(-1, count).T).T.reshape(there.shape)
    return np.asarray(variance * root @ root.transpose(0, 2, 1)).reshape(*points.shape[:-1], 2, 2)


def regional_covariance(
    model: Model,
    reference_xy: FloatArray,
    secondary_xy: FloatArray,
    region: IntArray,
    weights: FloatArray | None = None,
    *,
    at: ArrayLike,
) -> FloatArray | FailedFit:
    """Return the covariance of where a fitted model maps points, by leaving out one region of its points after another.

    Parameters
    ----------
    model : fitted to these points
    reference_xy, secondary_xy : (M, 2) float64 px
    region : (M,) number of the region in which each point lies
    weights : (M,) relative inverse variances, as in the fit, points of weight 0 left out; None for equal ones
    at : (N, 2) reference points

    Returns
    -------
    (N, 2, 2) float64 px^2, or a `FailedFit` where the points outside one region do not determine the model

    Raises
    ------
    InputError
        A model without known derivatives, or arrays that do not fit together.

    Notes
    -----
    The delete-a-group jackknife: (k - 1) / k times the sum over the k regions of d d^T, d being the departure of the
    model without a region from their mean. Errors that neighbouring points share (a mistaken structure, relief,
    motion) are counted, which `prediction_covariance` takes to be independent. Models without a region come from the
    derivatives of the model at hand: exact for affine and polynomial models, one Gauss-Newton step for the others.

    References
    ----------
    P. S. Kott, "The delete-a-group jackknife", J. Official Statistics 17 (2001) 521.
    """
    regions = np.asarray(region)
    if regions.shape != (len(reference_xy),):
        raise InputError(f"{len(reference_xy)} points need as many numbers of regions, got shape {regions.shape}")
    known = linearised(model, reference_xy, secondary_xy, weights, at=at)
    if isinstance(known, FailedFit):
        return known
    if weights is not None:
        regions = regions[np.asarray(weights, np.float64) > 0]  # those that are left
    return left_out_covariance(known, np.unique(regions, return_inverse=True)[1].astype(np.int64), known.weights)


def left_out_covariance(
    known: Linearised, region: IntArray, weights: FloatArray | None = None
) -> FloatArray | FailedFit:
    """Return `regional_covariance` of a fit that was made linear: of points of equal weight, or of `weights` (M,).

    Numbers of regions are few, from 0 on.
    """
    from featreg.geometry.correlated_kernels import left_out

    design, error = known.design, known.error
    if weights is not None:
        root = np.sqrt(weights)
        design, error = design * root[:, None, None], error * root[:, None]
    count = int(region.max()) + 1
    covariance = np.empty((len(known.at), 2, 2))
    held = left_out(design, error, region, count, known.at, LEAST_PIVOT, covariance)
    if 0 <= held < 3:
        return FailedFit(f"the points lie in {held} regions, 3 are needed")
    if held < 0:
        return FailedFit("the points outside one region do not determine the model")
    return np.asarray(covariance * ((held - 1) / held))


def refitted_covariance(
    model: Model, reference_xy: FloatArray, secondary_xy: FloatArray, *, at: ArrayLike
) -> FloatArray | FailedFit:
    """Return the covariance of where a model maps points, by fitting it anew without every sixteenth of its points.

    For models whose derivatives are not known; what they map where there are no tie points is not judged by it.

    Parameters
    ----------
    model : fitted to these points
    reference_xy, secondary_xy : (M, 2) float64 px
    at : (N, 2) reference points

    Returns
    -------
    (N, 2, 2) float64 px^2, or a `FailedFit` where a model cannot be fitted to fifteen sixteenths of the points

    Notes
    -----
    The delete-a-group jackknife of `regional_covariance`, with groups that lie all over the image; errors of the points
    are taken as independent.
    """
    points = np.asarray(at, np.float64)
    group = np.arange(len(reference_xy)) % GROUPS
    mapped: list[FloatArray] = []
    for left in range(GROUPS):
        part = type(model).from_estimate(reference_xy[group != left], secondary_xy[group != left])
        if isinstance(part, FailedFit):
            return part
        mapped.append(part(points))
    departure = np.stack(mapped, axis=-1) - np.mean(mapped, axis=0)[:, :, None]
    return np.asarray((GROUPS - 1) / GROUPS * departure @ departure.transpose(0, 2, 1))


def inverse_variances(covariance: FloatArray | None) -> FloatArray | None:
    """Return the weights of tie points (M,) from their covariances (M, 2, 2) px^2, or None where none is known.

    Those of unknown covariance (NaN) get the median of the known ones, and none is taken to be better than 0.05 px.
    """
    if covariance is None:
        return None
    variance = np.trace(covariance, axis1=1, axis2=2) / 2
    known = np.isfinite(variance)
    if known.all() and len(known):
        return np.asarray(1 / (variance + FINEST_PX**2))
    if not known.any():
        return None
    return np.asarray(1 / (np.where(known, variance, np.median(variance[known])) + FINEST_PX**2))


@dataclass(frozen=True, eq=False)
class Linearised:
    """A fit that is taken as linear around its model.

    Parameters
    ----------
    here : (M, 2) px, the tie points in the reference, or where a known map takes them
    error : (M, 2) px, those in the secondary less where the model maps them
    weights : (M,) relative inverse variances of mean 1
    design, at : (M, 2, P) and (N, 2, P), `derivatives` at the tie points and at other points
    """

    here: FloatArray
    error: FloatArray
    weights: FloatArray
    design: FloatArray
    at: FloatArray


def linearised(
    model: Model,
    reference_xy: FloatArray,
    secondary_xy: FloatArray,
    weights: FloatArray | None = None,
    *,
    at: ArrayLike,
) -> Linearised | FailedFit:
    """Return a fitted model made linear; parameters, and what is raised, as of `regional_covariance`.

    Tie points of weight 0 are left out.
    """
    points = np.asarray(at, np.float64)
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError(f"the points to predict must be an (N, 2) array of (x, y), got shape {points.shape}")
    if isinstance(model, CorrectedModel):
        mapped, there = model.known(reference_xy), model.known(points)
        if not (np.isfinite(mapped).all() and np.isfinite(there).all()):
            return FailedFit("the known map does not reach all points")
        return linearised(model.correction, mapped, secondary_xy, weights, at=there)
    n = normalise(reference_xy, secondary_xy, weights, model.minimum, spread=False)
    if isinstance(n, FailedFit):
        return n
    here, there = np.asarray(reference_xy, np.float64), np.asarray(secondary_xy, np.float64)
    if len(n.weights) < len(here):
        used = np.asarray(weights, np.float64) > 0
        here, there = here[used], there[used]
    design, mapped = _derived(model, np.ascontiguousarray(here), n)
    return Linearised(
        np.ascontiguousarray(here),
        np.asarray(there - mapped),
        n.weights,
        design,
        _derived(model, np.ascontiguousarray(points), n)[0],
    )


def _derived(model: Model, xy: FloatArray, n: Normalised) -> tuple[FloatArray, FloatArray]:
    """`derivatives` (N, 2, P) in one piece, and where the model maps the points (N, 2)."""
    kind, count = COMPILED.get(type(model), (-1, 0))
    if kind < 0 or model.matrix is None:
        mapped = model(xy)
        return np.ascontiguousarray(derivatives(model, xy, n, mapped)), mapped
    from featreg.geometry.prediction_kernels import derived

    out, mapped = np.empty((len(xy), 2, count)), np.empty(xy.shape)
    unit = np.array([*n.reference_centre, *n.secondary_centre, n.reference_scale, n.secondary_scale])
    derived(kind, model.matrix, xy, unit, mapped, out)
    return out, mapped


def derivatives(model: Model, xy: FloatArray, n: Normalised, mapped: FloatArray | None = None) -> FloatArray:
    """(N, 2, P) derivatives of the mapped points by parameters that span the model's freedom, in units of the fit.

    `mapped` is where the model maps the points, where that is known.
    """
    one = np.ones(len(xy))
    unit = (xy - n.reference_centre) / n.reference_scale
    if isinstance(model, Affine | Polynomial):
        mapped = unit  # of no matter to what is linear in its parameters
    else:
        mapped = ((model(xy) if mapped is None else mapped) - n.secondary_centre) / n.secondary_scale
    if isinstance(model, Translation | Rigid | Similarity):
        out = np.zeros((len(xy), 2, 4))
        out[:, 0, 0] = out[:, 1, 1] = one
        out[:, 0, 2], out[:, 1, 2] = mapped[:, 1], -mapped[:, 0]
        out[:, :, 3] = mapped
        return out[:, :, : {Translation: 2, Rigid: 3, Similarity: 4}[type(model)]]
    if isinstance(model, Affine | Homography):
        terms = np.column_stack([one, unit])
    elif isinstance(model, Polynomial):
        terms = polynomial_terms(unit, model.minimum)
    else:
        raise InputError(f"the derivatives of {type(model).__name__} are not known")
    count = terms.shape[1]
    out = np.zeros((len(xy), 2, 2 * count))
    out[:, 0, :count] = out[:, 1, count:] = terms
    if isinstance(model, Homography):
        depth = np.column_stack([xy, one]) @ model.coefficients[2]
        bend = -mapped[:, :, None] * unit[:, None, :]
        out = np.concatenate([out, bend], axis=2) / depth[:, None, None]
    return out
