"""Compiled loops over masks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

U8 = NDArray[np.uint8]
U16 = NDArray[np.uint16]


@compiled
def _count_down(mask: U8, y: int, most: np.uint16, run: U16, reach: int, full: U8) -> None:
    """Go on counting, up to `most`, the pixels of 1 that end in row `y`; tell where there are so many."""
    row, start = mask[y], np.uint64(reach)
    for column in range(run.shape[0]):
        x = np.uint64(column)
        longer = np.uint16(run[x] + np.uint16(run[x] < most))
        longer = longer if row[x] != 0 else np.uint16(0)
        run[x] = longer
        full[x + start] = np.uint8(longer == most)


@compiled
def _joined(pixels: U8, step: int, out: U8) -> None:
    """Whether a pixel and the one `step` beyond it are 1."""
    beyond = np.uint64(step)
    for column in range(out.shape[0] - step):
        x = np.uint64(column)
        out[x] = np.uint8(pixels[x] & pixels[x + beyond])


@compiled
def _copied(pixels: U8, whole: U8, y: int) -> None:
    row = whole[y]
    for x in range(row.shape[0]):
        row[x] = pixels[x]


@compiled
def whole_squares(mask: U8, reach: int, outside: int, whole: U8) -> None:
    """Write 1 where all of the square of `reach` pixels around is 1 in `mask` (H, W) of 0 and 1, else 0.

    `outside` is what the mask holds beyond its border. Rows are counted downwards; along a row, runs of 1, 2, 4, ...
    are joined, so that the size of the square hardly matters.
    """
    height, width = mask.shape
    side = 2 * reach + 1
    most, rim = np.uint16(min(side, 65535)), np.uint8(outside)
    beyond = np.full((1, width), rim, np.uint8)
    run = np.full(width, most if outside else np.uint16(0), np.uint16)
    first, second = np.empty(width + 2 * reach, np.uint8), np.empty(width + 2 * reach, np.uint8)
    for enter in range(height + reach):
        first[:reach] = rim
        first[reach + width :] = rim
        if enter < height:
            _count_down(mask, enter, most, run, reach, first)
        else:
            _count_down(beyond, 0, most, run, reach, first)
        if enter < reach:
            continue
        joined, there = 1, True
        while joined < side:
            step = min(joined, side - joined)
            if there:
                _joined(first, step, second)
            else:
                _joined(second, step, first)
            there = not there
            joined += step
        _copied(first if there else second, whole, enter - reach)
