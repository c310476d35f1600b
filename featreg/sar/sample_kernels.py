"""Compiled loops that count samples of whole images in one pass, where numpy would write a map first."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

F32 = NDArray[np.float32]

# Samples of which the counts fit into 32 bits, so that the compiler takes many at a time.
PART = 1 << 16


@compiled
def _between(part: F32, low: np.float32, high: np.float32) -> np.int32:
    count = np.int32(0)
    for k in range(part.shape[0]):
        count = np.int32(count + np.int32((part[k] > low) & (part[k] < high)))
    return count


@compiled
def count_between(samples: F32, low: np.float32, high: np.float32) -> int:
    """How many samples lie above `low` and below `high`."""
    count = 0
    for start in range(0, samples.shape[0], PART):
        count += int(_between(samples[start : start + PART], low, high))
    return count
