"""Compiled loops of the ratio of exponentially weighted averages, which `featreg.sar.gradients.ratio` explains."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled, inlined
from featreg.sar.logarithm_kernels import fast_log

F32 = NDArray[np.float32]
U16 = NDArray[np.uint16]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]


@compiled
def _eight_rows(
    r0: F32, r1: F32, r2: F32, r3: F32, r4: F32, r5: F32, r6: F32, r7: F32, offset: np.float32, decay: np.float32,
    left: F32, right: F32,
) -> None:  # fmt: skip
    """Causal sums (centre included) and anticausal sums (centre excluded) of eight rows.

    The rows advance together, so that the recursions' latencies overlap.
    """
    width = r0.shape[0]
    a0 = a1 = a2 = a3 = a4 = a5 = a6 = a7 = np.float32(0)
    for x in range(width):
        a0 = (r0[x] + offset) + decay * a0
        a1 = (r1[x] + offset) + decay * a1
        a2 = (r2[x] + offset) + decay * a2
        a3 = (r3[x] + offset) + decay * a3
        a4 = (r4[x] + offset) + decay * a4
        a5 = (r5[x] + offset) + decay * a5
        a6 = (r6[x] + offset) + decay * a6
        a7 = (r7[x] + offset) + decay * a7
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
        a0 = decay * ((r0[x] + offset) + a0)
        a1 = decay * ((r1[x] + offset) + a1)
        a2 = decay * ((r2[x] + offset) + a2)
        a3 = decay * ((r3[x] + offset) + a3)
        a4 = decay * ((r4[x] + offset) + a4)
        a5 = decay * ((r5[x] + offset) + a5)
        a6 = decay * ((r6[x] + offset) + a6)
        a7 = decay * ((r7[x] + offset) + a7)


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
def sums_from_above(
    image: F32, first: int, last: int, one: int, width: int, offset: np.float32, decay: np.float32, left: F32,
    right: F32, up: F32,
) -> None:  # fmt: skip
    """Weighted sums of image + offset over all rows above and the own one, of rows `first` to before `last`.

    Of `width` columns from `one` on.

    Row y stands at (y + 1) modulo the rows of `up` (2, R, W), and that of the row above the first is there already.
    up[0] is the sum of the pixels to the left and the own column, up[1] that of the pixels to the right; `left` and
    `right` (8, W) are for the sums of single rows.
    """
    kept, end = up.shape[1], one + width
    for y in range(first, last, 8):
        count = min(8, last - y)
        if count == 8:
            r0, r1, r2, r3 = image[y, one:end], image[y + 1, one:end], image[y + 2, one:end], image[y + 3, one:end]
            r4, r5, r6, r7 = image[y + 4, one:end], image[y + 5, one:end], image[y + 6, one:end], image[y + 7, one:end]
            _eight_rows(r0, r1, r2, r3, r4, r5, r6, r7, offset, decay, left, right)
        else:
            for k in range(count):
                _one_row(image[y + k, one:end], offset, decay, left[k], right[k])
        for k in range(count):
            above, own = (y + k) % kept, (y + k + 1) % kept
            _advance(left[k], decay, up[0, above, :width], up[0, own, :width])
            _advance(right[k], decay, up[1, above, :width], up[1, own, :width])


@compiled
def sums_from_below(
    left: F32, right: F32, left_above: F32, right_above: F32, decay: np.float32, below_left: F32, below_right: F32
) -> None:
    """The sums from below of the row above one; see `vertical_ratios`."""
    for x in range(left.shape[0]):
        below_left[x] = decay * ((left[x] - decay * left_above[x]) + below_left[x])
        below_right[x] = decay * ((right[x] - decay * right_above[x]) + below_right[x])


@inlined
def squared_log_ratio(q: np.float32) -> np.float32:
    """Square of the logarithm of a ratio, q = (difference / sum)^2 of its two parts: that of 2 atanh of the root of q.

    A polynomial, the root of which is right to 0.3 % at ratios below 6, and grows with the ratio beyond, to 3.3.
    """
    return q * (np.float32(4.01702) + q * (np.float32(2.10534) + q * np.float32(4.51114)))


@compiled
def vertical_ratios(
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
def _four_sums(
    left: F32, right: F32, left_above: F32, right_above: F32, below_left: F32, below_right: F32, beside: F32,
    share: np.float32, decay: np.float32, before: F32, after: F32, above: F32, below: F32,
) -> None:  # fmt: skip
    """As `vertical_ratios`, of the sums themselves."""
    for x in range(left.shape[0]):
        low_left, low_right = below_left[x], below_right[x]
        before[x] = beside[x] * (left[x] + low_left)
        after[x] = right[x] + low_right
        above[x] = share * (left_above[x] + right_above[x])
        below[x] = low_left + low_right
        below_left[x] = decay * ((left[x] - decay * left_above[x]) + low_left)
        below_right[x] = decay * ((right[x] - decay * right_above[x]) + low_right)


@compiled
def log_ratio_of_rows(after: F32, before: F32, tiny: np.float32, out: F32) -> None:
    for x in range(out.shape[0]):
        out[x] = fast_log((after[x] + tiny) / (before[x] + tiny))


@compiled
def _lengths(
    after: F32, before: F32, above: F32, below: F32, tiny: np.float32, steps: np.float32, out: U16
) -> None:  # fmt: skip
    """Length of the log ratios of two pairs of sums; one division serves both."""
    for x in range(out.shape[0]):
        along, across = (after[x] + before[x]) + tiny, (above[x] + below[x]) + tiny
        inverse = np.float32(1) / (along * across)
        u, v = (after[x] - before[x]) * (across * inverse), (above[x] - below[x]) * (along * inverse)
        out[x] = np.uint16(np.int32(steps * np.sqrt(squared_log_ratio(u * u) + squared_log_ratio(v * v))))


@compiled
def _taken(row: F32, out: F32) -> None:
    for x in range(out.shape[0]):
        out[x] = row[x]


@compiled
def _interleaved(gx: F32, gy: F32, out: F32) -> None:
    for x in range(gx.shape[0]):
        out[x, 0] = gx[x]
        out[x, 1] = gy[x]


@compiled
def log_ratios(
    image: F32, offset: np.float32, decay: np.float32, tiny: np.float32, share_x: F32, share_y: F32, halo: int,
    begin: int, behind: int, tile: int, rows: int, up: F32, gx: F32, gy: F32, both: F32, steps: np.float32,
    lengths: U16,
) -> None:  # fmt: skip
    """log(right / left) and log(below / above) of the weighted means of an image (H, W) plus an offset, or the length.

    `share_x` (W,), `share_y` (H,) are the weights that exist after each position over those before it; `tiny` keeps 0/0
    at 1. The ratios go to `gx` and `gy` (H, W), or to `both` (H, W, 2), or their length times `steps` to `lengths`
    (H, W): to that which has rows.

    The columns `begin` to before `behind` pass in tiles of so many columns and rows, so that the sums of one stay in
    the cache. Those to the sides and from below begin `halo` pixels beyond it, where decay^halo is less than the
    rounding of a float; those from above go on. `rows` and `halo` are multiples of eight. `up` (2, R, C) is room for
    the sums from above of a tile's rows and halo and of the row above, R at most H + 1, and of its columns and halos.
    The short loops stand in functions of their own: only so does the compiler prove them free of overlap and vectorise.
    """
    height = image.shape[0]
    kept = up.shape[1]
    for start in range(begin, behind, tile):
        stop = min(start + tile, behind)
        one, end = max(start - halo, 0), min(stop + halo, image.shape[1])
        width, i, j = end - one, start - one, stop - one
        left, right = np.empty((8, width), np.float32), np.empty((8, width), np.float32)
        below_left, below_right = np.empty(width, np.float32), np.empty(width, np.float32)
        after, before = np.zeros(width, np.float32), np.zeros(width + 1, np.float32)
        row_x, row_y = np.empty(width, np.float32), np.empty(width, np.float32)
        # The sums left of column x are those up to column x - 1, one step decayed.
        beside = np.ones(width, np.float32)
        for x in range(1, width):
            beside[x - 1] = decay * share_x[one + x]
        done = 0
        up[:, 0, :width] = 0
        for top in range(0, height, rows):
            bottom = min(top + rows, height)
            last = min(bottom + halo, height)
            sums_from_above(image, done, last, one, width, offset, decay, left, right, up)
            done = last
            below_left[:], below_right[:] = 0, 0
            for y in range(last - 1, bottom - 1, -1):
                here, above = (y + 1) % kept, y % kept
                sums_from_below(
                    up[0, here, :width], up[1, here, :width], up[0, above, :width], up[1, above, :width], decay,
                    below_left, below_right,
                )  # fmt: skip
            for y in range(bottom - 1, top - 1, -1):
                here, above = (y + 1) % kept, y % kept
                share = decay * share_y[y]
                own_left, own_right = up[0, here, :width], up[1, here, :width]
                left_above, right_above = up[0, above, :width], up[1, above, :width]
                if lengths.shape[0] > 0:
                    _four_sums(
                        own_left, own_right, left_above, right_above, below_left, below_right, beside, share, decay,
                        before[1:], after, row_x, row_y,
                    )  # fmt: skip
                    out = lengths[y, start:stop]
                    _lengths(after[i:j], before[i:j], row_x[i:j], row_y[i:j], tiny, steps, out)
                elif both.shape[0] > 0:
                    vertical_ratios(
                        own_left, own_right, left_above, right_above, below_left, below_right, beside, share, decay,
                        tiny, before[1:], after, row_y,
                    )  # fmt: skip
                    log_ratio_of_rows(after[i:j], before[i:j], tiny, row_x[i:j])
                    _interleaved(row_x[i:j], row_y[i:j], both[y, start:stop])
                else:
                    vertical_ratios(
                        own_left, own_right, left_above, right_above, below_left, below_right, beside, share, decay,
                        tiny, before[1:], after, row_y,
                    )  # fmt: skip
                    log_ratio_of_rows(after[i:j], before[i:j], tiny, gx[y, start:stop])
                    _taken(row_y[i:j], gy[y, start:stop])


@compiled
def ranked(lengths: U16, valid: U8, step: int, shares: F64, values: F64) -> None:
    """Write the values that stand at `shares` (N,), ascending, of the way through the valid lengths, in order.

    One pixel in `step` along x and along y is looked at, and values are told to four steps; 0 where none is valid.
    """
    counts = np.zeros(1 << 14, np.int64)
    total = 0
    for y in range(0, lengths.shape[0], step):
        row, good = lengths[y], valid[y]
        for x in range(0, lengths.shape[1], step):
            if good[x] != 0:
                counts[row[x] >> 2] += 1
                total += 1
    reached, at = counts[0], 0
    for k in range(shares.shape[0]):
        while at < counts.shape[0] - 1 and reached <= int(shares[k] * (total - 1)):
            at += 1
            reached += counts[at]
        values[k] = 4.0 * at if total > 0 else 0.0
