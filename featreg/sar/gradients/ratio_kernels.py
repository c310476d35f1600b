"""Compiled loops of the ratio of exponentially weighted averages, which `featreg.sar.gradients.ratio` explains."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled, inlined

F32 = NDArray[np.float32]


@compiled
def _eight_rows(image: F32, y: int, offset: np.float32, decay: np.float32, left: F32, right: F32) -> None:
    """Causal sums (centre included) and anticausal sums (centre excluded) of eight rows from `y` on.

    The rows advance together, so that the recursions' latencies overlap.
    """
    width = image.shape[1]
    a0 = a1 = a2 = a3 = a4 = a5 = a6 = a7 = np.float32(0)
    for x in range(width):
        a0 = (image[y, x] + offset) + decay * a0
        a1 = (image[y + 1, x] + offset) + decay * a1
        a2 = (image[y + 2, x] + offset) + decay * a2
        a3 = (image[y + 3, x] + offset) + decay * a3
        a4 = (image[y + 4, x] + offset) + decay * a4
        a5 = (image[y + 5, x] + offset) + decay * a5
        a6 = (image[y + 6, x] + offset) + decay * a6
        a7 = (image[y + 7, x] + offset) + decay * a7
        left[0, x] = a0
        left[1, x] = a1
        left[2, x] = a2
        left[3, x] = a3
        left[4, x] = a4
        left[5, x] = a5
        left[6, x] = a6
        left[7, x] = a7
    a0 = a1 = a2 = a3 = a4 = a5 = a6 = a7 = np.float32(0)
    for x in range(width - 1, -1, -1):
        right[0, x] = a0
        right[1, x] = a1
        right[2, x] = a2
        right[3, x] = a3
        right[4, x] = a4
        right[5, x] = a5
        right[6, x] = a6
        right[7, x] = a7
        a0 = decay * ((image[y, x] + offset) + a0)
        a1 = decay * ((image[y + 1, x] + offset) + a1)
        a2 = decay * ((image[y + 2, x] + offset) + a2)
        a3 = decay * ((image[y + 3, x] + offset) + a3)
        a4 = decay * ((image[y + 4, x] + offset) + a4)
        a5 = decay * ((image[y + 5, x] + offset) + a5)
        a6 = decay * ((image[y + 6, x] + offset) + a6)
        a7 = decay * ((image[y + 7, x] + offset) + a7)


@compiled
def _one_row(row: F32, offset: np.float32, decay: np.float32, left: F32, right: F32) -> None:
    a = np.float32(0)
    for x in range(row.shape[0]):
        a = (row[x] + offset) + decay * a
        left[x] = a
    a = np.float32(0)
    for x in range(row.shape[0] - 1, -1, -1):
        right[x] = a
        a = decay * ((row[x] + offset) + a)


@compiled
def _advance(row: F32, decay: np.float32, before: F32, now: F32) -> None:
    for x in range(row.shape[0]):
        now[x] = row[x] + decay * before[x]


@compiled
def sums_from_above(image: F32, offset: np.float32, decay: np.float32, up: F32) -> None:
    """Fill `up` (2, H, W) with the weighted sums of image + offset over all rows above and the own one.

    up[0] is that of the pixels to the left and the own column, up[1] that of the pixels to the right. The sums of a
    block of rows never leave the cache before they are summed downwards.
    """
    height, width = image.shape
    left, right = np.empty((8, width), np.float32), np.empty((8, width), np.float32)
    for start in range(0, height, 8):
        count = min(8, height - start)
        if count == 8:
            _eight_rows(image, start, offset, decay, left, right)
        else:
            for k in range(count):
                _one_row(image[start + k], offset, decay, left[k], right[k])
        for k in range(count):
            y = start + k
            if y == 0:
                for x in range(width):
                    up[0, 0, x], up[1, 0, x] = left[0, x], right[0, x]
            else:
                _advance(left[k], decay, up[0, y - 1], up[0, y])
                _advance(right[k], decay, up[1, y - 1], up[1, y])


@inlined
def fast_log(value: np.float32) -> np.float32:
    """Natural logarithm of a positive normal float, to 4e-7: exponent from the bits, a polynomial for the rest.

    Written without branches and calls so that a loop around it becomes vector code.
    """
    bits = np.float32(value).view(np.int32)
    exponent = (bits - np.int32(0x3F3504F3)) >> np.int32(23)
    m = np.int32(bits - (exponent << np.int32(23))).view(np.float32) - np.float32(1)
    p = np.float32(0.20491759) + m * (np.float32(-0.18680751) + m * np.float32(0.11931054))
    p = np.float32(0.33314675) + m * (np.float32(-0.24908289) + m * p)
    p = np.float32(1.00000095) + m * (np.float32(-0.50001144) + m * p)
    return np.float32(exponent) * np.float32(0.6931471805599453) + m * p


@compiled
def _retreat(now: F32, before: F32, decay: np.float32, state: F32) -> None:
    """Go up one row: what that row alone adds is the difference of two sums from above."""
    for x in range(now.shape[0]):
        state[x] = decay * ((now[x] - decay * before[x]) + state[x])


@compiled
def _sum(a: F32, b: F32, factor: np.float32, out: F32) -> None:
    for x in range(a.shape[0]):
        out[x] = factor * (a[x] + b[x])


@compiled
def _weighted_sum(a: F32, b: F32, weights: F32, out: F32) -> None:
    for x in range(a.shape[0]):
        out[x] = weights[x] * (a[x] + b[x])


@compiled
def _log_ratio(above: F32, below: F32, tiny: np.float32, out: F32) -> None:
    for x in range(above.shape[0]):
        out[x] = fast_log((above[x] + tiny) / (below[x] + tiny))


@compiled
def _squared_log_ratio(above: F32, below: F32, tiny: np.float32, out: F32) -> None:
    """Square of the log ratio by 2 atanh(u) = 2 (u + u^3 / 3 + u^5 / 5 + ...), u = difference / sum.

    To 1 % at ratios below 6, and growing with the ratio beyond; half the cost of the logarithm.
    """
    third, fifth, seventh = np.float32(1 / 3), np.float32(1 / 5), np.float32(1 / 7)
    for x in range(above.shape[0]):
        u = (above[x] - below[x]) / (above[x] + below[x] + tiny)
        q = u * u
        log = np.float32(2) * u * (np.float32(1) + q * (third + q * (fifth + q * seventh)))
        out[x] = log * log


@compiled
def _length(gx2: F32, gy2: F32, out: F32) -> None:
    for x in range(gx2.shape[0]):
        out[x] = np.sqrt(gx2[x] + gy2[x])


@compiled
def log_ratios(
    up: F32, decay: np.float32, tiny: np.float32, share_x: F32, share_y: F32, gx: F32, gy: F32, strength: F32
) -> None:
    """From the sums from above to log(right / left) and log(below / above) of the weighted means, or their length.

    `share_x` (W,), `share_y` (H,) are the weights that exist after each position over those before it; `tiny` keeps 0/0
    at 1. Where `strength` is (H, W) it gets the length of the gradient and `gx`, `gy` are single rows; else it is
    (0, W). The short loops stand in functions of their own: only so does the compiler prove them free of overlap and
    vectorise.
    """
    height, width = up.shape[1], up.shape[2]
    down_left, down_right = np.zeros(width, np.float32), np.zeros(width, np.float32)
    over, under = np.zeros(width, np.float32), np.zeros(width + 1, np.float32)
    nothing = np.zeros(width, np.float32)
    # The sums left of column x are those up to column x - 1, one step decayed.
    beside = np.ones(width, np.float32)
    for x in range(1, width):
        beside[x - 1] = decay * share_x[x]
    one = np.float32(1)
    only_length = strength.shape[0] > 0
    for y in range(height - 1, -1, -1):
        above_left = up[0, y - 1] if y > 0 else nothing
        above_right = up[1, y - 1] if y > 0 else nothing
        _weighted_sum(up[0, y], down_left, beside, under[1:])
        _sum(up[1, y], down_right, one, over)
        under[0] = 0
        if only_length:
            _squared_log_ratio(over, under[:width], tiny, gx[0])
        else:
            _log_ratio(over, under[:width], tiny, gx[y])
        _sum(above_left, above_right, decay * share_y[y], under[:width])
        _sum(down_left, down_right, one, over)
        if only_length:
            _squared_log_ratio(over, under[:width], tiny, gy[0])
            _length(gx[0], gy[0], strength[y])
        else:
            _log_ratio(over, under[:width], tiny, gy[y])
        _retreat(up[0, y], above_left, decay, down_left)
        _retreat(up[1, y], above_right, decay, down_right)
