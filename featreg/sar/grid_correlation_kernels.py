"""Compiled loops of correlation on a grid of windows; `featreg.sar.grid_correlation` says what they compute."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

#: Sums of a piece of `piece_slopes`.
SUMS = 5
#: Pieces of equal weight that are spent on the shift.
FEW = 1.0


@compiled
def _eight_products(a: F32, b: F32, sums: F32) -> None:
    """Products of eight rows, added up along the columns."""
    a0, a1, a2, a3, a4, a5, a6, a7 = a[0], a[1], a[2], a[3], a[4], a[5], a[6], a[7]
    b0, b1, b2, b3, b4, b5, b6, b7 = b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]
    for x in range(sums.shape[0]):
        low = (a0[x] * b0[x] + a1[x] * b1[x]) + (a2[x] * b2[x] + a3[x] * b3[x])
        sums[x] += low + ((a4[x] * b4[x] + a5[x] * b5[x]) + (a6[x] * b6[x] + a7[x] * b7[x]))


@compiled
def _add_one(a: F32, b: F32, sums: F32) -> None:
    for x in range(sums.shape[0]):
        sums[x] += a[x] * b[x]


@compiled
def _run_end(shifts: I64, r: int, first: int) -> int:
    """One past the last piece of a row from `first` on that has the same shift."""
    last = first + 1
    while (
        last < shifts.shape[1]
        and shifts[r, last, 0] == shifts[r, first, 0]
        and shifts[r, last, 1] == shifts[r, first, 1]
    ):
        last += 1
    return last


@compiled
def piece_products(a: F32, b: F32, margin: int, row_cuts: I64, col_cuts: I64, shifts: I64, out: F32) -> None:
    """Fill out[r, c, dy, dx] with the sum over a piece of a[y, x] * b[y + v, x + u] at (u, v) around its shift.

    `b` has `margin` more pixels than `a` on every side. Neighbouring pieces of one shift are summed in one run.
    """
    sums = np.empty(a.shape[1], np.float32)
    side = out.shape[2]
    for r in range(out.shape[0]):
        top, bottom = row_cuts[r], row_cuts[r + 1]
        eights = top + (bottom - top) // 8 * 8
        first = 0
        while first < out.shape[1]:
            last = _run_end(shifts, r, first)
            left, right = col_cuts[first], col_cuts[last]
            part = sums[: right - left]
            for i in range(side):
                dy = margin + shifts[r, first, 1] - side // 2 + i
                for k in range(side):
                    dx = margin + shifts[r, first, 0] - side // 2 + k
                    part[:] = 0
                    for y in range(top, eights, 8):
                        _eight_products(a[y : y + 8, left:right], b[y + dy : y + dy + 8, left + dx : right + dx], part)
                    for y in range(eights, bottom):
                        _add_one(a[y, left:right], b[y + dy, left + dx : right + dx], part)
                    for c in range(first, last):
                        total = np.float32(0)
                        for x in range(col_cuts[c] - left, col_cuts[c + 1] - left):
                            total += part[x]
                        out[r, c, i, k] = total
            first = last


@compiled
def piece_squares(total: F64, margin: int, row_cuts: I64, col_cuts: I64, shifts: I64, out: F32) -> None:
    """Fill out[r, c, dy, dx] with the sum of squares over a piece around its shift.

    `total` holds the sums of squares above and left of each pixel of an image with `margin` more pixels.
    """
    side = out.shape[2]
    for r in range(out.shape[0]):
        for c in range(out.shape[1]):
            for i in range(side):
                dy = margin + shifts[r, c, 1] - side // 2 + i
                top, bottom = row_cuts[r] + dy, row_cuts[r + 1] + dy
                for k in range(side):
                    dx = margin + shifts[r, c, 0] - side // 2 + k
                    left, right = col_cuts[c] + dx, col_cuts[c + 1] + dx
                    out[r, c, i, k] = total[bottom, right] - total[top, right] - total[bottom, left] + total[top, left]


@compiled
def _add_slopes(up: F32, a: F32, down: F32, above: F32, b: F32, below: F32, sums: F32) -> None:
    """Add to the five sums of each column; all rows but `sums` begin one pixel before it."""
    half = np.float32(0.5)
    for k in range(sums.shape[1]):
        x = k + 1
        p, q = a[x], b[x]
        ax, ay = half * (a[x + 1] - a[x - 1]), half * (down[x] - up[x])
        bx, by = half * (b[x + 1] - b[x - 1]), half * (below[x] - above[x])
        axx, ayy = half * (a[x + 1] + a[x - 1]) - p, half * (down[x] + up[x]) - p
        bxx, byy = half * (b[x + 1] + b[x - 1]) - q, half * (below[x] + above[x]) - q
        sums[0, k] += half * (p * bx - ax * q)
        sums[1, k] += half * (p * by - ay * q)
        sums[2, k] -= axx * q + p * bxx
        sums[3, k] += half * (ax * by + ay * bx)
        sums[4, k] -= ayy * q + p * byy


@compiled
def piece_slopes(a: F32, b: F32, margin: int, row_cuts: I64, col_cuts: I64, shifts: I64, out: F32) -> None:
    """Fill out[r, c] with the sums over a piece, at its own shift, of slope and curvature of the correlation.

    In order: the two components of (a grad b - b grad a) / 2, and xx, xy, yy of minus the second derivatives of a b.
    Pieces lie one pixel inside `a`.
    """
    sums = np.empty((SUMS, a.shape[1]), np.float32)
    for r in range(out.shape[0]):
        first = 0
        while first < out.shape[1]:
            last = _run_end(shifts, r, first)
            left, right = col_cuts[first], col_cuts[last]
            part = sums[:, : right - left]
            part[:] = 0
            p, q = left + margin + shifts[r, first, 0] - 1, right + margin + shifts[r, first, 0] + 1
            for y in range(row_cuts[r], row_cuts[r + 1]):
                v = y + margin + shifts[r, first, 1]
                _add_slopes(
                    a[y - 1, left - 1 : right + 1], a[y, left - 1 : right + 1], a[y + 1, left - 1 : right + 1],
                    b[v - 1, p:q], b[v, p:q], b[v + 1, p:q], part,
                )  # fmt: skip
            for c in range(first, last):
                for k in range(SUMS):
                    total = np.float32(0)
                    for x in range(col_cuts[c] - left, col_cuts[c + 1] - left):
                        total += part[k, x]
                    out[r, c, k] = total
            first = last


@compiled
def _belongs(shifts: I64, r: int, c: int, x: float, y: float, limit: float) -> bool:
    """Whether a piece is read where a window whose displacement there is (x, y) looks for it."""
    return bool(abs(shifts[r, c, 0] - x) <= limit and abs(shifts[r, c, 1] - y) <= limit)


@compiled
def window_correlations(
    products: F32,
    square_a: F32,
    square_b: F32,
    shifts: I64,
    rows: I64,
    cols: I64,
    places: F64,
    expected: F64,
    limit: float,
    out: F64,
) -> None:
    """Fill out[j, i, lag] with the correlation coefficients of windows, from the sums [r, c, lag] of their pieces.

    `places` (2, most pieces) are the middles of the pieces along x and y, `expected` (rows, cols, 8) the displacement
    (dx, dy) of each window, its derivatives (xx, xy, yx, yy) and its middle (x, y): a piece whose shift is more than
    `limit` from what is expected there shows another motion and is left out.
    """
    lags = out.shape[2]
    energy = np.empty(lags)
    for j in range(out.shape[0]):
        for i in range(out.shape[1]):
            total, e = out[j, i], expected[j, i]
            total[:], energy[:], own = 0, 0, 0.0
            for r in range(rows[j, 0], rows[j, 1]):
                for c in range(cols[i, 0], cols[i, 1]):
                    x, y = places[0, c] - e[6], places[1, r] - e[7]
                    if _belongs(shifts, r, c, e[0] + e[2] * x + e[3] * y, e[1] + e[4] * x + e[5] * y, limit):
                        own += square_a[r, c, 0]
                        _add_lags(products[r, c], square_b[r, c], total, energy)
            for k in range(lags):
                scale = own * energy[k]
                total[k] = total[k] / np.sqrt(scale) if scale > 1e-20 else 0.0


@compiled
def _add_lags(products: F32, squares: F32, total: F64, energy: F64) -> None:
    for k in range(total.shape[0]):
        total[k] += products[k]
        energy[k] += squares[k]


@compiled
def window_peaks(
    slopes: F32,
    shifts: I64,
    rows: I64,
    cols: I64,
    places: F64,
    expected: F64,
    limit: float,
    residual: F64,
    leak: float,
    shift: F64,
    covariance: F64,
) -> None:
    """Fill the displacement (2,) of the middle of each window and its covariance (2, 2); NaN where nothing curves.

    `residual` (rows, cols, 2) is where the correlation of a window is highest, from the shifts of its pieces.
    """
    for j in range(shift.shape[0]):
        for i in range(shift.shape[1]):
            e = expected[j, i]
            xx = xy = yy = ox = oy = 0.0
            for r in range(rows[j, 0], rows[j, 1]):
                for c in range(cols[i, 0], cols[i, 1]):
                    x, y = places[0, c] - e[6], places[1, r] - e[7]
                    px, py = e[2] * x + e[3] * y, e[4] * x + e[5] * y
                    if _belongs(shifts, r, c, e[0] + px, e[1] + py, limit):
                        k = slopes[r, c]
                        xx, xy, yy = xx + k[2], xy + k[3], yy + k[4]
                        # How far the piece was read from where the middle's own displacement would have it.
                        px, py = shifts[r, c, 0] - px, shifts[r, c, 1] - py
                        ox, oy = ox + k[2] * px + k[3] * py, oy + k[3] * px + k[4] * py
            determinant = xx * yy - xy * xy
            if not (xx > 0 and yy > 0 and determinant > 1e-6 * xx * yy):
                shift[j, i], covariance[j, i] = np.nan, np.nan
                continue
            dx = residual[j, i, 0] + (yy * ox - xy * oy) / determinant
            dy = residual[j, i, 1] + (xx * oy - xy * ox) / determinant
            shift[j, i, 0], shift[j, i, 1] = dx, dy
            sx = sy = sxx = sxy = syy = n = squares = 0.0
            for r in range(rows[j, 0], rows[j, 1]):
                for c in range(cols[i, 0], cols[i, 1]):
                    x, y = places[0, c] - e[6], places[1, r] - e[7]
                    px, py = e[2] * x + e[3] * y, e[4] * x + e[5] * y
                    if _belongs(shifts, r, c, e[0] + px, e[1] + py, limit):
                        k = slopes[r, c]
                        px, py = dx - shifts[r, c, 0], dy - shifts[r, c, 1]
                        gx, gy = k[0] - k[2] * px - k[3] * py, k[1] - k[3] * px - k[4] * py
                        sx, sy, n = sx + gx, sy + gy, n + 1
                        sxx, sxy, syy = sxx + gx * gx, sxy + gx * gy, syy + gy * gy
                        squares += (k[2] + k[4]) ** 2
            # As many pieces of equal weight.
            equal = (xx + yy) ** 2 / squares
            scale = leak * equal / max(equal - FEW, 1.0) / determinant**2
            sxx, sxy, syy = (sxx - sx * sx / n) * scale, (sxy - sx * sy / n) * scale, (syy - sy * sy / n) * scale
            # The inverse of the curvature, but for its determinant: (yy, -xy; -xy, xx).
            ax, ay = yy * sxx - xy * sxy, yy * sxy - xy * syy
            bx, by = xx * sxy - xy * sxx, xx * syy - xy * sxy
            covariance[j, i, 0, 0] = ax * yy - ay * xy
            covariance[j, i, 0, 1] = covariance[j, i, 1, 0] = ay * xx - ax * xy
            covariance[j, i, 1, 1] = by * xx - bx * xy
