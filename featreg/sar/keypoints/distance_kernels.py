"""Compiled loops over matrices of descriptor distances."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
# Elements looked through at a time for the place of a minimum.
CHUNK = 64


@compiled
def nearest(squared: I32, forward: I64, best: I32, column: I32) -> None:
    """Fold a block of rows of squared distances into the nearest of each row and the smallest of each column.

    The numbers are the bits of float32 values: where these are not negative the two are ordered alike, and the
    smallest of whole numbers is found many at a time. Negative ones, from rounding, count as 0.
    """
    for i in range(squared.shape[0]):
        best[i] = _smallest(squared[i], column)
        forward[i] = _first(squared[i], best[i])


@compiled
def _smallest(row: I32, column: I32) -> np.int32:
    least = np.int32(0x7FFFFFFF)
    for j in range(row.shape[0]):
        d = max(row[j], np.int32(0))
        least = min(least, d)
        column[j] = min(column[j], d)
    return least


@compiled
def _first(row: I32, value: np.int32) -> int:
    """Return the place of the first element that is `value`, or 0 or less where that is 0."""
    start, n = 0, row.shape[0]
    while start + CHUNK < n and not _holds(row[start : start + CHUNK], value):
        start += CHUNK
    while start < n - 1 and max(row[start], np.int32(0)) != value:
        start += 1
    return start


@compiled
def _holds(part: I32, value: np.int32) -> np.bool:
    count = np.int32(0)
    for d in part:
        count += np.int32(max(d, np.int32(0)) == value)
    return count > 0


@compiled
def second_nearest(squared: F32, forward: I64, second: F32) -> None:
    """Set the smallest of each row of squared distances beside that of its nearest."""
    for i in range(squared.shape[0]):
        row, skip = squared[i], forward[i]
        least = np.float32(np.inf)
        for j in range(row.shape[0]):
            if row[j] < least and j != skip:
                least = row[j]
        second[i] = least
