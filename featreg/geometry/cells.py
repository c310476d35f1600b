"""How well tie points determine a model where neighbours share their errors: all that lie in one cell count as one."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from featreg.geometry.correlated import correlated_covariance
from featreg.geometry.matrix import Rigid
from featreg.geometry.uncertainty import RigidUncertainty, prediction_covariance
from featreg.interfaces import FailedFit, Model
from featreg.types import FloatArray, IntArray

#: Side of the square cells in which tie points share their errors, px: that of the correlated patches, which overlap.
CELL_PX = 96.0
#: Cells along each side of an image by which the spread of points is told.
SPREAD_CELLS = 8
#: Where between the longest residual that was kept and the next one the limit of the selection is taken to lie.
CUT_SHARE = 0.3
#: Largest standard deviation that a selection tells of, over its limit.
WIDEST = 2.0
#: Fewest cells with tie points for which standard errors are stated.
LEAST_PLACES = 3
# Far beyond any image, px: there, an error of the shift is nothing beside one of the rotation.
FAR = 1e7


def cells(xy: FloatArray, side: float = CELL_PX) -> IntArray:
    """Return the number of the cell of `side` px in which each of (M, 2) points lies, (M,) int64."""
    x, y = np.floor(xy / side).astype(np.int64).T
    return np.asarray(y * (1 << 24) + x)


def spread(xy: ArrayLike, shape: tuple[int, int]) -> float:
    """Return the share of the cells of an 8 x 8 grid over an image of (H, W) that hold one of (M, 2) points."""
    # A pixel covers half a pixel on either side of its centre, and so does the image.
    place = (np.asarray(xy, np.float64).reshape(-1, 2) + 0.5) / shape[::-1]
    place = place[((place >= 0) & (place <= 1)).all(axis=1)]
    cell = np.minimum((place * SPREAD_CELLS).astype(np.int64), SPREAD_CELLS - 1) @ np.array([1, SPREAD_CELLS])
    return np.count_nonzero(np.bincount(cell, minlength=1)) / SPREAD_CELLS**2


def dilution(model: Model, reference_xy: FloatArray, secondary_xy: FloatArray, *, at: ArrayLike) -> float:
    """Return the error of a model over points, root mean square, for an error of one pixel per cell of its tie points.

    Parameters
    ----------
    model : fitted to these tie points
    reference_xy, secondary_xy : (M, 2) float64 px
    at : (N, 2) reference points, such as a grid over the image

    Returns
    -------
    float, no unit; NaN where the cells are too few for the model

    Raises
    ------
    InputError
        A model without known derivatives.

    Notes
    -----
    It depends only on where the tie points lie, not on how well they agree: errors that a whole cell has in common
    (layover, a structure seen from another side) leave no residual where the cells are few.
    """
    if not len(reference_xy):
        return math.nan
    _, cell = np.unique(cells(reference_xy), return_inverse=True)
    count = np.bincount(cell)
    here, there = (
        np.column_stack([np.bincount(cell, xy[:, i]) / count for i in (0, 1)]) for xy in (reference_xy, secondary_xy)
    )
    covariance = prediction_covariance(model, here, there, at=at, sigma=1.0)
    if isinstance(covariance, FailedFit):
        return math.nan
    return float(np.sqrt(np.trace(covariance, axis1=1, axis2=2).mean()))


def rigid_standard_errors(
    model: Rigid,
    reference_xy: FloatArray,
    secondary_xy: FloatArray,
    weights: FloatArray | None = None,
    *,
    at: ArrayLike,
    cut: float = math.inf,
) -> RigidUncertainty | FailedFit:
    """Return the standard errors of a rigid model whose tie points were selected and share errors with neighbours.

    Parameters
    ----------
    model : fitted to these tie points
    reference_xy, secondary_xy : (M, 2) float64 px, the tie points that were kept
    weights : (M,) relative inverse variances, as in the fit; None for equal ones
    at : (x, y) reference point at which the shift is judged
    cut : residual in pixels beyond which tie points were left out; inf where none was for its residual

    Returns
    -------
    The standard errors, or a `FailedFit` where fewer than three cells of 96 px hold tie points; intervals take
    Student's t of `dof`.

    Notes
    -----
    `correlated_covariance` counts what neighbours share, over whatever distance. Selection by residuals makes those of
    the rest too small and the fit too sure: with Gaussian errors of standard deviation sigma cut off at length c and
    u = c^2 / (2 sigma^2) the mean square of what is left is
    ``2 sigma^2 (1 - (1 + u) exp(-u)) / (1 - exp(-u))`` = 2 m, and the variance of an estimate that rests on them is
    (sigma^2 / m)^2 times the one they show (that of an M-estimate with hard rejection). sigma is solved for.
    """
    centre = np.asarray(at, np.float64)
    places = len(np.unique(cells(reference_xy)))
    if places < LEAST_PLACES:
        return FailedFit(f"the tie points lie in {places} cells, {LEAST_PLACES} are needed")
    shift = correlated_covariance(model, reference_xy, secondary_xy, weights, at=centre[None])
    if isinstance(shift, FailedFit):
        return shift
    turn = correlated_covariance(model, reference_xy, secondary_xy, weights, at=centre[None] + [FAR, 0.0])
    if isinstance(turn, FailedFit):
        return turn
    squares = model.residuals(reference_xy, secondary_xy) ** 2
    shown = float(squares.sum()) / max(2 * len(squares) - 3, 1)
    wider = _variance_before_selection(shown, cut) / shown if shown > 0 else 1.0
    sx, sy = (wider * math.sqrt(value) for value in np.diag(shift.covariance[0]).tolist())
    rotation = wider * math.sqrt(float(np.trace(turn.covariance[0]))) / FAR
    return RigidUncertainty(math.degrees(rotation), (sx, sy), math.sqrt(wider * shown), round(shift.dof))


def selection_cut(kept: FloatArray, others: FloatArray) -> float:
    """Return the residual beyond which tie points were left out, px; inf where no longer one was.

    Parameters
    ----------
    kept, others : (M,), (K,) float64 px, residuals of the tie points that were kept and of those that were not
    """
    longest = float(kept.max(initial=0.0))
    beyond = others[others > longest]
    return longest + CUT_SHARE * (float(beyond.min()) - longest) if len(beyond) else math.inf


def _variance_before_selection(shown: float, cut: float) -> float:
    """Variance per axis of Gaussian errors of which those shorter than `cut` show the variance `shown`."""
    if not math.isfinite(cut):
        return shown

    def left(variance: float) -> float:
        u = cut * cut / (2 * variance)
        return variance * (1 - (1 + u) * math.exp(-u)) / -math.expm1(-u)

    # What is left grows with the variance towards a quarter of the squared cut, that of errors that fill the circle,
    # and tells nothing of it there.
    low, high = shown, max(shown, (WIDEST * cut) ** 2)
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if left(middle) < shown else (low, middle)
    return high
