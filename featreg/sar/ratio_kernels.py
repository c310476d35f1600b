"""Compiled loops of the ratio of exponentially weighted averages; `featreg.sar.ratio` says what they compute."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.jit import compiled, inlined

F32 = NDArray[np.float32]


@compiled
def horizontal_sums(image: F32, decay: np.float32, left: F32, right: F32) -> None:
    """Fill `left` with causal sums (centre included) and `right` with anticausal sums (centre excluded) of each row.

    Eight rows advance together, so that the recursions' latencies overlap.
    """
    height, width = image.shape
    blocks = height // 8 * 8
    for y in range(0, blocks, 8):
        a0 = a1 = a2 = a3 = a4 = a5 = a6 = a7 = np.float32(0)
        for x in range(width):
            a0 = image[y, x] + decay * a0
            a1 = image[y + 1, x] + decay * a1
            a2 = image[y + 2, x] + decay * a2
            a3 = image[y + 3, x] + decay * a3
            a4 = image[y + 4, x] + decay * a4
            a5 = image[y + 5, x] + decay * a5
            a6 = image[y + 6, x] + decay * a6
            a7 = image[y + 7, x] + decay * a7
            left[y, x] = a0
            left[y + 1, x] = a1
            left[y + 2, x] = a2
            left[y + 3, x] = a3
            left[y + 4, x] = a4
            left[y + 5, x] = a5
            left[y + 6, x] = a6
            left[y + 7, x] = a7
        a0 = a1 = a2 = a3 = a4 = a5 = a6 = a7 = np.float32(0)
        for x in range(width - 1, -1, -1):
            right[y, x] = a0
            right[y + 1, x] = a1
            right[y + 2, x] = a2
            right[y + 3, x] = a3
            right[y + 4, x] = a4
            right[y + 5, x] = a5
            right[y + 6, x] = a6
            right[y + 7, x] = a7
            a0 = decay * (image[y, x] + a0)
            a1 = decay * (image[y + 1, x] + a1)
            a2 = decay * (image[y + 2, x] + a2)
            a3 = decay * (image[y + 3, x] + a3)
            a4 = decay * (image[y + 4, x] + a4)
            a5 = decay * (image[y + 5, x] + a5)
            a6 = decay * (image[y + 6, x] + a6)
            a7 = decay * (image[y + 7, x] + a7)
    for y in range(blocks, height):
        a = np.float32(0)
        for x in range(width):
            a = image[y, x] + decay * a
            left[y, x] = a
        a = np.float32(0)
        for x in range(width - 1, -1, -1):
            right[y, x] = a
            a = decay * (image[y, x] + a)


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
def _advance(row: F32, decay: np.float32, before: F32, now: F32) -> None:
    for x in range(row.shape[0]):
        now[x] = row[x] + decay * before[x]


@compiled
def _retreat(row: F32, decay: np.float32, state: F32) -> None:
    for x in range(row.shape[0]):
        state[x] = decay * (row[x] + state[x])


@compiled
def _sum(a: F32, b: F32, factor: np.float32, out: F32) -> None:
    for x in range(a.shape[0]):
        out[x] = factor * (a[x] + b[x])


@compiled
def _log_ratio(above: F32, below: F32, floor: np.float32, balance: F32, out: F32) -> None:
    for x in range(above.shape[0]):
        out[x] = fast_log((above[x] + floor) / (below[x] + floor)) - balance[x]


@compiled
def _squared_log_ratio(above: F32, below: F32, floor: np.float32, balance: F32, out: F32) -> None:
    """Square of the log ratio by 2 atanh(u) = 2 (u + u^3 / 3 + u^5 / 5 + ...), u = difference / sum.

    To 1 % at ratios below 6, and growing with the ratio beyond; half the cost of the logarithm.
    """
    third, fifth, seventh = np.float32(1 / 3), np.float32(1 / 5), np.float32(1 / 7)
    for x in range(above.shape[0]):
        u = (above[x] - below[x]) / (above[x] + below[x] + floor + floor)
        q = u * u
        log = np.float32(2) * u * (np.float32(1) + q * (third + q * (fifth + q * seventh))) - balance[x]
        out[x] = log * log


@compiled
def _length(gx2: F32, gy2: F32, out: F32) -> None:
    for x in range(gx2.shape[0]):
        out[x] = np.sqrt(gx2[x] + gy2[x])


@compiled
def log_ratios(
    left: F32, right: F32, decay: np.float32, floor: F32, balance_x: F32, balance_y: F32, up: F32,
    gx: F32, gy: F32, strength: F32,
) -> None:  # fmt: skip
    """From the row sums to log(right / left) and log(below / above) of the weighted sums, or their length.

    `up` (2, H, W) is scratch for the downward pass. `floor` (H,) is added to every sum, in units of the sums of that
    row; `balance_x` (W,), `balance_y` (H,) are the log ratios of the weights that exist on the two sides. Where
    `strength` is (H, W) it gets the length of the gradient and `gx`, `gy` are single rows; else it is (0, W). The short
    loops stand in functions of their own: only so does the compiler prove them free of overlap and vectorise.
    """
    height, width = left.shape
    up[0, 0] = left[0]
    up[1, 0] = right[0]
    for y in range(1, height):
        _advance(left[y], decay, up[0, y - 1], up[0, y])
        _advance(right[y], decay, up[1, y - 1], up[1, y])
    down_left = np.zeros(width, np.float32)
    down_right = np.zeros(width, np.float32)
    over = np.zeros(width, np.float32)
    under = np.zeros(width + 1, np.float32)
    level = np.zeros(width, np.float32)
    one = np.float32(1)
    only_length = strength.shape[0] > 0
    for y in range(height - 1, -1, -1):
        _sum(up[0, y], down_left, decay, under[1:])
        _sum(up[1, y], down_right, one, over)
        under[0] = 0
        if only_length:
            _squared_log_ratio(over, under[:width], floor[y], balance_x, gx[0])
        else:
            _log_ratio(over, under[:width], floor[y], balance_x, gx[y])
        if y > 0:
            _sum(up[0, y - 1], up[1, y - 1], decay, under[:width])
        else:
            under[:] = 0
        _sum(down_left, down_right, one, over)
        level[:] = balance_y[y]
        if only_length:
            _squared_log_ratio(over, under[:width], floor[y], level, gy[0])
            _length(gx[0], gy[0], strength[y])
        else:
            _log_ratio(over, under[:width], floor[y], level, gy[y])
        _retreat(left[y], decay, down_left)
        _retreat(right[y], decay, down_right)
