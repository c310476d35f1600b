"""Compiled loops of the order-statistic CFAR detectors; `featreg.sar.obcls.cfar` says what they compute."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
B = NDArray[np.bool_]
# Steps of the ladder up to the mean at which a cell is just detected.
STEPS = 8


@compiled
def _below(row: F32, level: np.float32) -> int:
    """How many values of a row lie below a level; its own function, so that the loop becomes vector instructions."""
    count = 0
    for j in range(row.shape[0]):
        count += row[j] < level
    return count


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

    Counting how many training cells lie below a ladder of levels bounds that mean from both sides, a step of the ladder
    apart: only the cells within that step of the threshold are sorted for.
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
            least = value / factors[n]
            # At least half of the kept cells are as large as the middle one: most cells are dismissed here.
            bound = np.float32(2.000001 * least)
            if _ring_below(padded, y + reach, x + reach, guard, reach, bound) < low[n] + kept // 2 + 1:
                continue
            step, floor = least / STEPS, 0.0
            for i in range(1, 100):
                below = _ring_below(padded, y + reach, x + reach, guard, reach, np.float32(i * step))
                above = n - high[n] - max(below, low[n])
                if above <= 0 or floor > least:
                    break
                floor += step * above / kept
            if floor > least * 1.00001:
                continue
            if above <= 0 and floor + step < least * 0.99999:
                found[y, x] = True
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


@compiled
def _whole_row(outer_top: F64, outer_bottom: F64, inner_top: F64, inner_bottom: F64, width: int, guard: int,
               tested: F32, scale: F64, found: B) -> None:  # fmt: skip
    """One row of the cell-averaging test; the rows are those of the integral image at the edges of the two squares."""
    o = outer_bottom.shape[0] - width
    g = 2 * guard + 1
    start = (o - g) // 2
    a, b = outer_top[:width], outer_top[o:]
    c, d = outer_bottom[:width], outer_bottom[o:]
    e, f = inner_top[start : start + width], inner_top[start + g : start + g + width]
    h, k = inner_bottom[start : start + width], inner_bottom[start + g : start + g + width]
    for x in range(width):
        found[x] = tested[x] > scale[x] * ((d[x] - b[x]) - (c[x] - a[x]) - ((k[x] - f[x]) - (h[x] - e[x])))


@compiled
def cell_averaging(padded: F32, integral: F64, scale: F64, guard: int, reach: int, found: B) -> None:
    """Mark the cells that exceed `scale` times the sum of their training cells."""
    height, width = found.shape
    for y in range(height):
        _whole_row(
            integral[y], integral[y + 2 * reach + 1], integral[y + reach - guard], integral[y + reach + guard + 1],
            width, guard, padded[y + reach, reach : reach + width], scale[y], found[y],
        )  # fmt: skip


@compiled
def _box(integral: F64, top: int, bottom: int, left: int, right: int) -> float:
    """Sum over rows top..bottom - 1 and columns left..right - 1."""
    return float((integral[bottom, right] - integral[top, right]) - (integral[bottom, left] - integral[top, left]))


@compiled
def sided(
    padded: F32, integral: F64, cells: F64, greatest: bool, factors: F64, guard: int, reach: int, found: B
) -> None:  # fmt: skip
    """Mark the cells that exceed the factor times the greatest (smallest) of the means of the window's four sides.

    `cells` is the integral image of the cells that exist; `factors` (5, N) is by the sides that take part and the mean
    number of their cells.
    """
    long, thick = reach + guard + 1, reach - guard
    least = 0.5 * long * thick
    total = np.empty(4)
    count = np.empty(4)
    for y in range(found.shape[0]):
        for x in range(found.shape[1]):
            bottom, right = y + 2 * reach + 1, x + 2 * reach + 1
            for image, out in ((integral, total), (cells, count)):
                out[0] = _box(image, y, y + thick, x, x + long)
                out[1] = _box(image, y, y + long, right - thick, right)
                out[2] = _box(image, bottom - thick, bottom, right - long, right)
                out[3] = _box(image, bottom - long, bottom, x, x + thick)
            best, sides, number = 0.0, 0, 0.0
            for i in range(4):
                if count[i] < least:
                    continue
                mean = total[i] / count[i]
                if sides == 0 or (mean > best if greatest else mean < best):
                    best = mean
                sides += 1
                number += count[i]
            found[y, x] = False
            if sides:
                factor = factors[sides, int(number / sides + 0.5)]
                found[y, x] = padded[y + reach, x + reach] > factor * best
