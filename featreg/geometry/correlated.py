"""How well tie points determine a model where their errors are correlated over a length that is not known."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from featreg.errors import InputError
from featreg.geometry.uncertainty import GROUPS, LEAST_PIVOT, Linearised, linearised, refitted_covariance
from featreg.interfaces import FailedFit, Model
from featreg.types import FloatArray

#: Cells along the longer side of the tie points' bounding box.
CELLS = 6
#: Correlation lengths that are weighed against each other, over the longer side of the tie points' bounding box, and
#: the variance that neighbours share over that which they do not.
LENGTHS = (0.03, 0.06, 0.1, 0.16, 0.24, 0.34, 0.5)
SHARED = (0.5, 3.0, 20.0)
# exp(-d) as a sum of Gaussian functions of d: their shares and standard deviations.
EXPONENTIAL = ((0.175, 0.12), (0.3, 0.4), (0.36, 0.95), (0.165, 2.0))
GAUSSIAN = ((1.0, 1.0), (0.0, 1.0), (0.0, 1.0), (0.0, 1.0))
MIXTURES = np.array([GAUSSIAN, EXPONENTIAL])
Z95 = 1.959964


@dataclass(frozen=True, eq=False)
class Predicted:
    """What is known of where a model maps points.

    Parameters
    ----------
    covariance : (N, 2, 2) float64 px^2
    dof : degrees of freedom of the covariance; intervals take Student's t of that many
    length : correlation length of the tie points' errors, px; 0 where they are independent
    sigma : standard deviation of one secondary coordinate of weight 1, px
    """

    covariance: FloatArray
    dof: float
    length: float
    sigma: float


def correlated_covariance(
    model: Model,
    reference_xy: FloatArray,
    secondary_xy: FloatArray,
    weights: FloatArray | None = None,
    *,
    at: ArrayLike,
) -> Predicted | FailedFit:
    """Return the covariance of where a fitted model maps points; the errors of near tie points may be alike.

    Parameters
    ----------
    model : the least-squares model of these tie points
    reference_xy, secondary_xy : (M, 2) float64 px
    weights : (M,) > 0, relative inverse variances, as in the fit; None for equal ones
    at : (N, 2) reference points

    Returns
    -------
    The covariance, or a `FailedFit` where the tie points leave no degree of freedom

    Raises
    ------
    InputError
        A model without known derivatives.

    Notes
    -----
    Windows that overlap, a structure that both dates show differently, relief and motion give neighbours a common
    error. The errors are taken as a sum of an independent part and of one whose correlation falls with the distance,
    as a Gaussian or an exponential function. A fit follows long waves of it, so that its residuals show less than
    there is: the likelihood of each length and share is the restricted one, of what no model of the kind can follow.
    The covariance of the fit, (X^T W X)^-1 X^T W C W X (X^T W X)^-1, is averaged over all candidates C by their
    likelihood, and the spread of the candidates lowers the degrees of freedom. Tie points are gathered in 6 cells along
    the longer side of their bounding box, with the variance of their places in each.

    References
    ----------
    H. D. Patterson, R. Thompson, "Recovery of inter-block information when block sizes are unequal", Biometrika 58
    (1971) 545, DOI 10.1093/biomet/58.3.545
    """
    known = linearised(model, reference_xy, secondary_xy, weights, at=at)
    return known if isinstance(known, FailedFit) else correlated_prediction(known)


def correlated_prediction(known: Linearised) -> Predicted | FailedFit:
    """Return `correlated_covariance` of a fit that was made linear."""
    from featreg.geometry.correlated_kernels import estimators

    place, variance, weight, number, mean, design = _gathered(known)
    count, points = design.shape[2], len(known.at)
    dof = 2 * len(place) - count
    if dof < 1:
        return FailedFit(f"tie points in {len(place)} places leave no degree of freedom beside {count} parameters")
    estimator = np.empty((count, len(place), 2))
    if not estimators(weight, design, LEAST_PIVOT, estimator):
        return FailedFit(f"the tie points do not determine the {count} parameters")
    side = float(np.ptp(known.here, axis=0).max())
    lengths, parts, own, shared = _candidates(place, variance, weight, number, side)
    # How much a shift of each cell along each axis moves each mapped point along each axis: (N, 2, 2, C).
    moved = known.at.reshape(-1, count) @ estimator.reshape(count, -1)
    weighing = np.ascontiguousarray(moved.reshape(points, 2, -1, 2).transpose(0, 1, 3, 2))
    rows = weighing.reshape(points, 2, -1)
    lines = weighing.reshape(-1, len(place))
    both = np.concatenate([design, mean[:, :, None]], axis=2)
    made = _whitened(own, shared, both, lines.T @ lines)
    if made is None:
        return FailedFit("the tie points lie too close together for any correlation of their errors")
    left, logs, traces = made
    variances = left / dof
    if not variances.max() > 0:
        return Predicted(np.zeros((points, 2, 2)), float(dof), 0.0, 0.0)
    likelihood = -0.5 * (logs + dof * np.log(np.maximum(variances, 1e-30 * variances.max())))
    share = np.exp(likelihood - likelihood.max())
    # As likely beforehand: no correlation, and all candidates with one together.
    share[1:] /= len(share) - 1
    share /= share.sum()
    chosen = share * variances
    of_pairs = chosen[1:].reshape(len(shared), -1) @ SHARED
    of_cells = (of_pairs @ shared.reshape(len(shared), -1)).reshape(len(place), len(place))
    of_cells.flat[:: len(place) + 1] += own * chosen.sum()
    covariance = (lines @ of_cells).reshape(rows.shape) @ rows.transpose(0, 2, 1)
    each = variances * traces
    middle = float(share @ each)
    widened = _interval(each / middle, share) if middle > 0 else 1.0
    return Predicted(
        np.asarray(covariance) * widened**2,
        float(dof),
        float(share @ lengths),
        float(np.sqrt(share @ (variances * (1 + parts)))),
    )


def _interval(variances: FloatArray, share: FloatArray) -> float:
    """Standard deviation of the normal error whose 95 % interval is that of the mixture of these variances."""
    from featreg.geometry.correlated_kernels import interval

    likely = share > 1e-5
    return interval(np.maximum(variances[likely], 1e-12), share[likely] / share[likely].sum(), Z95, 0.05)


def prediction(
    model: Model,
    reference_xy: FloatArray,
    secondary_xy: FloatArray,
    weights: FloatArray | None = None,
    *,
    at: ArrayLike,
) -> Predicted | FailedFit:
    """Return `correlated_covariance`; by `refitted_covariance` for a model without known derivatives."""
    try:
        return correlated_covariance(model, reference_xy, secondary_xy, weights, at=at)
    except InputError:
        known = refitted_covariance(model, reference_xy, secondary_xy, at=at)
    if isinstance(known, FailedFit):
        return known
    squares = float((model.residuals(reference_xy, secondary_xy) ** 2).mean()) / 2
    return Predicted(known, GROUPS - 1, math.nan, math.sqrt(squares))


def _gathered(
    known: Linearised,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Gather tie points in cells.

    Returns
    -------
    place, variance, weight, number, mean, design : (C, 2) px from the corner of their box, (C,) px^2 along either axis
        of the places about it, (C,) sum, (C,) of independent ones of equal weight, (C, 2) px mean error, (C, 2, P) mean
        derivatives
    """
    from featreg.geometry.correlated_kernels import gathered

    low = known.here.min(axis=0)
    side = max(float((known.here.max(axis=0) - low).max()), 1e-9) / CELLS
    count = known.design.shape[2]
    sums = np.empty((CELLS, CELLS, 7 + 2 * count))
    gathered(known.here, known.error, known.design, known.weights, low, side, sums)
    sums = sums.reshape(CELLS * CELLS, -1)
    sums = sums[sums[:, 0] > 0]
    total = np.ascontiguousarray(sums[:, 0])
    mean = sums[:, 2:] / total[:, None]
    place = mean[:, :2]
    variance = np.maximum(mean[:, 2] - (place**2).sum(axis=1), 0) / 2
    design = np.ascontiguousarray(mean[:, 5:]).reshape(len(total), 2, count)
    return place, variance, total, total**2 / sums[:, 1], mean[:, 3:5], design


