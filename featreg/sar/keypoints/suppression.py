"""Adaptive non-maximal suppression: strong points that also lie far from stronger ones.

References
----------
M. Brown, R. Szeliski, S. Winder, "Multi-image matching using multi-scale oriented patches", CVPR 2005, DOI
10.1109/CVPR.2005.235.
"""

from __future__ import annotations

import numpy as np

from featreg.types import FloatArray, IntArray

# Nearest neighbours asked first for a stronger one, and points compared with all at a time.
NEIGHBOURS, ROWS = 16, 512


def suppression_radius(xy: FloatArray, score: FloatArray, robust: float = 0.9) -> FloatArray:
    """Return the (N,) distance in pixels of each point to the nearest one that is clearly stronger.

    Parameters
    ----------
    xy : (N, 2) px
    score : (N,) higher is stronger
    robust : a point is clearly stronger where this times its score is above the other's

    Returns
    -------
    inf where there is none.
    """
    from scipy.spatial import cKDTree

    radius = np.full(len(xy), np.inf)
    if len(xy) < 2:
        return radius
    distance, at = (np.asarray(part) for part in cKDTree(xy).query(xy, k=min(NEIGHBOURS, len(xy))))
    stronger = robust * score[at] > score[:, None]
    found = stronger.any(axis=1)
    radius[found] = distance[found, stronger[found].argmax(axis=1)]
    left = np.flatnonzero(~found)
    for start in range(0, len(left), ROWS):
        rows = left[start : start + ROWS]
        away = np.hypot(*(xy[rows][:, None] - xy[None]).transpose(2, 0, 1))
        away[robust * score[None] <= score[rows][:, None]] = np.inf
        radius[rows] = away.min(axis=1)
    return radius


def well_spread(xy: FloatArray, score: FloatArray, count: int, robust: float = 0.9) -> IntArray:
    """Return the rows of the `count` points of largest suppression radius, larger ones first, ties by score and row."""
    return np.lexsort((-score, -suppression_radius(xy, score, robust)))[:count]
