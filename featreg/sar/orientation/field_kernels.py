"""Compiled loops of the orientation field; `featreg.sar.orientation.field` says what they compute."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled
from featreg.sar.gradients.ratio_kernels import _advance, _eight_rows, _log_ratio, _one_row, _vertical_ratios

F32 = NDArray[np.float32]


@compiled
def _entered(
    left: F32, right: F32, left_above: F32, right_above: F32, decay: np.float32, below_left: F32, below_right: F32
) -> None:
    """The sums from below of the row above one; see `ratio_kernels._vertical_ratios`."""
    for x in range(left.shape[0]):
        below_left[x] = decay * ((left[x] - decay * left_above[x]) + below_left[x])
        below_right[x] = decay * ((right[x] - decay * right_above[x]) + below_right[x])


@compiled
def _kept(left: F32, right: F32, new_left: F32, new_right: F32) -> None:
    for x in range(left.shape[0]):
        new_left[x] = left[x]
        new_right[x] = right[x]


@compiled
def _interleaved(gx: F32, gy: F32, out: F32) -> None:
    for x in range(gx.shape[0]):
        out[x, 0] = gx[x]
        out[x, 1] = gy[x]


@compiled
def gradients(
    image: F32, offset: np.float32, decay: np.float32, tiny: np.float32, share_x: F32, share_y: F32, rows: int,
    halo: int, out: F32,
) -> None:  # fmt: skip
    """Fill out[y, x] with the log ratios (gx, gy) of `ratio_kernels.log_ratios` of an image plus an offset.

    The image passes in strips of so many `rows`, so that the sums of one stay in the cache. Those from below begin
    `halo` rows under a strip, where decay^halo is less than the rounding of a float. Both are multiples of eight.
    """
    height, width = image.shape
    # The first row of a strip's sums is that of the row above it.
    up = np.zeros((2, rows + halo + 1, width), np.float32)
    left, right = np.empty((8, width), np.float32), np.empty((8, width), np.float32)
    below_left, below_right = np.empty(width, np.float32), np.empty(width, np.float32)
    after, before = np.zeros(width, np.float32), np.zeros(width + 1, np.float32)
    gx, gy = np.empty(width, np.float32), np.empty(width, np.float32)
    # The sums left of column x are those up to column x - 1, one step decayed.
    beside = np.ones(width, np.float32)
    for x in range(1, width):
        beside[x - 1] = decay * share_x[x]
    done = 0
    for top in range(0, height, rows):
        bottom = min(top + rows, height)
        last = min(bottom + halo, height)
        if top > 0:
            # What the strip above has summed of this one.
            for k in range(done - top + 1):
                _kept(up[0, rows + k], up[1, rows + k], up[0, k], up[1, k])
        for start in range(done, last, 8):
            count = min(8, last - start)
            if count == 8:
                _eight_rows(image, start, offset, decay, left, right)
            else:
                for k in range(count):
                    _one_row(image[start + k], offset, decay, left[k], right[k])
            for k in range(count):
                i = start + k - top
                _advance(left[k], decay, up[0, i], up[0, i + 1])
                _advance(right[k], decay, up[1, i], up[1, i + 1])
        done = last
        below_left[:], below_right[:] = 0, 0
        for y in range(last - 1, bottom - 1, -1):
            i = y - top
            _entered(up[0, i + 1], up[1, i + 1], up[0, i], up[1, i], decay, below_left, below_right)
        for y in range(bottom - 1, top - 1, -1):
            i = y - top
            _vertical_ratios(
                up[0, i + 1], up[1, i + 1], up[0, i], up[1, i], below_left, below_right, beside, decay * share_y[y],
                decay, tiny, before[1:], after, gy,
            )  # fmt: skip
            _log_ratio(after, before[:width], tiny, gx)
            _interleaved(gx, gy, out[y])


@compiled
def double_angle(field: F32, seen: NDArray[np.bool_], floor: np.float32) -> None:
    """Replace the gradients (gx, gy) of a field (H, W, 2) by (gx + i gy)^2 / (gx^2 + gy^2 + floor), 0 if not `seen`."""
    for y in range(field.shape[0]):
        row, good = field[y], seen[y]
        for x in range(row.shape[0]):
            a, b = row[x, 0], row[x, 1]
            xx, yy = a * a, b * b
            scale = np.float32(good[x]) / (xx + yy + floor)
            row[x, 0] = (xx - yy) * scale
            row[x, 1] = np.float32(2) * a * b * scale
