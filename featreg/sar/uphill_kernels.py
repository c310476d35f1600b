"""Compiled climb from a start to the nearest peak of the correlation of two maps, as `featreg.sar.correlation` says."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I16 = NDArray[np.int16]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

#: What a correlation is where it is not known yet.
UNKNOWN = 2.0
#: A window of fewer steps to its standard deviation is taken in steps of its own: as many as make this the root of the
#: sum of squares, so that each number fits in 16 bits and sums of products in 32.
FEWEST, MOST_ROOT = 16, 32_700.0
#: Standard deviation, as a share of the mean, below which there are only errors of rounding.
ROUNDING = 1e-6


@compiled
def _sum_of(values: F32, count: int) -> np.float32:
    a = b = c = d = np.float32(0)
    for k in range(0, count - 3, 4):
        a, b, c, d = a + values[k], b + values[k + 1], c + values[k + 2], d + values[k + 3]
    for k in range(count // 4 * 4, count):
        a += values[k]
    return np.float32((a + b) + (c + d))


@compiled
def _level(flat: F32, start: int, width: int, rows: int, columns: int, count: int, sums: F32) -> np.float32:
    """Mean of every fourth row of the first `count` columns of a rectangle; `columns` of it may be read."""
    sums[:] = 0
    here, taken = np.uint64(start), 0
    for _ in range(0, rows, 4):
        for x in range(np.uint64(columns)):
            sums[x] += flat[here + x]
        here += np.uint64(4 * width)
        taken += count
    return np.float32(_sum_of(sums, count) / np.float32(taken))


@compiled
def _steps(
    flat: F32, start: int, width: int, rows: int, columns: int, count: int, level: np.float32, sums: F32
) -> np.float32:
    """How many steps make one: as many as bring the root of the sum of squares about a level to `MOST_ROOT`."""
    sums[:] = 0
    here, step = np.uint64(start), np.uint64(width)
    for _ in range(rows // 4):
        second, third, fourth = here + step, here + step + step, here + step + step + step
        for x in range(np.uint64(columns)):
            a, b = flat[here + x] - level, flat[second + x] - level
            c, d = flat[third + x] - level, flat[fourth + x] - level
            sums[x] += (a * a + b * b) + (c * c + d * d)
        here = fourth + step
    for _ in range(rows % 4):
        for x in range(np.uint64(columns)):
            a = flat[here + x] - level
            sums[x] += a * a
        here += step
    root = np.sqrt(np.float64(_sum_of(sums, count)))
    least = ROUNDING * abs(np.float64(level)) * np.sqrt(np.float64(rows * count))
    return np.float32(MOST_ROOT / root) if root > least else np.float32(0)


@compiled
def _whole_numbers(
    flat: F32, start: int, width: int, rows: int, columns: int, level: np.float32, steps: np.float32, out: I16,
    stride: int,
) -> None:  # fmt: skip
    """Write a rectangle of `flat`, less a level, in whole steps, to rows `stride` apart."""
    for r in range(rows):
        here, there = np.uint64(r * stride), np.uint64(start + r * width)
        for x in range(np.uint64(columns)):
            # Of positive numbers, towards zero from a half beyond is to the nearest.
            value = (flat[there + x] - level) * steps + np.float32(32768.5)
            out[here + x] = np.int16(np.int32(value) - np.int32(32768))


@compiled
def _cut(mask: I16, out: I16) -> None:
    for k in range(out.shape[0]):
        out[k] = np.int16(out[k] * mask[k])


@compiled
def _product(a: I16, b: I16, start: int, count: int) -> int:
    """Sum of products; of whole numbers it needs no order, so that the compiler takes 32 at a time."""
    total = np.int32(0)
    first = np.uint64(start)
    for k in range(np.uint64(count)):
        total = np.int32(total + np.int32(a[k]) * np.int32(b[first + k]))
    return int(total)


@compiled
def _column_sums(panel: I16, start: int, sums: I32, squares: I32) -> None:
    """Add a row of a panel, and its squares, to the sums of its columns."""
    first = np.uint64(start)
    for x in range(np.uint64(sums.shape[0])):
        value = np.int32(panel[first + x])
        sums[x] = np.int32(sums[x] + value)
        squares[x] = np.int32(squares[x] + np.int32(value * value))


@compiled
def _column_sums_of_four(panel: I16, start: int, stride: int, sums: I32, squares: I32) -> None:
    """The same of four rows."""
    first, step = np.uint64(start), np.uint64(stride)
    second, third, fourth = first + step, first + step + step, first + step + step + step
    for x in range(np.uint64(sums.shape[0])):
        a, b = np.int32(panel[first + x]), np.int32(panel[second + x])
        c, d = np.int32(panel[third + x]), np.int32(panel[fourth + x])
        sums[x] = np.int32(sums[x] + np.int32(np.int32(a + b) + np.int32(c + d)))
        one, two = np.int32(np.int32(a * a) + np.int32(b * b)), np.int32(np.int32(c * c) + np.int32(d * d))
        squares[x] = np.int32(squares[x] + np.int32(one + two))


@compiled
def _moved_sums(
    panel: I16, leave: int, enter: int, sums: I32, squares: I32, new_sums: I32, new_squares: I32
) -> None:  # fmt: skip
    """Sums of columns one row further down."""
    old, new = np.uint64(leave), np.uint64(enter)
    for x in range(np.uint64(sums.shape[0])):
        before, after = np.int32(panel[old + x]), np.int32(panel[new + x])
        new_sums[x] = np.int32(sums[x] + np.int32(after - before))
        more = np.int32(squares[x] + np.int32(after * after))
        new_squares[x] = np.int32(more - np.int32(before * before))


@compiled
def _running(sums: I32, squares: I32, sum_before: I64, square_before: I64) -> None:
    """Sums of all columns before each one."""
    total, square = np.int64(0), np.int64(0)
    for k in range(sums.shape[0]):
        sum_before[k], square_before[k] = total, square
        total += np.int64(sums[k])
        square += np.int64(squares[k])


@compiled
def climbed(
    flat_a: F32, width_a: int, steps_a: np.float32, flat_b: F32, width_b: int, steps_b: np.float32, xs: I64, ys: I64,
    us: I64, vs: I64, half: int, search: int, apart: int, now: I64, nine: F64,
) -> None:  # fmt: skip
    """Move `now` (N, 2), shifts (dx, dy), uphill, and fill `nine` (N, 3, 3) with the correlations around where it ends.

    The window of a at (xs, ys) is compared with those of b at (us, vs) + shift; both maps are given row by row. Windows
    are copied as whole numbers of steps, `steps_a` and `steps_b` of them being one: as many as the sum of the squares
    of a window's differences leaves room for in 32 bits, so that every sum is exact. Where these are too coarse for a
    window it gets its own. The first nine shifts are `apart` (at most search + 1 less the start), the others 1 px. A
    shift stays within `search`; one that would leave it stays where it is, with a higher value beside it. Each shift is
    looked at once; of equal ones the first in reading order is taken.
    """
    side, far = 2 * half + 1, search + 1
    shifts, wide = 2 * far + 1, side + 2 * far
    # Rows follow one another without a gap; as many columns as fill whole vectors are looked at, the last of them those
    # of the row below.
    stride, columns_read, window_read = wide, (wide + 16) // 16 * 16, (side + 15) // 16 * 16
    # Whole vectors, several at a time.
    count = (side * stride + 127) // 128 * 128
    # What is beyond a window stays 0.
    window, other = np.zeros(count + 64, np.int16), np.zeros((wide + 1) * stride + 128 + 64, np.int16)
    columns, squares = np.empty((shifts, columns_read), np.int32), np.empty((shifts, columns_read), np.int32)
    sum_before = np.empty((shifts, columns_read), np.int64)
    square_before = np.empty((shifts, columns_read), np.int64)
    values = np.empty((shifts, shifts), np.float64)
    inside, line = np.zeros(count + 64, np.int16), np.empty(columns_read, np.float32)
    for r in range(side):
        inside[r * stride : r * stride + side] = 1
    area = np.int64(side * side)
    for i in range(xs.shape[0]):
        corner_a = (ys[i] - half) * width_a + xs[i] - half
        corner_b = (vs[i] - half - far) * width_b + us[i] - half - far
        # Whole vectors are quicker, where the maps do not end before; what is beyond a window has to be 0.
        across_a = window_read if corner_a + (side - 1) * width_a + window_read <= flat_a.shape[0] else side
        across_b = columns_read if corner_b + (wide - 1) * width_b + columns_read <= flat_b.shape[0] else wide
        level_a, level_b = flat_a[ys[i] * width_a + xs[i]], flat_b[vs[i] * width_b + us[i]]
        gain_a, gain_b = steps_a, steps_b
        x, y = min(max(now[i, 0], -search), search), min(max(now[i, 1], -search), search)
        low = high = y + far - apart
        sum_a, power_a = 0, 0
        for own in range(2):
            if own:
                level_a = _level(flat_a, corner_a, width_a, side, across_a, side, line)
                gain_a = _steps(flat_a, corner_a, width_a, side, across_a, side, level_a, line)
                level_b = _level(flat_b, corner_b, width_b, wide, across_b, wide, line)
                gain_b = _steps(flat_b, corner_b, width_b, wide, across_b, wide, level_b, line)
            _whole_numbers(flat_a, corner_a, width_a, side, across_a, level_a, gain_a, window, stride)
            if across_a > side:
                _cut(inside, window)
            _whole_numbers(flat_b, corner_b, width_b, wide, across_b, level_b, gain_b, other, stride)
            sum_a = _product(window, inside, 0, count)
            power_a = int(area * _product(window, window, 0, count)) - sum_a * sum_a
            # Sums of columns are known from row `low` to row `high` on, at first of the first that is wanted.
            columns[low, :], squares[low, :] = 0, 0
            for r in range(low, low + side - 3, 4):
                _column_sums_of_four(other, r * stride, stride, columns[low], squares[low])
            for r in range(low + side // 4 * 4, low + side):
                _column_sums(other, r * stride, columns[low], squares[low])
            _running(columns[low], squares[low], sum_before[low], square_before[low])
            sum_b = sum_before[low, x + far + side] - sum_before[low, x + far]
            power_b = area * (square_before[low, x + far + side] - square_before[low, x + far]) - sum_b * sum_b
            if min(power_a, power_b) >= (FEWEST * area) ** 2:
                break
        values[:] = UNKNOWN
        climbing, step = True, apart
        while climbing:
            best, top = 0, -UNKNOWN
            for k in range(9):
                dx, dy = x + far + (k % 3 - 1) * step, y + far + (k // 3 - 1) * step
                value = values[dy, dx]
                if value == UNKNOWN:
                    while high < dy:
                        _moved_sums(
                            other, high * stride, (high + side) * stride, columns[high], squares[high],
                            columns[high + 1], squares[high + 1],
                        )  # fmt: skip
                        high += 1
                        _running(columns[high], squares[high], sum_before[high], square_before[high])
                    while low > dy:
                        _moved_sums(
                            other, (low + side - 1) * stride, (low - 1) * stride, columns[low], squares[low],
                            columns[low - 1], squares[low - 1],
                        )  # fmt: skip
                        low -= 1
                        _running(columns[low], squares[low], sum_before[low], square_before[low])
                    sum_b = sum_before[dy, dx + side] - sum_before[dy, dx]
                    power_b = area * (square_before[dy, dx + side] - square_before[dy, dx]) - sum_b * sum_b
                    value = 0.0
                    # Where less than a step is all there is, there is nothing.
                    if power_a > area * area and power_b > area * area:
                        product = area * _product(window, other, dy * stride + dx, count) - sum_a * sum_b
                        value = np.float64(product) / np.sqrt(np.float64(power_a) * np.float64(power_b))
                    value = min(max(value, -1.0), 1.0)
                    values[dy, dx] = value
                if value > top:
                    best, top = k, value
            to_x, to_y = x + (best % 3 - 1) * step, y + (best // 3 - 1) * step
            # Flat ground leads nowhere: only a step to a higher value is one.
            higher = abs(to_x) <= search and abs(to_y) <= search and top > values[y + far, x + far]
            climbing = higher or step > 1
            if higher:
                x, y = to_x, to_y
            step = 1
        now[i, 0], now[i, 1] = x, y
        for k in range(9):
            nine[i, k // 3, k % 3] = values[y + far + k // 3 - 1, x + far + k % 3 - 1]
