"""Which of many points are drawn."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.types import FloatArray


def spread_out(xy: FloatArray, score: FloatArray, count: int) -> NDArray[np.int64]:
    """Rows of at most `count` points that cover the area: the best of every cell of a grid, then the second best."""
    if len(xy) <= count:
        return np.arange(len(xy))
    low, extent = xy.min(axis=0), np.maximum(np.ptp(xy, axis=0), 1e-9)
    cells = np.ceil(np.sqrt(count * extent / extent[::-1])).clip(1, count)
    cell = np.minimum((xy - low) / extent * cells, cells - 1).astype(np.int64) @ [1, 1 << 20]
    order = np.lexsort((-score, cell))
    first = np.r_[True, np.diff(cell[order]) != 0]
    rank = np.arange(len(xy)) - np.flatnonzero(first)[np.cumsum(first) - 1]
    return np.sort(order[np.lexsort((-score[order], rank))[:count]])