def _candidates(
    place: FloatArray, variance: FloatArray, weight: FloatArray, number: FloatArray, side: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """What the covariances of the cells' means may be.

    The mean of a Gaussian function of the distance over two cells is taken as that of Gaussian clouds of their
    variance, which has a closed form.

    Returns
    -------
    lengths, parts : (K,) px, (K,) correlated over independent variance; no correlation first, then all shares of the
        first of `shared`, and so on
    own : (C,) variances without correlation
    shared : (S, C, C) what is added for a share of 1
    """
    from featreg.geometry.correlated_kernels import shared_parts

    distance = ((place[:, None] - place) ** 2).sum(axis=2)
    tried = np.array(LENGTHS) * side
    shared = np.empty((len(tried) * len(MIXTURES), len(place), len(place)))
    shared_parts(distance, variance, 1 / number, tried, MIXTURES, shared)
    lengths = np.append(0.0, np.repeat(tried, len(MIXTURES) * len(SHARED)))
    parts = np.append(0.0, np.tile(SHARED, len(shared)))
    return lengths, parts, 1 / weight, shared


def _whitened(
    own: FloatArray, shared: FloatArray, both: FloatArray, outer: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Of each candidate (K,): the sum of squares of the errors that a fit leaves, its logarithms of determinants, the
    sum of `outer` (C, C) times it, from the rows of `both` (C, 2, P + 1); None where one has no root."""
    from featreg.geometry.correlated_kernels import whitened

    many = 1 + len(shared) * len(SHARED)
    left, logs = np.empty(many), np.empty(many)
    if not whitened(own, shared, np.array(SHARED), both.reshape(len(own), -1), left, logs):
        return None
    alone = float(own @ outer.diagonal())
    together = np.multiply.outer(shared.reshape(len(shared), -1) @ outer.ravel(), SHARED).ravel()
    return left, logs, np.append(alone, alone + together)
