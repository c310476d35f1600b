"""Compiled loops that correlate small windows of two fields; `windows` says what they compute."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]

#: Samples, and values, from one row of a panel to the next, as the compiler is to know them.
MOST_WIDE, STRIDE = 64, 128
ROW, ROW2, ROW3, ROW4 = np.uint64(128), np.uint64(256), np.uint64(384), np.uint64(512)
ROW5, ROW6, ROW7, ROW8 = np.uint64(640), np.uint64(768), np.uint64(896), np.uint64(1024)
ROW9, ROW10 = np.uint64(1152), np.uint64(1280)
LANES = np.uint64(16)


@compiled
def _four_products(
    a: F32, b: F32, shift: int, wide: int, rows: int, sum0: F32, sum1: F32, sum2: F32, sum3: F32
) -> None:
    """Sums over the rows of two panels of their products, column by column, at `shift` and one, two, three rows below.

    Four shifts share what they read: reading, not multiplying, is what a sum of products waits for. Indices are
    unsigned, so that the compiler need not look for negative ones. `rows` is a multiple of eight.
    """
    sum0[:], sum1[:], sum2[:], sum3[:] = 0, 0, 0, 0
    here, there = np.uint64(0), np.uint64(shift)
    for _ in range(rows // 8):
        for x in range(np.uint64(wide)):
            i, j = here + x, there + x
            a0, a1, a2, a3 = a[i], a[i + ROW], a[i + ROW2], a[i + ROW3]
            a4, a5, a6, a7 = a[i + ROW4], a[i + ROW5], a[i + ROW6], a[i + ROW7]
            b0, b1, b2, b3 = b[j], b[j + ROW], b[j + ROW2], b[j + ROW3]
            b4, b5, b6, b7 = b[j + ROW4], b[j + ROW5], b[j + ROW6], b[j + ROW7]
            b8, b9, b10 = b[j + ROW8], b[j + ROW9], b[j + ROW10]
            sum0[x] += ((a0 * b0 + a1 * b1) + (a2 * b2 + a3 * b3)) + ((a4 * b4 + a5 * b5) + (a6 * b6 + a7 * b7))
            sum1[x] += ((a0 * b1 + a1 * b2) + (a2 * b3 + a3 * b4)) + ((a4 * b5 + a5 * b6) + (a6 * b7 + a7 * b8))
            sum2[x] += ((a0 * b2 + a1 * b3) + (a2 * b4 + a3 * b5)) + ((a4 * b6 + a5 * b7) + (a6 * b8 + a7 * b9))
            sum3[x] += ((a0 * b3 + a1 * b4) + (a2 * b5 + a3 * b6)) + ((a4 * b7 + a5 * b8) + (a6 * b9 + a7 * b10))
        here, there = here + ROW8, there + ROW8


@compiled
def _totals(sum0: F32, sum1: F32, sum2: F32, sum3: F32, folded: F32, out: F32) -> None:
    """Fill out[k] with the sum of the k-th; each has a number of values that is a multiple of sixteen."""
    folded[:] = 0
    for k in range(sum0.shape[0] // 16):
        at = LANES * np.uint64(k)
        for x in range(LANES):
            folded[x] += sum0[at + x]
            folded[LANES + x] += sum1[at + x]
            folded[LANES + LANES + x] += sum2[at + x]
            folded[LANES + LANES + LANES + x] += sum3[at + x]
    for k in range(4):
        at = LANES * np.uint64(k)
        a = b = c = d = np.float32(0)
        for _ in range(4):
            a += folded[at]
            b += folded[at + np.uint64(1)]
            c += folded[at + np.uint64(2)]
            d += folded[at + np.uint64(3)]
            at += np.uint64(4)
        out[k] = (a + b) + (c + d)


@compiled
def _copied(flat: F32, height: int, width: int, y: int, x: int, rows: int, columns: int, panel: F32) -> None:
    """Copy the samples of a field (H, W, 2), given row by row, from (y, x) on to a panel; 0 outside the field."""
    low, high = max(0, -2 * x), min(2 * columns, 2 * (width - x))
    for k in range(rows):
        there = np.uint64(k * STRIDE)
        if y + k < 0 or y + k >= height:
            for i in range(np.uint64(2 * columns)):
                panel[there + i] = 0
            continue
        for i in range(np.uint64(low)):
            panel[there + i] = 0
        start = np.uint64(((y + k) * width + x) * 2 + low)
        at = there + np.uint64(low)
        for i in range(np.uint64(high - low)):
            panel[at + i] = flat[start + i]
        for i in range(np.uint64(high), np.uint64(2 * columns)):
            panel[there + i] = 0


@compiled
def _squares(panel: F32, start: int, columns: int, out: F32) -> None:
    """Fill `out` with the squared lengths of the samples of a row of a panel."""
    here = np.uint64(start)
    for x in range(np.uint64(columns)):
        i = here + np.uint64(2) * x
        out[x] = panel[i] * panel[i] + panel[i + np.uint64(1)] * panel[i + np.uint64(1)]


@compiled
def _entered(row: F32, sums: F32) -> None:
    for x in range(sums.shape[0]):
        sums[x] += row[x]


@compiled
def _moved_down(enter: F32, leave: F32, sums: F32) -> None:
    for x in range(sums.shape[0]):
        sums[x] += enter[x] - leave[x]


@compiled
def _energies(panel: F32, side: int, reach: int, squares: F32, columns: F32, out: F32) -> np.float32:
    """Fill out[dy * shifts + dx] with the energy of each displaced window; the largest of them."""
    wide, shifts = side + 2 * reach, 2 * reach + 1
    for y in range(wide):
        _squares(panel, y * STRIDE, wide, squares[y])
    columns[:] = 0
    for y in range(side):
        _entered(squares[y], columns)
    largest = np.float32(0)
    for dy in range(shifts):
        value = 0.0
        for x in range(side):
            value += np.float64(columns[x])
        for dx in range(shifts):
            out[dy * shifts + dx] = value
            largest = max(largest, np.float32(value))
            if dx < shifts - 1:
                value += np.float64(columns[side + dx]) - np.float64(columns[dx])
        if dy < shifts - 1:
            _moved_down(squares[dy + side], squares[dy], columns)
    return largest


@compiled
def _related(values: F32, energies: F32, least: np.float32, own: np.float32) -> None:
    for k in range(values.shape[0]):
        values[k] /= np.sqrt(max(energies[k], least) * own + np.float32(1e-12))


@compiled
def correlations_of_windows(
    here: F32, there: F32, height: int, width: int, ys: I64, xs: I64, side: int, reach: int, least: float, out: F32
) -> None:
    """Fill out[i, reach + dy, reach + dx] with the correlation coefficient of the windows of two fields.

    Parameters
    ----------
    here, there : the fields (H, W, 2), given row by row
    height, width : H and W
    ys, xs : (N,) first row and column of each window
    side, reach : samples of a window and its largest displacement; side + 2 * reach is at most `MOST_WIDE`
    least : energies count as at least this share of the largest
    """
    wide, shifts = side + 2 * reach, 2 * reach + 1
    rows, lanes = (side + 7) // 8 * 8, (2 * side + 15) // 16 * 16
    # What is beyond a window stays 0.
    window, other = np.zeros(rows * STRIDE, np.float32), np.zeros((rows + 2 * reach + 4) * STRIDE, np.float32)
    squares, columns = np.empty((wide, wide), np.float32), np.empty(wide, np.float32)
    energies, products = np.empty(shifts * shifts, np.float32), np.empty(shifts * shifts, np.float32)
    sum0, sum1 = np.empty(lanes, np.float32), np.empty(lanes, np.float32)
    sum2, sum3 = np.empty(lanes, np.float32), np.empty(lanes, np.float32)
    folded, totals = np.empty(64, np.float32), np.empty(4, np.float32)
    for i in range(ys.shape[0]):
        _copied(here, height, width, ys[i], xs[i], side, side, window)
        _copied(there, height, width, ys[i] - reach, xs[i] - reach, wide, wide, other)
        own = _energies(window, side, 0, squares, columns[:side], energies)
        largest = _energies(other, side, reach, squares, columns, energies)
        for dy in range(0, shifts, 4):
            for dx in range(shifts):
                _four_products(window, other, dy * STRIDE + 2 * dx, lanes, rows, sum0, sum1, sum2, sum3)
                _totals(sum0, sum1, sum2, sum3, folded, totals)
                for k in range(min(4, shifts - dy)):
                    products[(dy + k) * shifts + dx] = totals[k]
        _related(products, energies, np.float32(least * largest), own)
        for dy in range(shifts):
            for dx in range(shifts):
                out[i, dy, dx] = products[dy * shifts + dx]
