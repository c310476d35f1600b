"""Compiled loops over matrices of descriptor distances."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.jit import compiled

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]


@compiled
def two_nearest(squared: F32, start: int, forward: I64, best: F32, second: F32, column: F32, backward: I64) -> None:
    """Fold a block of rows of squared distances into the nearest and second nearest of rows and nearest of columns."""
    for i in range(squared.shape[0]):
        row = squared[i]
        for j in range(row.shape[0]):
            d = row[j]
            if d < best[i]:
                second[i] = best[i]
                best[i] = d
                forward[i] = j
            elif d < second[i]:
                second[i] = d
            if d < column[j]:
                column[j] = d
                backward[j] = start + i
