"""Displacements judged by their neighbours, and cells without one filled from around."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.types import BoolArray

F32 = NDArray[np.float32]

#: Uncertainty of a displacement that no neighbourhood need fall below, px.
NOISE = 0.15
#: Neighbours that a cell needs to be judged by them.
LEAST = 3


def outliers(field: F32, good: BoolArray, limit: float, noise: float = NOISE) -> BoolArray:
    """Return which good cells disagree with the good ones among their eight neighbours: the normalised median test.

    Parameters
    ----------
    field : (rows, cols, 2) float32 displacement, px
    good : (rows, cols) bool, cells that have one
    limit : largest distance from the median of the neighbours, over their own median distance from it plus `noise`
    noise : px

    References
    ----------
    J. Westerweel, F. Scarano, "Universal outlier detection for PIV data", Exp. Fluids 39 (2005) 1096,
    DOI 10.1007/s00348-005-0016-6
    """
    from featreg.displacement.neighbour_kernels import disagreeing

    bad = np.zeros(good.shape, np.bool_)
    disagreeing(np.asarray(field, np.float64), good, limit, noise, LEAST, bad)
    return bad


def company(good: BoolArray) -> NDArray[np.int64]:
    """Return how many of the eight neighbours of each cell are good."""
    wide = np.pad(good.astype(np.int64), 1)
    rows, cols = good.shape
    return np.asarray(sum(wide[j : j + rows, i : i + cols] for j in range(3) for i in range(3)) - good, np.int64)


def smoothed(field: F32) -> F32:
    """Return the median of each cell and its eight neighbours, component by component: edges stay where they are."""
    import cv2

    return np.stack([cv2.medianBlur(np.ascontiguousarray(field[..., k], np.float32), 3) for k in range(2)], axis=-1)


def filled(field: F32, good: BoolArray) -> F32:
    """Return the field with cells that are not good at the mean of the nearest good ones; 0 where there is none."""
    import cv2

    if good.all():
        return field
    if not good.any():
        return np.zeros_like(field)
    levels = [(np.where(good[..., None], field, 0).astype(np.float32), good.astype(np.float32))]
    while not (levels[-1][1] > 0).all():
        size = tuple((n + 1) // 2 for n in levels[-1][1].shape[::-1])
        total = cv2.resize(levels[-1][0] * levels[-1][1][..., None], size, interpolation=cv2.INTER_AREA)
        weight = cv2.resize(levels[-1][1], size, interpolation=cv2.INTER_AREA)
        known = weight > 0
        mean = total.reshape(*weight.shape, 2) / np.where(known, weight, 1)[..., None]
        levels.append((mean.astype(np.float32), known.astype(np.float32)))
    whole = levels[-1][0]
    for part, weight in levels[-2::-1]:
        above = cv2.resize(whole, weight.shape[::-1], interpolation=cv2.INTER_LINEAR).reshape(*weight.shape, 2)
        whole = np.where(weight[..., None] > 0, part, above)
    return np.asarray(whole, np.float32)
