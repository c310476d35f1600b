"""Compiled loops of the places of peaks between pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


@compiled
def quadratic_steps(around: F32, steps: F64) -> None:
    """Fill `steps` (N, 2) with the (x, y) from the middle of squares of 3 x 3 values (N, 9) to the tops of surfaces.

    They have the central differences of the squares. 0 where there is no top, or one more than a pixel away.
    """
    for i in range(around.shape[0]):
        middle = np.float64(around[i, 4])
        up, down = np.float64(around[i, 1]), np.float64(around[i, 7])
        left, right = np.float64(around[i, 3]), np.float64(around[i, 5])
        gx, gy = (right - left) / 2, (down - up) / 2
        xx, yy = right + left - 2 * middle, down + up - 2 * middle
        diagonal = np.float64(around[i, 8]) + np.float64(around[i, 0])
        xy = (diagonal - np.float64(around[i, 2]) - np.float64(around[i, 6])) / 4
        determinant = xx * yy - xy * xy
        steps[i, 0], steps[i, 1] = 0.0, 0.0
        if determinant > 0 and xx < 0:
            x, y = (xy * gy - yy * gx) / determinant, (xy * gx - xx * gy) / determinant
            if abs(x) <= 1 and abs(y) <= 1:
                steps[i, 0], steps[i, 1] = x, y
