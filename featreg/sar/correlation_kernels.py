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
def _add_square(row: F32, sums: F32, squares: F32) -> None:
    for x in range(sums.shape[0]):
        sums[x] += row[x]
        squares[x] += row[x] * row[x]


@compiled
def correlations_of_few(a: F32, b: F32, xs: I64, ys: I64, half: int, search: int, out: NDArray[np.float64]) -> None:
    """As `correlations`, each window on its own: the cost is that of the windows, not that of the image."""
    width, wide = 2 * half + 1, 2 * (half + search) + 1
    count = np.float32(width * width)
    sums_a, squares_a = np.empty(width, np.float32), np.empty(width, np.float32)
    sums_b, squares_b = np.empty(wide, np.float32), np.empty(wide, np.float32)
    products = np.empty(width, np.float32)
    for i in range(xs.shape[0]):
        left, top = xs[i] - half, ys[i] - half
        sums_a[:], squares_a[:] = 0, 0
        for y in range(top, top + width):
            _add_square(a[y, left : left + width], sums_a, squares_a)
        mean_a = np.float64(_window_total(sums_a, 0, width) / count)
        power_a = _window_total(squares_a, 0, width) / count
        va = np.float64(power_a) - mean_a * mean_a
        for dy in range(-search, search + 1):
            sums_b[:], squares_b[:] = 0, 0
            for y in range(top, top + width):
                _add_square(b[y + dy, left - search : left - search + wide], sums_b, squares_b)
            for dx in range(-search, search + 1):
                products[:] = 0
                for y in range(top, top + width):
                    _enter_window(a[y, left : left + width], b[y + dy, left + dx : left + dx + width], products)
                mean_b = np.float64(_window_total(sums_b, dx + search, width) / count)
                power_b = _window_total(squares_b, dx + search, width) / count
                vb = np.float64(power_b) - mean_b * mean_b
                flat = va <= 1e-5 * power_a or vb <= 1e-5 * power_b
                covariance = np.float64(_window_total(products, 0, width) / count) - mean_a * mean_b
                value = 0.0 if flat else covariance / np.sqrt(va * vb)
                out[i, dy + search, dx + search] = min(max(value, -1.0), 1.0)
