"""Compiled reading of amplitudes: what is data, and whether the samples can be amplitudes at all, in one pass."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

#: Largest number of float32.
LARGEST = np.float32(np.finfo(np.float32).max)


@compiled
def _row(samples: NDArray[Any], nodata: np.float32, pixels: NDArray[np.float32], valid: NDArray[np.bool_]) -> int:
    """One row of `amplitudes`: how many samples are data; -1 where one is no amplitude."""
    # Three loops: as one, which compares floating-point numbers and writes bytes, it becomes no vector code.
    count, right = np.int32(0), np.int32(0)
    for k in range(samples.shape[0]):
        right = np.int32(right + np.int32((samples[k] >= 0) & (samples[k] <= LARGEST)))
        count = np.int32(count + np.int32(samples[k] != nodata))
    for k in range(samples.shape[0]):
        pixels[k] = samples[k] if samples[k] != nodata else np.float32(0)
    for k in range(samples.shape[0]):
        valid[k] = samples[k] != nodata
    return int(count) if right == samples.shape[0] else -1


@compiled
def amplitudes(samples: NDArray[Any], nodata: np.float32, pixels: NDArray[np.float32], valid: NDArray[np.bool_]) -> int:
    """Write the amplitude of each sample, 0 where it is that of no data, and which are data.

    Parameters
    ----------
    samples : (H, W) real
    nodata : the value that stands for no data
    pixels : (H, W) to be filled
    valid : (H, W) to be filled

    Returns
    -------
    How many samples are data; -1 where one is negative, infinite or NaN, whether or not it is data.
    """
    count = 0
    for i in range(samples.shape[0]):
        one = _row(samples[i], nodata, pixels[i], valid[i])
        if one < 0:
            return -1
        count += one
    return count
