"""The Harris response of a gradient field."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.threads import in_parts
from featreg.sar.gradients.ratio import recursion
from featreg.types import IntArray

F32 = NDArray[np.float32]

#: Standard deviations to which the Gaussian that smooths the matrix reaches.
REACH = 2.5
# Rows of the strips in which gradients pass; they and their sums stay in the cache.
STRIP = 32


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
    from featreg.sar.keypoints import harris_kernels

    response = np.empty(gx.shape, np.float32) if out is None else out
    smoothing = _smoothing(gx.shape, sigma)

    def part(first: int, stop: int) -> None:
        harris_kernels.response(gx, gy, *smoothing, np.float32(d), first, stop, response)

    in_parts(part, *response.shape)
    return response


def ratio_harris_response(
    amplitude: F32, alpha: float, floor: float, sigma: float, d: float = 0.04, out: F32 | None = None
) -> F32:
    """Return `harris_response` of `featreg.sar.gradients.ratio.roewa` of a plain (H, W) float32 array.

    The gradients, of exponential weight `alpha` and with `floor`, pass row by row: no map of them is made, which
    saves a quarter of the time.
    """
    from featreg.sar.keypoints import harris_kernels

    image, constants, halo = recursion(amplitude, alpha, floor)
    response = np.empty(image.shape, np.float32) if out is None else out
    harris_kernels.response_of_ratios(
        image, *constants, STRIP, halo, *_smoothing(image.shape, sigma), np.float32(d), response
    )
    return response


def _smoothing(shape: tuple[int, ...], sigma: float) -> tuple[F32, IntArray, IntArray]:
    """Taps of a Gaussian from its middle on, and the rows and columns that stand for those around an image."""
    import cv2

    reach = max(1, math.ceil(REACH * sigma))
    taps = np.asarray(cv2.getGaussianKernel(2 * reach + 1, sigma).ravel()[reach:], np.float32)
    rows, columns = (reflected(length, reach) for length in shape)
    return taps, rows, columns


def reflected(length: int, reach: int) -> IntArray:
    """Return the (length + 2 * reach,) places that stand from -reach on where an axis is reflected about its ends."""
    period = max(2 * (length - 1), 1)
    place = np.arange(-reach, length + reach) % period
    return np.asarray(np.minimum(place, period - place) if length > 1 else 0 * place, np.int64)
