"""Compiled loops of the order-statistic CFAR detectors; `featreg.sar.cfar` says what they compute."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.jit import compiled

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
B = NDArray[np.bool_]


@compiled
def _below(row: F32, level: np.float32) -> np.int64:
    """How many values of a row lie below a level; its own function, so that the loop becomes vector instructions."""
    count = np.int32(0)
    for j in range(row.shape[0]):
        count += np.int32(row[j] < level)
    return np.int64(count)


@compiled
def _ring_below(padded: F32, y: int, x: int, guard: int, reach: int, level: np.float32) -> int:
    """Training cells below a level around (y, x) of the padded image; cells that do not exist are +inf there."""
    count = 0
    for row in range(y - reach, y + reach + 1):
        if row < y - guard or row > y + guard:
            count += _below(padded[row, x - reach : x + reach + 1], level)
        else:
            count += _below(padded[row, x - reach : x - guard], level)
            count += _below(padded[row, x + guard + 1 : x + reach + 1], level)
    return count


@compiled
def order_statistic(
    padded: F32, counts: I64, ranks: I64, factors: F64, guard: int, reach: int, found: B
) -> None:  # fmt: skip
    """Mark the cells that exceed the factor times the rank-th smallest training cell.

    X > a X_(k) says that at least k training cells lie below X / a, so no sorting is needed.
    """
    for y in range(found.shape[0]):
        for x in range(found.shape[1]):
            n = counts[y, x]
            value = padded[y + reach, x + reach]
            found[y, x] = False
            if ranks[n] == 0 or not np.isfinite(value):
                continue
            level = np.float32(value / factors[n])
            found[y, x] = _ring_below(padded, y + reach, x + reach, guard, reach, level) >= ranks[n]


@compiled
def trimmed_mean(
    padded: F32, counts: I64, low: I64, high: I64, factors: F64, guard: int, reach: int, found: B
) -> None:  # fmt: skip
    """Mark the cells that exceed the factor times the mean of the training cells numbered low + 1 to n - high in order.

    At least half of the kept cells are as large as their middle one, so the mean is at least half of that: most cells
    are dismissed by counting, and only the rest is sorted.
    """
    ring = np.empty((2 * reach + 1) ** 2, np.float32)
    for y in range(found.shape[0]):
        for x in range(found.shape[1]):
            n = counts[y, x]
            value = padded[y + reach, x + reach]
            found[y, x] = False
            kept = n - low[n] - high[n]
            if factors[n] <= 0 or kept < 1 or not np.isfinite(value):
                continue
            middle = low[n] + kept // 2 + 1
            bound = np.float32(2.000001 * value / factors[n])
            if _ring_below(padded, y + reach, x + reach, guard, reach, bound) < middle:
                continue
            size = 0
            for row in range(y, y + 2 * reach + 1):
                for column in range(x, x + 2 * reach + 1):
                    inside = abs(row - y - reach) <= guard and abs(column - x - reach) <= guard
                    if not inside and np.isfinite(padded[row, column]):
                        ring[size] = padded[row, column]
                        size += 1
            ordered = np.sort(ring[:size])
            total = 0.0
            for i in range(low[n], n - high[n]):
                total += ordered[i]
            found[y, x] = value * kept > factors[n] * total
