"""Compiled loops over pieces of windows of two fields; `featreg.sar.orientation.precision` says what they compute."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled, disjoint

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]

#: Sums of a piece of `slopes_of_windows`.
SUMS = 5


@compiled
def _copied(flat: F32, height: int, width: int, y: int, x: int, panel: F32) -> None:
    """Copy the samples of a field (H, W, 2), given row by row, from (y, x) on to a panel; 0 outside the field."""
    rows, columns = panel.shape[0], panel.shape[1] // 2
    low, high = max(0, -x), min(columns, width - x)
    panel[:] = 0
    for k in range(rows):
        if 0 <= y + k < height and low < high:
            start = 2 * ((y + k) * width + x)
            for i in range(2 * low, 2 * high):
                panel[k, i] = flat[start + i]


@disjoint
def _columns(up: F32, middle: F32, down: F32, total: F32, slope: F32, bend: F32) -> None:
    """Sum, difference and second difference of three rows."""
    for i in range(total.shape[0]):
        total[i] = up[i] + middle[i] + down[i]
        slope[i] = down[i] - up[i]
        bend[i] = up[i] + down[i] - np.float32(2) * middle[i]


@disjoint
def _terms(
    a: F32, ta: F32, sa: F32, ca: F32, b: F32, tb: F32, sb: F32, cb: F32, gx: F32, gy: F32, xx: F32, xy: F32, yy: F32
) -> None:
    """Slopes and curvatures of each value of a row, from the column sums of both fields; the first two values are rim.

    Neighbours along x lie two values apart, real and imaginary parts being in turn.
    """
    sixth, third, quarter = np.float32(1 / 12), np.float32(1 / 6), np.float32(1 / 8)
    for i in range(gx.shape[0]):
        p, q = a[i + 2], b[i + 2]
        gx[i] = sixth * (p * (tb[i + 4] - tb[i]) - q * (ta[i + 4] - ta[i]))
        gy[i] = sixth * (p * (sb[i + 4] + sb[i + 2] + sb[i]) - q * (sa[i + 4] + sa[i + 2] + sa[i]))
        bxx, axx = tb[i + 4] + tb[i] - np.float32(2) * tb[i + 2], ta[i + 4] + ta[i] - np.float32(2) * ta[i + 2]
        xx[i] = -third * (p * bxx + q * axx)
        xy[i] = -quarter * (p * (sb[i + 4] - sb[i]) + q * (sa[i + 4] - sa[i]))
        yy[i] = -third * (p * (cb[i + 4] + cb[i + 2] + cb[i]) + q * (ca[i + 4] + ca[i + 2] + ca[i]))


@compiled
def slopes_of_windows(
    here: F32, there: F32, height: int, width: int, at: I64, moved: I64, side: int, piece: int, out: F32, energy: F32
) -> None:
    """Fill out[i, r, c] with five sums over a piece of the i-th window, and energy[i] with those of both windows.

    Parameters
    ----------
    here, there : the fields (H, W, 2), given row by row
    height, width : H and W
    at : (N, 2) first column and row (x, y) of each window
    moved : (N, 2) displacement (dx, dy) at which it is compared
    side, piece : samples along a window and along a piece, of which there are whole ones in it
    out : (N, P, P, 5), in order the slope of the correlation along x and y, halved between the two fields, and xx, xy,
        yy of minus its second derivatives, as the least-squares quadratic through nine displacements has them
    """
    wide = 2 * side
    a, b = np.empty((side + 2, wide + 4), np.float32), np.empty((side + 2, wide + 4), np.float32)
    column = np.empty((6, wide + 4), np.float32)
    terms = np.empty((SUMS, wide), np.float32)
    count, step = side // piece, 2 * piece
    for i in range(at.shape[0]):
        x, y = at[i, 0] - 1, at[i, 1] - 1
        _copied(here, height, width, y, x, a)
        _copied(there, height, width, y + moved[i, 1], x + moved[i, 0], b)
        out[i] = 0
        one = other = 0.0
        for r in range(count * piece):
            _columns(a[r], a[r + 1], a[r + 2], column[0], column[1], column[2])
            _columns(b[r], b[r + 1], b[r + 2], column[3], column[4], column[5])
            _terms(
                a[r + 1], column[0], column[1], column[2], b[r + 1], column[3], column[4], column[5],
                terms[0], terms[1], terms[2], terms[3], terms[4],
            )  # fmt: skip
            for k in range(2, wide + 2):
                one += a[r + 1, k] * a[r + 1, k]
                other += b[r + 1, k] * b[r + 1, k]
            for k in range(SUMS):
                for c in range(count):
                    total = np.float32(0)
                    for j in range(c * step, (c + 1) * step):
                        total += terms[k, j]
                    out[i, r // piece, c, k] += total
        energy[i, 0], energy[i, 1] = one, other
