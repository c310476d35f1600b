"""The compiled loop of the test against the neighbours; `featreg.displacement.neighbours` says what it computes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled
from featreg.types import BoolArray, FloatArray


@compiled
def _middle(values: NDArray[np.float64], count: int) -> float:
    """Median of the first `count` values, which are put in order."""
    for k in range(1, count):
        value, at = values[k], k
        while at > 0 and values[at - 1] > value:
            values[at] = values[at - 1]
            at -= 1
        values[at] = value
    return float((values[(count - 1) // 2] + values[count // 2]) / 2)


@compiled
def disagreeing(field: FloatArray, good: BoolArray, limit: float, noise: float, least: int, bad: BoolArray) -> None:
    """Set `bad` where a good cell (rows, cols) lies too far from the median of its good neighbours."""
    rows, cols = good.shape
    near, away = np.empty((2, 8)), np.empty(8)
    for j in range(rows):
        for i in range(cols):
            if not good[j, i]:
                continue
            count = 0
            for v in range(max(j - 1, 0), min(j + 2, rows)):
                for u in range(max(i - 1, 0), min(i + 2, cols)):
                    if good[v, u] and (v != j or u != i):
                        near[0, count], near[1, count] = field[v, u, 0], field[v, u, 1]
                        count += 1
            if count < least:
                continue
            total = 0.0
            for k in range(2):
                middle = _middle(near[k], count)
                for n in range(count):
                    away[n] = abs(near[k, n] - middle)
                spread = _middle(away, count)
                total += ((field[j, i, k] - middle) / (spread + noise)) ** 2
            bad[j, i] = total > limit * limit
