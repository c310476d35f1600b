"""Compiled loops over the pixels of two images on one grid; `featreg.pipeline.identical` says what they are for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
I64 = NDArray[np.int64]

#: Bits of `drawable`.
DARK_BOTH, DARK_EITHER, DARK_FIRST, DARK_SECOND = (np.uint8(1 << bit) for bit in range(4))
WHITE_BOTH, WHITE_EITHER, GREY_BOTH, GREY_EITHER = (np.uint8(1 << bit) for bit in range(4, 8))


@compiled
def drawable(
    first: F32, second: F32, mask: NDArray[np.bool_], dark: np.float32, grey: np.float32, white: np.float32,
    noise: np.float32, out: U8,
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


@compiled
def _add_row(bits: U8, here: int, bit: np.uint8, sign: np.int32, sums: NDArray[np.int32]) -> None:
    """Add to sums (W,), or take off, the pixels of a row, from a place on, that have a bit."""
    first = np.uint64(here)
    for x in range(np.uint64(sums.shape[0])):
        sums[x] += sign if bits[first + x] & bit else np.int32(0)


@compiled
def alike_around(
    bits: U8, width: int, both: int, either: int, half: int, least: int, share: np.float32, outline: float, out: U8,
    counts: I64,
) -> None:  # fmt: skip
    """Mark the pixels around which two drawings are alike, and count those that lie on an outline.

    Parameters
    ----------
    bits, width : as `drawable` makes them, row by row, and the pixels of a row
    both, either : the bit of what both drawings have, and that of what either has
    half : half the square around a pixel in which pixels are counted; beyond the border are none
    least : fewest pixels of both in the square
    share : of the pixels of either, that of those of both where the drawings are alike
    outline : most pixels of both in a square on an outline
    out : as `bits`, set to 1 where they are alike; else left as it is
    counts : (3,) filled: pixels looked at, those on an outline, and those of them where the drawings are alike
    """
    height, own, other = bits.shape[0] // width, np.uint8(both), np.uint8(either)
    here, there = np.zeros(width, np.int32), np.zeros(width, np.int32)
    more, less = np.int32(1), np.int32(-1)
    counts[:] = 0
    for y in range(-half, height):
        if y + half < height:
            _add_row(bits, (y + half) * width, own, more, here)
            _add_row(bits, (y + half) * width, other, more, there)
        if y - half > 0:
            _add_row(bits, (y - half - 1) * width, own, less, here)
            _add_row(bits, (y - half - 1) * width, other, less, there)
        if y < 0:
            continue
        row = np.uint64(y * width)
        for x in range(width):
            if bits[row + np.uint64(x)] & own:
                shared, total = 0, 0
                for k in range(max(x - half, 0), min(x + half + 1, width)):
                    shared += here[k]
                    total += there[k]
                if shared >= least:
                    alike = shared >= share * np.float32(total)
                    counts[0] += 1
                    if shared <= outline:
                        counts[1] += 1
                        counts[2] += 1 if alike else 0
                    if alike:
                        out[row + np.uint64(x)] = np.uint8(1)
