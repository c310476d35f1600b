"""Compiled loops of dense local correlation; `featreg.sar.correlation` says what they compute."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]


@compiled
def _move_window(enter_a: F32, enter_b: F32, leave_a: F32, leave_b: F32, sums: F32) -> None:
    for x in range(sums.shape[0]):
        sums[x] += enter_a[x] * enter_b[x] - leave_a[x] * leave_b[x]


@compiled
def _enter_window(enter_a: F32, enter_b: F32, sums: F32) -> None:
    for x in range(sums.shape[0]):
        sums[x] += enter_a[x] * enter_b[x]


@compiled
def _window_total(sums: F32, start: int, count: int) -> np.float32:
    """Sum of `count` values: four running totals, so that the additions need not wait for each other."""
    a = b = c = d = np.float32(0)
    fours = count // 4 * 4
    for k in range(start, start + fours, 4):
        a += sums[k]
        b += sums[k + 1]
        c += sums[k + 2]
        d += sums[k + 3]
    for k in range(start + fours, start + count):
        a += sums[k]
    return np.float32((a + b) + (c + d))


@compiled
def window_sums(a: F32, b: F32, xs: I64, ys: I64, half: int, margin: int, dx: int, dy: int, out: F32) -> None:
    """Fill out[i] with the sum over the window of a[p] * b[p + (dx, dy)] around each point, by running sums.

    Points are sorted by y and lie at least half + margin pixels inside, margin >= |dx|, |dy|. The cost hardly grows
    with their number: one row of column sums moves down the image, and a point adds up the columns of its window.
    """
    height, width = a.shape
    inner = width - 2 * margin
    sums = np.zeros(inner, np.float32)
    first, left = half + margin, margin + dx
    for y in range(first - half, first + half + 1):
        _enter_window(a[y, margin : margin + inner], b[y + dy, left : left + inner], sums)
    point = 0
    for y in range(first, height - first):
        if y > first:
            top, bottom = y - half - 1, y + half
            _move_window(
                a[bottom, margin : margin + inner],
                b[bottom + dy, left : left + inner],
                a[top, margin : margin + inner],
                b[top + dy, left : left + inner],
                sums,
            )
        while point < ys.shape[0] and ys[point] == y:
            out[point] = _window_total(sums, xs[point] - margin - half, 2 * half + 1)
            point += 1
        if point == ys.shape[0]:
            break


@compiled
def correlations(
    a: F32, b: F32, mean_b: F32, square_b: F32, xs: I64, ys: I64, half: int, search: int, out: NDArray[np.float64]
) -> None:
    """Fill out[i, dy, dx] with the correlation coefficient of the windows of `a` at a point and of `b` shifted.

    `mean_b` and `square_b` (H, W) are the means of b and of b^2 over the window around every pixel.
    """
    n = xs.shape[0]
    ones = np.ones_like(a)
    count = np.float32((2 * half + 1) ** 2)
    mean, square, product = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32)
    window_sums(a, ones, xs, ys, half, search, 0, 0, mean)
    window_sums(a, a, xs, ys, half, search, 0, 0, square)
    for dy in range(-search, search + 1):
        for dx in range(-search, search + 1):
            window_sums(a, b, xs, ys, half, search, dx, dy, product)
            for i in range(n):
                x, y = xs[i] + dx, ys[i] + dy
                ma, mb = np.float64(mean[i] / count), np.float64(mean_b[y, x])
                va = np.float64(square[i] / count) - ma * ma
                vb = np.float64(square_b[y, x]) - mb * mb
                # A window whose variance is rounding error of its mean square is constant.
                flat = va <= 1e-5 * square[i] / count or vb <= 1e-5 * square_b[y, x]
                covariance = np.float64(product[i] / count) - ma * mb
                value = 0.0 if flat else covariance / np.sqrt(va * vb)
                out[i, dy + search, dx + search] = min(max(value, -1.0), 1.0)


@compiled
def _sum_of_eights(sums: F32) -> np.float32:
    """Sum of a number of values that is a multiple of eight, in four running totals."""
    a = b = c = d = np.float32(0)
    for k in range(0, sums.shape[0], 4):
        a += sums[k]
        b += sums[k + 1]
        c += sums[k + 2]
        d += sums[k + 3]
    return np.float32((a + b) + (c + d))


@compiled
def _product(window: F32, wide: int, flat: F32, start: int, width: int, sums: F32) -> np.float32:
    """Sum of products of a window, whose rows of `wide` values are stored one after the other, and of one in `flat`.

    That one begins at `start` and has rows `width` apart. Indices are unsigned, so that the compiler need not look for
    negative ones and takes eight values at once; `wide` is a multiple of eight, and the surplus of `window` is 0.
    """
    here, there = np.uint64(0), np.uint64(start)
    down, across = np.uint64(wide), np.uint64(width)
    rows = window.shape[0] // wide
    sums[:] = 0
    for _ in range(rows // 4):
        here1, here2, here3 = here + down, here + down + down, here + down + down + down
        there1, there2, there3 = there + across, there + across + across, there + across + across + across
        for x in range(down):
            sums[x] += (window[here + x] * flat[there + x] + window[here1 + x] * flat[there1 + x]) + (
                window[here2 + x] * flat[there2 + x] + window[here3 + x] * flat[there3 + x]
            )
        here, there = here3 + down, there3 + across
    for _ in range(rows % 4):
        for x in range(down):
            sums[x] += window[here + x] * flat[there + x]
        here, there = here + down, there + across
    return _sum_of_eights(sums)


@compiled
def _copied_window(flat: F32, start: int, width: int, side: int, wide: int, out: F32) -> None:
    """Copy a square window of `flat` to rows of `wide` values."""
    here, there = np.uint64(0), np.uint64(start)
    for _ in range(side):
        for x in range(np.uint64(side)):
            out[here + x] = flat[there + x]
        here, there = here + np.uint64(wide), there + np.uint64(width)


@compiled
def _column_sums(
    flat: F32, start: int, width: int, rows: int, level: np.float32, sign: np.float32, sums: F32, squares: F32
) -> None:
    """Add to the sums of columns above a level, and of their squares, those of some rows; less where `sign` is -1."""
    there = np.uint64(start)
    for _ in range(rows):
        for x in range(np.uint64(sums.shape[0])):
            value = flat[there + x] - level
            sums[x] += sign * value
            squares[x] += sign * (value * value)
        there += np.uint64(width)


@compiled
def correlations_of_few(
    flat_a: F32, width_a: int, flat_b: F32, width_b: int, xs: I64, ys: I64, us: I64, vs: I64, half: int, search: int,
    out: NDArray[np.float64],
) -> None:  # fmt: skip
    """As `correlations`, each window on its own: the cost is that of the windows, not that of the image.

    The window of a at (xs, ys) is compared with those of b around (us, vs); both are given row by row.
    """
    side = 2 * half + 1
    wide, wider = (side + 7) // 8 * 8, side + 2 * search
    count = np.float64(side * side)
    window = np.zeros(side * wide, np.float32)
    sums = np.empty(wide, np.float32)
    columns, squares = np.empty(wider, np.float32), np.empty(wider, np.float32)
    one = np.float32(1)
    for i in range(xs.shape[0]):
        _copied_window(flat_a, (ys[i] - half) * width_a + xs[i] - half, width_a, side, wide, window)
        total = 0.0
        for y in range(side):
            for x in range(side):
                total += np.float64(window[y * wide + x])
        mean_a = np.float32(total / count)
        # What rounding leaves of the mean would count once for the level of the other window.
        rest = 0.0
        for y in range(side):
            for x in range(side):
                window[y * wide + x] -= mean_a
                rest += np.float64(window[y * wide + x])
        power_a = np.float64(_product(window, wide, window, 0, wide, sums))
        flat = power_a <= 1e-5 * (power_a + total * total / count)
        # Sums of squares lose digits on a high level; any value nearby will do.
        level = flat_b[vs[i] * width_b + us[i]]
        power_of_level = count * np.float64(level) ** 2
        corner = (vs[i] - half - search) * width_b + us[i] - half - search
        columns[:], squares[:] = 0, 0
        _column_sums(flat_b, corner, width_b, side, level, one, columns, squares)
        for dy in range(2 * search + 1):
            sum_b, square_b = 0.0, 0.0
            for x in range(side):
                sum_b += np.float64(columns[x])
                square_b += np.float64(squares[x])
            for dx in range(2 * search + 1):
                power_b = square_b - sum_b * sum_b / count
                value = 0.0
                if not (flat or power_b <= 1e-5 * (square_b + power_of_level)):
                    product = _product(window, wide, flat_b, corner + dy * width_b + dx, width_b, sums)
                    value = (np.float64(product) - rest * np.float64(level)) / np.sqrt(power_a * power_b)
                out[i, dy, dx] = min(max(value, -1.0), 1.0)
                if dx < 2 * search:
                    sum_b += np.float64(columns[side + dx]) - np.float64(columns[dx])
                    square_b += np.float64(squares[side + dx]) - np.float64(squares[dx])
            if dy < 2 * search:
                _column_sums(flat_b, corner + dy * width_b, width_b, 1, level, -one, columns, squares)
                _column_sums(flat_b, corner + (dy + side) * width_b, width_b, 1, level, one, columns, squares)
