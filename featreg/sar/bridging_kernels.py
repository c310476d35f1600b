"""Compiled opening of a mask by squares, on words of 64 pixels; `featreg.sar.bridging` says what it is for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

U64 = NDArray[np.uint64]

#: A square is this power of 2 and one pixel more wide.
DOUBLINGS = 4


@compiled
def _along(words: U64, by: int, left: bool) -> None:
    """Keep, in each row, the pixels whose neighbour so many px on (1 to 63) is set as well; beyond the end all are.

    With `left`, set instead those whose neighbour so many px before is set; beyond the start none is.
    """
    width, shift, back = words.shape[1], np.uint64(by), np.uint64(64 - by)
    ones = np.uint64(0xFFFFFFFFFFFFFFFF)
    for y in range(words.shape[0]):
        row = words[y]
        if left:
            for x in range(width - 1, 0, -1):
                row[x] |= (row[x] << shift) | (row[x - 1] >> back)
            row[0] |= row[0] << shift
        else:
            for x in range(width - 1):
                row[x] &= (row[x] >> shift) | (row[x + 1] << back)
            row[width - 1] &= (row[width - 1] >> shift) | (ones << back)


@compiled
def _across(words: U64, by: int, up: bool) -> None:
    """As `_along` from row to row: keep what is set so many rows on as well, or `up`, set what is so many before."""
    height, width = words.shape
    if up:
        for y in range(height - 1, by - 1, -1):
            row, other = words[y], words[y - by]
            for x in range(width):
                row[x] |= other[x]
    else:
        for y in range(height - by):
            row, other = words[y], words[y + by]
            for x in range(width):
                row[x] &= other[x]


@compiled
def has_narrow(words: U64, work: U64) -> bool:
    """Whether a mask has pixels that lie in no square of 17 x 17 px that is all set.

    Parameters
    ----------
    words : (H, N) pixels of each row, 64 a word, from the lowest bit on; beyond the last row and column all are set
    work : (H, N) overwritten
    """
    for y in range(words.shape[0]):
        for x in range(words.shape[1]):
            work[y, x] = words[y, x]
    # Squares of 2, 4, 8 and 16 px, each all set where two of half the side are, and 17 where two of 16 overlap.
    for k in range(DOUBLINGS + 1):
        by = 1 << k if k < DOUBLINGS else 1
        _along(work, by, False)
        _across(work, by, False)
    for k in range(DOUBLINGS + 1):
        by = 1 << k if k < DOUBLINGS else 1
        _along(work, by, True)
        _across(work, by, True)
    for y in range(words.shape[0]):
        for x in range(words.shape[1]):
            if work[y, x] != words[y, x]:
                return True
    return False
