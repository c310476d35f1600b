"""The length of gradients, in the same bits at every call."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]


def lengths(gx: NDArray[Any], gy: NDArray[Any]) -> F32:
    """Return sqrt(gx^2 + gy^2) of two float32 arrays of one shape, every step rounded to float32.

    Notes
    -----
    Where OpenCV is built with Intel's IPP, the last bit of its `magnitude` depends on where the arrays lie in memory,
    which is another place at each call.
    """
    squared: F32 = gx * gx
    squared += gy * gy
    np.sqrt(squared, out=squared)
    return squared
