"""Ratio gradients from odd Gabor filters: the means under the two halves of the filter, and the log of their ratio.

References
----------
S. Paul, U. C. Pati, "A Gabor Odd Filter-Based Ratio Operator for SAR Image Matching", IEEE Geosci. Remote Sens. Lett.
16 (2019) 397, DOI 10.1109/LGRS.2018.2872979.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.sar.speckle import filled_amplitude, mean_amplitude
from featreg.types import Image

F32 = NDArray[np.float32]

# Wavelength and length along the edge of the filter, in units of its standard deviation across the edge.
WAVELENGTH, LENGTH = 4.0, 1.5
# Standard deviations to which a filter reaches.
REACH = 3.0
# A side that holds less than this share of the other side's weight gives no gradient.
LEAST_SUPPORT = 0.02
# Side of the pieces in which an image is filtered, without their margins: filters of one size serve any image.
PIECE = 1024


def gabor_gradients(image: Image, sigma: float, orientations: int = 6, floor: float = 0.01) -> tuple[F32, F32]:
    """Return the ratio gradients of an image, from odd Gabor filters in several directions.

    Parameters
    ----------
    image : amplitude (of any number of looks) or complex; the mask is honoured: invalid pixels have no weight
    sigma : standard deviation in pixels of the filter's envelope across the edge
    orientations : directions over half a turn, at least 2
    floor : added to both means, relative to the mean amplitude of the image

    Returns
    -------
    gx, gy : (H, W) float32
        x and (downwards) y components, towards growing amplitude; 0 at invalid pixels.

    Notes
    -----
    With the filter exp(-(u^2 + (v / 1.5)^2) / (2 sigma^2)) sin(2 pi u / (4 sigma)), u across the edge, the positive
    half is where it is positive and the negative half where it is negative, both by amount and of unit sum. They are
    mirror images of each other, so that one complex Fourier product with a real array gives the half sum of the two
    means as its real and their half difference as its imaginary part. The logarithms of the ratios r(theta) are
    projected: g = 2 / n * sum of r(theta) (cos theta, sin theta), which is exact for a straight edge seen as a cosine.
    Borders are reflected.
    """
    return image.derive(_gabor_gradients, sigma=float(sigma), orientations=int(orientations), floor=float(floor))


def _gabor_gradients(image: Image, sigma: float, orientations: int, floor: float) -> tuple[F32, F32]:
    small = max(floor * mean_amplitude(image), 1e-30)
    gx, gy = np.zeros((2, *image.shape), np.float32)
    filled = filled_amplitude(image)
    weights = None if image.all_valid else image.mask.astype(np.float32)
    amplitude = filled if weights is None else image.amplitude
    margin = math.ceil(REACH * sigma * max(1.0, LENGTH))
    height, width = image.shape
    for top in range(0, height, PIECE):
        for left in range(0, width, PIECE):
            box = (slice(top, min(top + PIECE, height)), slice(left, min(left + PIECE, width)))
            _piece(amplitude, weights, box, margin, sigma, orientations, small, gx[box], gy[box])
    if weights is not None:
        gx[~image.mask] = 0
        gy[~image.mask] = 0
    return gx, gy


def _piece(
    amplitude: F32, weights: F32 | None, box: tuple[slice, slice], margin: int, sigma: float, orientations: int,
    small: float, gx: F32, gy: F32,
) -> None:  # fmt: skip
    """Fill the gradients of one piece of the image."""
    from scipy import fft

    from featreg.sar import gabor_kernels

    rows, columns = box
    shape = tuple(fft.next_fast_len(s.stop - s.start + 2 * margin) for s in box)
    spectra = [fft.fft2(_with_margin(a, rows, columns, margin, shape)) for a in (amplitude, weights) if a is not None]
    inner = (slice(margin, margin + rows.stop - rows.start), slice(margin, margin + columns.stop - columns.start))
    filters = half_filters(shape[0], shape[1], sigma, orientations)
    for n, transfer in enumerate(filters):
        theta = math.pi * n / orientations
        along = np.float32(2 / orientations * math.cos(theta)), np.float32(2 / orientations * math.sin(theta))
        means = [fft.ifft2(spectrum * transfer, overwrite_x=True)[inner] for spectrum in spectra]
        if weights is None:
            gabor_kernels.add_ratios(means[0], np.float32(small), *along, gx, gy)
        else:
            limit = np.float32(-math.log(LEAST_SUPPORT))
            gabor_kernels.add_weighted_ratios(means[0], means[1], np.float32(small), limit, *along, gx, gy)


def _with_margin(values: F32, rows: slice, columns: slice, margin: int, shape: tuple[int, ...]) -> Any:
    """A piece and what is around it, reflected at the border of the image, zero-padded to `shape`: complex64."""
    height, width = values.shape
    y = np.arange(rows.start - margin, rows.stop + margin)
    x = np.arange(columns.start - margin, columns.stop + margin)
    out = np.zeros(shape, np.complex64)
    out.real[: len(y), : len(x)] = values[_reflected(y, height)[:, None], _reflected(x, width)]
    return out


def _reflected(index: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Indices folded back into 0 .. count - 1, the border pixel not repeated."""
    period = max(2 * count - 2, 1)
    folded = index % period
    return np.asarray(np.minimum(folded, period - folded) if count > 1 else 0 * folded)


@lru_cache(maxsize=8)
def half_filters(height: int, width: int, sigma: float, orientations: int) -> F32:
    """Return the (orientations, H, W) float32 real transfer functions of the filters' halves.

    Multiplying a spectrum by one and transforming back gives the half sum of the two means as the real part, and the
    half difference, the side in direction theta minus the other, as the imaginary part.
    """
    from scipy import fft

    reach = math.ceil(REACH * sigma * max(1.0, LENGTH))
    grid = np.arange(-reach, reach + 1)
    x, up = np.meshgrid(grid, -grid)
    out = np.empty((orientations, height, width), np.float32)
    for n in range(orientations):
        theta = math.pi * n / orientations
        u = x * math.cos(theta) + up * math.sin(theta)
        v = -x * math.sin(theta) + up * math.cos(theta)
        envelope = np.exp(-0.5 * (u**2 + (v / LENGTH) ** 2) / sigma**2)
        positive = np.maximum(envelope * np.sin(2 * math.pi * u / (WAVELENGTH * sigma)), 0)
        positive /= positive.sum()
        # Convolution looks the other way: the half that reads the pixels in direction theta is the mirrored one.
        kernel = np.zeros((height, width))
        kernel[np.ix_(grid % height, grid % width)] = positive[::-1, ::-1]
        spectrum = fft.fft2(kernel)
        # mean = even part, difference = odd part, whose transfer function is i * imaginary; packed: E + i * (i * O).
        out[n] = spectrum.real - spectrum.imag
    out.flags.writeable = False
    return out
