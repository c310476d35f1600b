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
    from featreg.geometry import prediction_kernels as kernels

    count = known.design.shape[2]
    covariance, numbers = np.empty((len(known.at), 2, 2)), np.empty(4)
    found = kernels.predicted(
        known.here, known.error, known.weights, known.design, known.at, CELLS, np.array(LENGTHS), np.array(SHARED),
        MIXTURES, LEAST_PIVOT, Z95, 0.05, covariance, numbers,
    )  # fmt: skip
    places, dof, length, sigma = numbers.tolist()
    if found == kernels.NO_FREEDOM:
        return FailedFit(f"tie points in {places:.0f} places leave no degree of freedom beside {count} parameters")
    if found == kernels.UNDETERMINED:
        return FailedFit(f"the tie points do not determine the {count} parameters")
    if found == kernels.TOO_CLOSE:
        return FailedFit("the tie points lie too close together for any correlation of their errors")
    return Predicted(covariance, dof, length, sigma)


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
