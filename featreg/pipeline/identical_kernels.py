"""Compiled loops over the pixels of two images on one grid; `featreg.pipeline.identical` says what they are for."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled, disjoint
from featreg.sar.speckle_kernels import logarithms
from featreg.types import BoolArray

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
I64 = NDArray[np.int64]

#: Bits of `drawable`.
DARK_BOTH, DARK_EITHER, DARK_FIRST, DARK_SECOND = 1, 2, 4, 8
WHITE_BOTH, WHITE_EITHER, GREY_BOTH, GREY_EITHER = 16, 32, 64, 128
#: Half of the squares in which two drawings are compared, px.
AROUND = 7


@disjoint
def _survey_row(one: F32, other: F32, good: BoolArray, before: F32, after: F32) -> int:
    """How many valid pixels of two rows are equal; the higher ones of `before` and of both rows go to `after`."""
    count = np.int32(0)
    for x in range(one.shape[0]):
        a, b = one[x], other[x]
        more = (a if a > b else b) * np.float32(good[x])
        # In place it would be written only where it is higher, by slow instructions.
        after[x] = more if more > before[x] else before[x]
        count = np.int32(count + np.int32((a == b) & good[x]))
    return int(count)


@compiled
def surveyed(first: F32, second: F32, mask: BoolArray, highest: F32) -> int:
    """Return how many valid pixels of two images (H, W) are equal; `highest` (W,) are filled with those of columns.

    It is the highest of both images, 0 in columns without a valid pixel.
    """
    total = 0
    turns = np.zeros((2, highest.shape[0]), np.float32)
    for y in range(first.shape[0]):
        total += _survey_row(first[y], second[y], mask[y], turns[y % 2], turns[(y + 1) % 2])
    last = turns[first.shape[0] % 2]
    for x in range(highest.shape[0]):
        highest[x] = last[x]
    return total


@compiled
def drawable(
    first: F32, second: F32, mask: BoolArray, dark: np.float32, grey: np.float32, white: np.float32, noise: np.float32,
    out: U8, counts: I64,
) -> None:  # fmt: skip
    """Fill out (H, W) with bits that say what may be drawn at each valid pixel of two images (H, W).

    Dark is at most `dark`, white at least `white` and grey at least `grey`: in both images, or in either; grey in both
    also differs by at most `noise`. `counts` (3,) are filled with the pixels that are dark, white and grey in both.
    """
    counts[:] = 0
    # Of each column, in bytes: 255 rows never fill one.
    tally = np.zeros((3, out.shape[1]), np.uint8)
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
            bits = np.uint8(bits * np.uint8(good[x]))
            row[x] = bits
            tally[0, x] += bits & np.uint8(1)
            tally[1, x] += (bits >> np.uint8(4)) & np.uint8(1)
            tally[2, x] += (bits >> np.uint8(6)) & np.uint8(1)
        if y % 255 == 254 or y == out.shape[0] - 1:
            for k in range(3):
                for x in range(row.shape[0]):
                    counts[k] += tally[k, x]
                    tally[k, x] = 0


@compiled
def _add_row(bits: U8, here: int, bit: np.uint8, sums: U8) -> None:
    """Add to the middle of sums (W + 2 * AROUND,) the pixels that have a bit in the row that begins `here`."""
    first, left = np.uint64(here), np.uint64(AROUND)
    for x in range(np.uint64(sums.shape[0] - 2 * AROUND)):
        sums[left + x] += np.uint8((bits[first + x] & bit) != np.uint8(0))


@compiled
def _take_row(bits: U8, here: int, bit: np.uint8, sums: U8) -> None:
    """Take off what `_add_row` added."""
    first, left = np.uint64(here), np.uint64(AROUND)
    for x in range(np.uint64(sums.shape[0] - 2 * AROUND)):
        sums[left + x] -= np.uint8((bits[first + x] & bit) != np.uint8(0))


@compiled
def _fifteen(sums: U8, twos: U8, fours: U8, eights: U8, out: U8) -> None:
    """Fill out (W,) with the sums of 15 neighbours in a row (W + 14,); those of 2, 4 and 8 are as long and filled."""
    count = sums.shape[0]
    for x in range(np.uint64(count - 1)):
        twos[x] = sums[x] + sums[x + np.uint64(1)]
    for x in range(np.uint64(count - 3)):
        fours[x] = twos[x] + twos[x + np.uint64(2)]
    for x in range(np.uint64(count - 7)):
        eights[x] = fours[x] + fours[x + np.uint64(4)]
    for x in range(np.uint64(out.shape[0])):
        out[x] = (eights[x] + fours[x + np.uint64(8)]) + (twos[x + np.uint64(12)] + sums[x + np.uint64(14)])


@compiled
def _compared(
    bits: U8, first: int, bit: np.uint8, shared: U8, total: U8, least: np.uint8, share: np.float32, outline: np.uint8,
    out: U8, counts: I64,
) -> None:  # fmt: skip
    """Do `alike_around` for the row that begins at `first`, from the pixels of both and of either in the squares."""
    row, some = np.uint64(first), np.int32(0)
    for x in range(np.uint64(shared.shape[0])):
        looked = np.uint8((bits[row + x] & bit) != np.uint8(0)) & np.uint8(shared[x] >= least)
        out[row + x] = looked
        some = np.int32(some + np.int32(looked))
    if some == 0:
        return
    outlines = likes = np.int32(0)
    for x in range(np.uint64(shared.shape[0])):
        looked, thin = out[row + x], np.uint8(shared[x] <= outline)
        alike = looked & np.uint8(np.float32(shared[x]) >= share * np.float32(total[x]))
        out[row + x] = alike
        outlines = np.int32(outlines + np.int32(looked & thin))
        likes = np.int32(likes + np.int32(alike & thin))
    counts[0] += outlines
    counts[1] += likes


@compiled
def alike_around(
    bits: U8, width: int, both: int, either: int, least: int, share: np.float32, outline: int, out: U8, counts: I64
) -> None:
    """Mark the pixels around which two drawings are alike, and count those that lie on an outline.

    They are compared in squares of 15 px; beyond the border are no pixels.

    Parameters
    ----------
    bits, width : as `drawable` makes them, row by row, and the pixels of a row
    both, either : the bit of what both drawings have, and that of what either has
    least : fewest pixels of both in the square
    share : of the pixels of either, that of those of both where the drawings are alike
    outline : most pixels of both in a square on an outline
    out : as `bits`, set to 1 where they are alike, else to 0
    counts : (2,) filled: pixels on an outline, and those of them where the drawings are alike
    """
    height, own, other = bits.shape[0] // width, np.uint8(both), np.uint8(either)
    # A square has 225 pixels: all sums are bytes, of which an instruction takes 32 or 64.
    here, there = np.zeros(width + 2 * AROUND, np.uint8), np.zeros(width + 2 * AROUND, np.uint8)
    sums = np.empty((3, width + 2 * AROUND), np.uint8)
    shared, total = np.empty(width, np.uint8), np.empty(width, np.uint8)
    counts[:] = 0
    for y in range(-AROUND, height):
        if y + AROUND < height:
            _add_row(bits, (y + AROUND) * width, own, here)
            _add_row(bits, (y + AROUND) * width, other, there)
        if y - AROUND > 0:
            _take_row(bits, (y - AROUND - 1) * width, own, here)
            _take_row(bits, (y - AROUND - 1) * width, other, there)
        if y >= 0:
            _fifteen(here, sums[0], sums[1], sums[2], shared)
            _fifteen(there, sums[0], sums[1], sums[2], total)
            _compared(bits, y * width, own, shared, total, np.uint8(least), share, np.uint8(outline), out, counts)


@compiled
def fine_detail(first: F32, second: F32, mask: BoolArray, floors: F32, least: float) -> float:
    """Correlation of what two images (H, W) have beyond their 3 x 3 means, in logarithms; NaN where too little is left.

    Parameters
    ----------
    first, second : amplitudes, 2 pixels or more a side; at the border they are mirrored
    mask : (H, W) pixels that count; none does around which both images are nowhere above their floors
    floors : (2,) amplitudes of which at least the logarithm is taken, > 0
    least : share of the pixels that must count
    """
    height, width = first.shape
    logs, black = np.empty((2, height, width), np.float32), np.empty((height, width), np.bool_)
    for y in range(height):
        logarithms(first[y], floors[0], logs[0, y])
        logarithms(second[y], floors[1], logs[1, y])
        for x in range(width):
            black[y, x] = (first[y, x] <= floors[0]) & (second[y, x] <= floors[1])
    # Columns of three, and one more beyond either end.
    sums, fine = np.empty(width + 2, np.float32), np.empty((2, width), np.float32)
    dark, use = np.zeros(width + 2, np.bool_), np.empty(width, np.bool_)
    count, ninth = 0.0, np.float32(1 / 9)
    one = other = squares = others = products = 0.0
    for y in range(height):
        above, below = abs(y - 1), y + 1 if y + 1 < height else height - 2
        for k in range(2):
            upper, here, lower = logs[k, above], logs[k, y], logs[k, below]
            for x in range(width):
                sums[x + 1] = upper[x] + here[x] + lower[x]
            sums[0], sums[width + 1] = sums[2], sums[width - 1]
            for x in range(width):
                fine[k, x] = here[x] - ninth * (sums[x] + sums[x + 1] + sums[x + 2])
        for x in range(width):
            dark[x + 1] = black[above, x] | black[y, x] | black[below, x]
        for x in range(width):
            use[x] = mask[y, x] & (not (dark[x] | dark[x + 1] | dark[x + 2]))
        for x in range(width):
            weight = np.float64(use[x])
            p, q = weight * np.float64(fine[0, x]), weight * np.float64(fine[1, x])
            count += weight
            one += p
            other += q
            squares += p * p
            others += q * q
            products += p * q
    if count < max(least * height * width, 1.0):
        return math.nan
    squares -= one * one / count
    others -= other * other / count
    if min(squares, others) < 1e-12 * count:
        return math.nan
    return (products - one * other / count) / math.sqrt(squares * others)
