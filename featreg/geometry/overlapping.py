"""How much of the errors of overlapping windows a fit to them takes up, so that its residuals show less."""

from __future__ import annotations

import numpy as np

from featreg.errors import InputError
from featreg.geometry.uncertainty import linearised
from featreg.interfaces import FailedFit, Model
from featreg.types import FloatArray

#: So many windows, evenly taken, tell it.
ENOUGH = 150
#: A fit that follows more than this share of the errors is no longer judged by its residuals.
MOST = 0.5


def share_taken_up(model: Model, reference_xy: FloatArray, secondary_xy: FloatArray, side: float) -> float:
    """Return the share of the variance of the errors of windows that is lost to the model fitted to them.

    Parameters
    ----------
    model : the least-squares model of these tie points
    reference_xy, secondary_xy : (M, 2) float64 px, middles of the windows and what they were found to be
    side : of the windows, px; their errors are the means of those of their pixels

    Returns
    -------
    float
        0 to 0.5; 0 for a model without known derivatives, and for points that do not determine one

    Notes
    -----
    The residuals of a fit with the projection Q onto what the model follows have the mean square tr(C - Q C) / 2 M, C
    being the covariance of the errors. Of independent errors that is 1 - P / 2 M of their variance. Errors of windows
    that overlap are alike by the share of their common area: many windows on one place are one measurement, and the
    loss does not fall with their number but with the area that they cover. Weights of the fit are not looked at.
    """
    step = max(1, -(-len(reference_xy) // ENOUGH))
    here, there = reference_xy[::step], secondary_xy[::step]
    try:
        known = linearised(model, here, there, at=here[:1])
    except InputError:
        return 0.0
    if isinstance(known, FailedFit):
        return 0.0
    design, count = known.design, len(known.here)
    alike = np.ones((count, count))
    for axis in known.here.T:
        alike *= np.maximum(1 - np.abs(axis[:, None] - axis) / side, 0)
    # A window and itself are counted as often as all windows, of which these are some, have it.
    np.fill_diagonal(alike, count / len(reference_xy))
    flat = design.transpose(1, 0, 2)
    normal = np.einsum("kip,kiq->pq", flat, flat)
    common = np.einsum("kip,kiq->pq", flat, alike @ flat)
    try:
        lost = float(np.trace(np.linalg.solve(normal, common))) / (2 * count)
    except np.linalg.LinAlgError:
        return 0.0
    return min(max(lost, 0.0), MOST)
