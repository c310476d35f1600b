"""Compiled loops of the orientation field; `featreg.sar.orientation.field` says what they compute."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

F32 = NDArray[np.float32]


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
