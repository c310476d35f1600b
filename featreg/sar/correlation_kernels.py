"""Compiled loops of dense local correlation; `featreg.sar.correlation` says what they compute."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]

#: Values from one row of a panel to the next, as the compiler is to know them, and the largest shift that leaves room.
STRIDE, MOST_SEARCH = 64, 28
ROW, ROW2, ROW3, ROW4 = np.uint64(64), np.uint64(128), np.uint64(192), np.uint64(256)
ROW5, ROW6, ROW7, ROW8 = np.uint64(320), np.uint64(384), np.uint64(448), np.uint64(512)


@compiled
def _move_products(enter_a: F32, enter_b: F32, leave_a: F32, leave_b: F32, sums: F32) -> None:
    for x in range(sums.shape[0]):
        sums[x] += enter_a[x] * enter_b[x] - leave_a[x] * leave_b[x]


@compiled
def _enter_products(enter_a: F32, enter_b: F32, sums: F32) -> None:
    for x in range(sums.shape[0]):
        sums[x] += enter_a[x] * enter_b[x]


@compiled
def _move_values(enter: F32, leave: F32, sums: F32, squares: F32) -> None:
    for x in range(sums.shape[0]):
        sums[x] += enter[x] - leave[x]
        squares[x] += enter[x] * enter[x] - leave[x] * leave[x]


@compiled
def _enter_values(enter: F32, sums: F32, squares: F32) -> None:
    for x in range(sums.shape[0]):
        sums[x] += enter[x]
        squares[x] += enter[x] * enter[x]


@compiled
def _window_total(sums: F32, start: int, count: int) -> np.float32:
    """Sum of `count` values: four running totals, so that the additions need not wait for each other."""
    here = np.uint64(start)
    a = b = c = d = np.float32(0)
    for _ in range(count // 4):
        a += sums[here]
        b += sums[here + np.uint64(1)]
        c += sums[here + np.uint64(2)]
        d += sums[here + np.uint64(3)]
        here += np.uint64(4)
    for _ in range(count % 4):
        a += sums[here]
        here += np.uint64(1)
    return np.float32((a + b) + (c + d))


@compiled
def correlations(a: F32, b: F32, xs: I64, ys: I64, half: int, search: int, out: NDArray[np.float64]) -> None:
    """Fill out[i, dy, dx] with the correlation coefficient of the windows of `a` at a point and of `b` shifted.

    Points are sorted by y and lie at least half + search pixels inside. Both maps have a mean near 0. The cost hardly
    grows with the number of points: for every shift, a row of column sums moves down the image, all of them together
    so that the rows they read stay in the cache; a point adds up the columns of its window.
    """
    n = xs.shape[0]
    if n == 0:
        return
    width = a.shape[1]
    side, wide = 2 * search + 1, 2 * half + 1
    inner, margin = width - 2 * search, search
    count = np.float64(wide * wide)
    products = np.zeros((side * side, inner), np.float32)
    sum_a, square_a = np.zeros(width, np.float32), np.zeros(width, np.float32)
    sum_b, square_b = np.zeros((side, width), np.float32), np.zeros((side, width), np.float32)
    first = ys[0]
    for y in range(first - half, first + half + 1):
        _enter_values(a[y], sum_a, square_a)
        for dy in range(side):
            row = y + dy - search
            _enter_values(b[row], sum_b[dy], square_b[dy])
            for dx in range(side):
                _enter_products(a[y, margin : margin + inner], b[row, dx : dx + inner], products[dy * side + dx])
    point = 0
    for y in range(first, ys[n - 1] + 1):
        if y > first:
            top, bottom = y - half - 1, y + half
            _move_values(a[bottom], a[top], sum_a, square_a)
            for dy in range(side):
                enter, leave = bottom + dy - search, top + dy - search
                _move_values(b[enter], b[leave], sum_b[dy], square_b[dy])
                for dx in range(side):
                    _move_products(
                        a[bottom, margin : margin + inner],
                        b[enter, dx : dx + inner],
                        a[top, margin : margin + inner],
                        b[leave, dx : dx + inner],
                        products[dy * side + dx],
                    )
        while point < n and ys[point] == y:
            left = xs[point] - half
            mean = np.float64(_window_total(sum_a, left, wide)) / count
            power = np.float64(_window_total(square_a, left, wide)) / count
            va = power - mean * mean
            # A window whose variance is rounding error of its mean square is constant.
            flat = va <= 1e-5 * power
            for dy in range(side):
                start = left - search
                moved = np.float64(_window_total(sum_b[dy], start, wide))
                square = np.float64(_window_total(square_b[dy], start, wide))
                for dx in range(side):
                    mb, sb = moved / count, square / count
                    vb = sb - mb * mb
                    value = 0.0
                    if not (flat or vb <= 1e-5 * sb):
                        product = np.float64(_window_total(products[dy * side + dx], start, wide))
                        value = (product / count - mean * mb) / np.sqrt(va * vb)
                    out[point, dy, dx] = min(max(value, -1.0), 1.0)
                    if dx < side - 1:
                        enter, leave = start + wide + dx, start + dx
                        moved += np.float64(sum_b[dy, enter]) - np.float64(sum_b[dy, leave])
                        square += np.float64(square_b[dy, enter]) - np.float64(square_b[dy, leave])
            point += 1


@compiled
def _sum_of_eights(sums: F32, count: int) -> np.float32:
    """Sum of a number of values that is a multiple of eight, in four running totals."""
    a = b = c = d = np.float32(0)
    for k in range(0, count, 4):
        a += sums[k]
        b += sums[k + 1]
        c += sums[k + 2]
        d += sums[k + 3]
    return np.float32((a + b) + (c + d))


@compiled
def _product(window: F32, other: F32, start: int, shift: int, wide: int, rows: int, sums: F32) -> np.float32:
    """Sum of products of two panels, one from `start` on, the other from `start` + `shift` on.

    Indices are unsigned, so that the compiler need not look for negative ones, and rows are a known length apart: it
    takes eight products of a column, and eight columns at once. `wide` and `rows` are multiples of eight.
    """
    sums[:] = 0
    here, there = np.uint64(start), np.uint64(start + shift)
    for _ in range(rows // 8):
        for x in range(np.uint64(wide)):
            i, j = here + x, there + x
            sums[x] += (
                (window[i] * other[j] + window[i + ROW] * other[j + ROW])
                + (window[i + ROW2] * other[j + ROW2] + window[i + ROW3] * other[j + ROW3])
            ) + (
                (window[i + ROW4] * other[j + ROW4] + window[i + ROW5] * other[j + ROW5])
                + (window[i + ROW6] * other[j + ROW6] + window[i + ROW7] * other[j + ROW7])
            )
        here, there = here + ROW8, there + ROW8
    return _sum_of_eights(sums, wide)


@compiled
def _copied(flat: F32, start: int, width: int, rows: int, columns: int, level: np.float32, out: F32, at: int) -> None:
    """Copy a rectangle of `flat`, less a level, to the rows of a panel that begins at `at`."""
    here, there = np.uint64(at), np.uint64(start)
    for _ in range(rows):
        for x in range(np.uint64(columns)):
            out[here + x] = flat[there + x] - level
        here, there = here + ROW, there + np.uint64(width)


@compiled
def _column_sums(panel: F32, start: int, rows: int, sign: np.float32, sums: F32, squares: F32) -> None:
    """Add to the sums of columns, and of their squares, those of some rows of a panel; less where `sign` is -1."""
    here = np.uint64(start)
    for _ in range(rows):
        for x in range(np.uint64(sums.shape[0])):
            value = panel[here + x]
            sums[x] += sign * value
            squares[x] += sign * (value * value)
        here += ROW


@compiled
def correlations_of_few(
    flat_a: F32, width_a: int, flat_b: F32, width_b: int, xs: I64, ys: I64, us: I64, vs: I64, half: int, search: int,
    out: NDArray[np.float64],
) -> None:  # fmt: skip
    """As `correlations`, each window on its own: the cost is that of the windows, not that of the image.

    The window of a at (xs, ys) is compared with those of b around (us, vs); both are given row by row. Windows are
    copied, less a value nearby so that sums of squares keep their digits, to panels whose rows are `STRIDE` values
    apart; a wide one takes several panels, side by side. `search` is at most `MOST_SEARCH`.
    """
    side, shifts = 2 * half + 1, 2 * search + 1
    # Of a panel of b so many columns more are read than of one of a.
    panel = (STRIDE - 2 * search) // 8 * 8
    panels, tall = (side + panel - 1) // panel, (side + 7) // 8 * 8
    size = (tall + 2 * search) * STRIDE
    count = np.float64(side * side)
    # What is beyond a window stays 0.
    window, other = np.zeros(panels * size, np.float32), np.zeros(panels * size, np.float32)
    sums = np.empty(panel, np.float32)
    columns, squares = np.empty(side + 2 * search, np.float32), np.empty(side + 2 * search, np.float32)
    one = np.float32(1)
    for i in range(xs.shape[0]):
        level_a, level_b = flat_a[ys[i] * width_a + xs[i]], flat_b[vs[i] * width_b + us[i]]
        corner_a = (ys[i] - half) * width_a + xs[i] - half
        corner_b = (vs[i] - half - search) * width_b + us[i] - half - search
        total, power_a = 0.0, 0.0
        for p in range(panels):
            across = min(panel, side - p * panel)
            _copied(flat_a, corner_a + p * panel, width_a, side, across, level_a, window, p * size)
            _copied(
                flat_b, corner_b + p * panel, width_b, side + 2 * search, across + 2 * search, level_b, other, p * size
            )
            part, square = columns[:across], squares[:across]
            part[:], square[:] = 0, 0
            _column_sums(window, p * size, side, one, part, square)
            for x in range(across):
                total += np.float64(part[x])
                power_a += np.float64(square[x])
        mean_a = total / count
        power_a -= total * mean_a
        squared = np.float64(level_a) + mean_a
        flat = power_a <= 1e-5 * (power_a + count * squared * squared)
        power_of_level = count * np.float64(level_b) ** 2
        columns[:], squares[:] = 0, 0
        for p in range(panels):
            last = side + 2 * search if p == panels - 1 else (p + 1) * panel
            _column_sums(other, p * size, side, one, columns[p * panel : last], squares[p * panel : last])
        for dy in range(shifts):
            sum_b, square_b = 0.0, 0.0
            for x in range(side):
                sum_b += np.float64(columns[x])
                square_b += np.float64(squares[x])
            for dx in range(shifts):
                power_b = square_b - sum_b * sum_b / count
                value = 0.0
                if not (flat or power_b <= 1e-5 * (square_b + power_of_level)):
                    product = 0.0
                    for p in range(panels):
                        wide = (min(panel, side - p * panel) + 7) // 8 * 8
                        product += np.float64(_product(window, other, p * size, dy * STRIDE + dx, wide, tall, sums))
                    value = (product - mean_a * sum_b) / np.sqrt(power_a * power_b)
                out[i, dy, dx] = min(max(value, -1.0), 1.0)
                if dx < shifts - 1:
                    sum_b += np.float64(columns[side + dx]) - np.float64(columns[dx])
                    square_b += np.float64(squares[side + dx]) - np.float64(squares[dx])
            if dy < shifts - 1:
                for p in range(panels):
                    last = side + 2 * search if p == panels - 1 else (p + 1) * panel
                    part, square = columns[p * panel : last], squares[p * panel : last]
                    _column_sums(other, p * size + dy * STRIDE, 1, -one, part, square)
                    _column_sums(other, p * size + (dy + side) * STRIDE, 1, one, part, square)


@compiled
def highest_peaks(
    values: NDArray[np.float64],
    shift: NDArray[np.float64],
    height: NDArray[np.float64],
    curvature: NDArray[np.float64],
    sound: NDArray[np.bool_],
) -> None:
    """Fill shift (N, 2), height (N,), curvature (N, 2, 2) and sound (N,) of the highest of each of (N, K, K) values.

    The step from the highest is that of `featreg.sar.correlation.quadratic_steps`, in the same order of sums.
    """
    side = values.shape[1]
    for i in range(values.shape[0]):
        part = values[i]
        row, col = 0, 0
        for y in range(side):
            for x in range(side):
                if part[y, x] > part[row, col]:
                    row, col = y, x
        height[i] = part[row, col]
        inside = row > 0 and row < side - 1 and col > 0 and col < side - 1
        r, c = min(max(row, 1), side - 2), min(max(col, 1), side - 2)
        left = (part[r - 1, c - 1] + part[r, c - 1]) + part[r + 1, c - 1]
        middle = (part[r - 1, c] + part[r, c]) + part[r + 1, c]
        right = (part[r - 1, c + 1] + part[r, c + 1]) + part[r + 1, c + 1]
        gx = (right - left) / 6
        gy = (
            part[r + 1, c + 1] + part[r + 1, c] + part[r + 1, c - 1]
            - part[r - 1, c + 1] - part[r - 1, c] - part[r - 1, c - 1]
        ) / 6  # fmt: skip
        hxx = (right + left - 2 * middle) / 3
        hyy = 0.0
        for u in range(-1, 2):
            hyy += part[r + 1, c + u] + part[r - 1, c + u] - 2 * part[r, c + u]
        hyy /= 3
        hxy = (part[r + 1, c + 1] + part[r - 1, c - 1] - part[r - 1, c + 1] - part[r + 1, c - 1]) / 4
        determinant = hxx * hyy - hxy * hxy
        curved = determinant > 1e-12 and hxx < 0 and hyy < 0
        dx, dy = 0.0, 0.0
        if curved:
            dx, dy = -(hyy * gx - hxy * gy) / determinant, -(hxx * gy - hxy * gx) / determinant
        good = inside and curved and abs(dx) <= 1 and abs(dy) <= 1
        sound[i] = good
        shift[i, 0] = col - side // 2 + (dx if good else 0.0)
        shift[i, 1] = row - side // 2 + (dy if good else 0.0)
        curvature[i, 0, 0], curvature[i, 1, 1] = -hxx, -hyy
        curvature[i, 0, 1] = curvature[i, 1, 0] = -hxy
