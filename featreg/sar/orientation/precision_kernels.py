"""Compiled loops over pieces of windows of two fields; `featreg.sar.orientation.precision` says what they compute."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled, disjoint

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]

#: Sums of a piece of `slopes_of_windows`.
SUMS = 5
#: The next sample of a row, and the one after it, in values; unsigned, so that nothing looks for negative places.
NEXT, AFTER = np.uint64(2), np.uint64(4)


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
    for i in range(np.uint64(total.shape[0])):
        total[i] = up[i] + middle[i] + down[i]
        slope[i] = down[i] - up[i]
        bend[i] = up[i] + down[i] - np.float32(2) * middle[i]


@disjoint
def _added(
    a: F32, ta: F32, sa: F32, ca: F32, b: F32, tb: F32, sb: F32, cb: F32,
    gx: F32, gy: F32, xx: F32, xy: F32, yy: F32, aa: F32, bb: F32,
) -> None:  # fmt: skip
    """Add slopes, curvatures and squares of each value of a row, from the column sums of both fields.

    Neighbours along x lie two values apart, real and imaginary parts being in turn; the first two values are rim.
    """
    twelfth, sixth, eighth, two = np.float32(1 / 12), np.float32(1 / 6), np.float32(1 / 8), np.float32(2)
    for i in range(np.uint64(gx.shape[0])):
        j, k = i + NEXT, i + AFTER
        p, q = a[j], b[j]
        gx[i] += twelfth * (p * (tb[k] - tb[i]) - q * (ta[k] - ta[i]))
        gy[i] += twelfth * (p * (sb[k] + sb[j] + sb[i]) - q * (sa[k] + sa[j] + sa[i]))
        xx[i] -= sixth * (p * (tb[k] + tb[i] - two * tb[j]) + q * (ta[k] + ta[i] - two * ta[j]))
        xy[i] -= eighth * (p * (sb[k] - sb[i]) + q * (sa[k] - sa[i]))
        yy[i] -= sixth * (p * (cb[k] + cb[j] + cb[i]) + q * (ca[k] + ca[j] + ca[i]))
        aa[i] += p * p
        bb[i] += q * q


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
    terms = np.empty((SUMS + 2, wide), np.float32)
    count, step = side // piece, 2 * piece
    for i in range(at.shape[0]):
        x, y = at[i, 0] - 1, at[i, 1] - 1
        _copied(here, height, width, y, x, a)
        _copied(there, height, width, y + moved[i, 1], x + moved[i, 0], b)
        one = other = 0.0
        for r in range(count):
            terms[:] = 0
            for k in range(r * piece, (r + 1) * piece):
                _columns(a[k], a[k + 1], a[k + 2], column[0], column[1], column[2])
                _columns(b[k], b[k + 1], b[k + 2], column[3], column[4], column[5])
                _added(
                    a[k + 1], column[0], column[1], column[2], b[k + 1], column[3], column[4], column[5],
                    terms[0], terms[1], terms[2], terms[3], terms[4], terms[5], terms[6],
                )  # fmt: skip
            for c in range(count):
                for k in range(SUMS + 2):
                    total = np.float32(0)
                    for j in range(c * step, (c + 1) * step):
                        total += terms[k, j]
                    if k < SUMS:
                        out[i, r, c, k] = total
                    elif k == SUMS:
                        one += float(total)
                    else:
                        other += float(total)
        energy[i, 0], energy[i, 1] = one, other
