"""Compiled loops of the ratio of exponentially weighted averages, which `featreg.sar.gradients.ratio` explains."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled, inlined
from featreg.sar.logarithm_kernels import fast_log

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
def squared_log_ratio(over: np.float32, under: np.float32, tiny: np.float32) -> np.float32:
    """Square of log(over / under) by 2 atanh(u) = 2 (u + u^3 / 3 + u^5 / 5 + ...), u = difference / sum.

    To 1 % at ratios below 6, and growing with the ratio beyond; half the cost of the logarithm.
    """
    third, fifth, seventh = np.float32(1 / 3), np.float32(1 / 5), np.float32(1 / 7)
    u = (over - under) / (over + under + tiny)
    q = u * u
    log = np.float32(2) * u * (np.float32(1) + q * (third + q * (fifth + q * seventh)))
    return log * log


@compiled
def _vertical_ratios(
    left: F32, right: F32, left_above: F32, right_above: F32, below_left: F32, below_right: F32, beside: F32,
    share: np.float32, decay: np.float32, tiny: np.float32, before: F32, after: F32, gy: F32,
) -> None:  # fmt: skip
    """log(below / above) of a row; the sums to its left and right; and the sums from below of the row above.

    `left`, `right` are the row's sums from above, `left_above`, `right_above` those of the row above it: what a row
    alone adds is the difference of the two. `beside` is what the sums up to a column weigh as those left of the next.
    """
    for x in range(left.shape[0]):
        low_left, low_right = below_left[x], below_right[x]
        before[x] = beside[x] * (left[x] + low_left)
        after[x] = right[x] + low_right
        above = share * (left_above[x] + right_above[x])
        gy[x] = fast_log((low_left + low_right + tiny) / (above + tiny))
        below_left[x] = decay * ((left[x] - decay * left_above[x]) + low_left)
        below_right[x] = decay * ((right[x] - decay * right_above[x]) + low_right)


@compiled
def _squared_vertical_ratios(
    left: F32, right: F32, left_above: F32, right_above: F32, below_left: F32, below_right: F32, beside: F32,
    share: np.float32, decay: np.float32, tiny: np.float32, before: F32, after: F32, gy2: F32,
) -> None:  # fmt: skip
    """As `_vertical_ratios`, of the squares to 1 %."""
    for x in range(left.shape[0]):
        low_left, low_right = below_left[x], below_right[x]
        before[x] = beside[x] * (left[x] + low_left)
        after[x] = right[x] + low_right
        above = share * (left_above[x] + right_above[x])
        gy2[x] = squared_log_ratio(low_left + low_right, above, tiny)
        below_left[x] = decay * ((left[x] - decay * left_above[x]) + low_left)
        below_right[x] = decay * ((right[x] - decay * right_above[x]) + low_right)


@compiled
def _log_ratio(after: F32, before: F32, tiny: np.float32, out: F32) -> None:
    for x in range(out.shape[0]):
        out[x] = fast_log((after[x] + tiny) / (before[x] + tiny))


@compiled
def _lengths(after: F32, before: F32, tiny: np.float32, gy2: F32, out: F32) -> None:
    for x in range(out.shape[0]):
        out[x] = np.sqrt(squared_log_ratio(after[x], before[x], tiny) + gy2[x])


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
    below_left, below_right = np.zeros(width, np.float32), np.zeros(width, np.float32)
    after, before = np.zeros(width, np.float32), np.zeros(width + 1, np.float32)
    nothing = np.zeros(width, np.float32)
    # The sums left of column x are those up to column x - 1, one step decayed.
    beside = np.ones(width, np.float32)
    for x in range(1, width):
        beside[x - 1] = decay * share_x[x]
    only_length = strength.shape[0] > 0
    for y in range(height - 1, -1, -1):
        left, right = up[0, y], up[1, y]
        left_above = up[0, y - 1] if y > 0 else nothing
        right_above = up[1, y - 1] if y > 0 else nothing
        share = decay * share_y[y]
        if only_length:
            _squared_vertical_ratios(
                left, right, left_above, right_above, below_left, below_right, beside, share, decay, tiny,
                before[1:], after, gy[0],
            )  # fmt: skip
            _lengths(after, before[:width], tiny, gy[0], strength[y])
        else:
            _vertical_ratios(
                left, right, left_above, right_above, below_left, below_right, beside, share, decay, tiny,
                before[1:], after, gy[y],
            )  # fmt: skip
            _log_ratio(after, before[:width], tiny, gx[y])
