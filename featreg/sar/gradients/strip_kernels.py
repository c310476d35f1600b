"""Compiled loops of the ratio gradients of an image strip by strip, for those who need each but for a moment."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled
from featreg.sar.gradients.ratio_kernels import log_ratio_of_rows, sums_from_above, sums_from_below, vertical_ratios

F32 = NDArray[np.float32]


@compiled
def weights_beside(share_x: F32, decay: np.float32) -> F32:
    """What the sums up to each column (W,) weigh as those left of the next one, one step decayed."""
    beside = np.ones_like(share_x)
    for x in range(1, share_x.shape[0]):
        beside[x - 1] = decay * share_x[x]
    return beside


@compiled
def strip(
    image: F32, top: int, rows: int, halo: int, offset: np.float32, decay: np.float32, tiny: np.float32, beside: F32,
    share_y: F32, up: F32, gx: F32, gy: F32,
) -> None:  # fmt: skip
    """Write the log ratios of at most so many `rows` from `top` on, as `ratio_kernels.log_ratios`, to `gx`, `gy`.

    Strips follow one another from the first row on, with the same `up` (2, rows + halo + 1, W) for all, whose first row
    is 0 at first. `rows` and `halo` are multiples of eight; decay^halo is less than the rounding of a float.
    """
    height, width = image.shape
    kept = up.shape[1]
    bottom, last = min(top + rows, height), min(top + rows + halo, height)
    left, right = np.empty((8, width), np.float32), np.empty((8, width), np.float32)
    below_left, below_right = np.zeros(width, np.float32), np.zeros(width, np.float32)
    after, before = np.zeros(width, np.float32), np.zeros(width + 1, np.float32)
    done = min(top + halo, height) if top > 0 else 0
    sums_from_above(image, done, last, 0, width, offset, decay, left, right, up)
    for y in range(last - 1, bottom - 1, -1):
        here, above = (y + 1) % kept, y % kept
        sums_from_below(up[0, here], up[1, here], up[0, above], up[1, above], decay, below_left, below_right)
    for y in range(bottom - 1, top - 1, -1):
        here, above = (y + 1) % kept, y % kept
        vertical_ratios(
            up[0, here], up[1, here], up[0, above], up[1, above], below_left, below_right, beside, decay * share_y[y],
            decay, tiny, before[1:], after, gy[y - top],
        )  # fmt: skip
        log_ratio_of_rows(after, before[:width], tiny, gx[y - top])
