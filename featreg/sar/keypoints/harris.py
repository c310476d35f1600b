"""The Harris response of a gradient field."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from featreg.types import IntArray

F32 = NDArray[np.float32]

#: Standard deviations to which the Gaussian that smooths the matrix reaches.
REACH = 2.5


def harris_response(gx: F32, gy: F32, sigma: float, d: float = 0.04, out: F32 | None = None) -> F32:
    """Return det - d trace^2 of the matrix of a gradient field's products, smoothed by a Gaussian.

    Parameters
    ----------
    gx, gy : (H, W) float32
    sigma : standard deviation of the Gaussian, px; borders are reflected
    d : weight of the squared trace
    out : (H, W) float32 to be written, where it is given

    Notes
    -----
    C. Harris, M. Stephens, "A combined corner and edge detector", Alvey Vision Conference 1988,
    DOI 10.5244/C.2.23.
    """
    import cv2

    from featreg.sar.keypoints import harris_kernels

    reach = max(1, math.ceil(REACH * sigma))
    taps = np.asarray(cv2.getGaussianKernel(2 * reach + 1, sigma).ravel()[reach:], np.float32)
    rows, columns = (reflected(length, reach) for length in gx.shape)
    response = np.empty(gx.shape, np.float32) if out is None else out
    harris_kernels.response(gx, gy, taps, rows, columns, np.float32(d), response)
    return response


def reflected(length: int, reach: int) -> IntArray:
    """Return the (length + 2 * reach,) places that stand from -reach on where an axis is reflected about its ends."""
    period = max(2 * (length - 1), 1)
    place = np.arange(-reach, length + reach) % period
    return np.asarray(np.minimum(place, period - place) if length > 1 else 0 * place, np.int64)
