"""A compiled loop over the pixels of two images on one grid; `featreg.pipeline.identical` says what it is for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

F32 = NDArray[np.float32]

#: Bits of `drawable`.
DARK_BOTH, DARK_EITHER, DARK_FIRST, DARK_SECOND = (np.uint8(1 << bit) for bit in range(4))
WHITE_BOTH, WHITE_EITHER, GREY_BOTH, GREY_EITHER = (np.uint8(1 << bit) for bit in range(4, 8))


@compiled
def drawable(
    first: F32, second: F32, mask: NDArray[np.bool_], dark: np.float32, grey: np.float32, white: np.float32,
    noise: np.float32, out: NDArray[np.uint8],
) -> None:  # fmt: skip
    """Fill out (H, W) with bits that say what may be drawn at each valid pixel of two images (H, W).

    Dark is at most `dark`, white at least `white` and grey at least `grey`: in both images, or in either; grey in both
    also differs by at most `noise`.
    """
    for y in range(out.shape[0]):
        row, one, other, good = out[y], first[y], second[y], mask[y]
        for x in range(row.shape[0]):
            a, b = one[x], other[x]
            less, more = min(a, b), max(a, b)
            bits = np.uint8(more <= dark) | (np.uint8(less <= dark) << np.uint8(1))
            bits |= (np.uint8(a <= dark) << np.uint8(2)) | (np.uint8(b <= dark) << np.uint8(3))
            bits |= (np.uint8(less >= white) << np.uint8(4)) | (np.uint8(more >= white) << np.uint8(5))
            bits |= np.uint8((less >= grey) & (more - less <= noise)) << np.uint8(6)
            bits |= np.uint8(more >= grey) << np.uint8(7)
            row[x] = np.uint8(bits * np.uint8(good[x]))
