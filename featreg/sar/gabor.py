"""Ratio gradients from odd Gabor filters: the means under the two halves of the filter, and the log of their ratio.

References
----------
S. Paul, U. C. Pati, "A Gabor Odd Filter-Based Ratio Operator for SAR Image Matching", IEEE Geosci. Remote Sens. Lett.
16 (2019) 397, DOI 10.1109/LGRS.2018.2872979.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from featreg.sar.gradient_histograms import clear_of_nodata
from featreg.sar.speckle import filled_amplitude, mean_amplitude
from featreg.types import Image

F32 = NDArray[np.float32]

# Wavelength and length along the edge of the filter, in units of its standard deviation across the edge.
WAVELENGTH, LENGTH = 4.0, 1.5
# Standard deviations to which a filter reaches.
REACH = 3.0
# Pixels nearer than so many standard deviations to nodata, which counts as the mean, get no gradient.
BLIND = 2.0
# Side of the pieces in which an image is filtered, without their margins: a spectrum stays in the cache, and filters
# of one size serve any image.
PIECE = 300


def gabor_gradients(image: Image, sigma: float, orientations: int = 6, floor: float = 0.01) -> tuple[F32, F32]:
    """Return the ratio gradients of an image, from odd Gabor filters in several directions.

    Parameters
    ----------
    image : amplitude (of any number of looks) or complex; invalid pixels count as the mean amplitude
    sigma : standard deviation in pixels of the filter's envelope across the edge
    orientations : directions over half a turn, at least 2
    floor : added to both means, relative to the mean amplitude of the image

    Returns
    -------
    gx, gy : (H, W) float32
        x and (downwards) y components, towards growing amplitude; 0 within 2 sigma of invalid pixels.

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
    import cv2

    small = np.float32(max(floor * mean_amplitude(image), 1e-30))
    gx, gy = np.zeros((2, *image.shape), np.float32)
    margin = _reach(sigma)
    wide = np.asarray(cv2.copyMakeBorder(filled_amplitude(image), *(margin,) * 4, cv2.BORDER_REFLECT_101), np.float32)
    for top in range(0, image.shape[0], PIECE):
        for left in range(0, image.shape[1], PIECE):
            inner = np.s_[top : top + PIECE, left : left + PIECE]
            outer = np.s_[top : top + PIECE + 2 * margin, left : left + PIECE + 2 * margin]
            _piece(wide[outer], margin, sigma, orientations, small, gx[inner], gy[inner])
    if not image.all_valid:
        near = ~clear_of_nodata(image, BLIND * sigma)
        gx[near] = 0
        gy[near] = 0
    return gx, gy


def _piece(amplitude: F32, margin: int, sigma: float, orientations: int, small: np.float32, gx: F32, gy: F32) -> None:
    """Add the gradients of one piece of the image, which is `margin` pixels wider than they are on all sides."""
    from scipy import fft

    from featreg.sar import gabor_kernels

    # Lengths with a factor of 16: half the time of a product of threes and fives of the same size.
    height, width = (16 * fft.next_fast_len(-(-side // 16)) for side in amplitude.shape)
    spectrum = _whole(fft.rfft2(amplitude, s=(height, width)), width)
    # New memory costs as much as a transform, so all directions use the same.
    work = np.empty_like(spectrum)
    inner = np.s_[margin : margin + gx.shape[0], margin : margin + gx.shape[1]]
    for n, transfer in enumerate(half_filters(height, width, sigma, orientations)):
        theta = math.pi * n / orientations
        x, y = (np.float32(2 / orientations * f(theta)) for f in (math.cos, math.sin))
        means = fft.ifft2(np.multiply(spectrum, transfer, out=work), overwrite_x=True)
        gabor_kernels.add_ratios(means[inner], small, x, y, gx, gy)


def _whole(half: NDArray[np.complex64], width: int) -> NDArray[np.complex64]:
    """Return the (H, W) spectrum of a real image from its (H, W // 2 + 1) non-negative columns."""
    spectrum = np.empty((half.shape[0], width), half.dtype)
    spectrum[:, : half.shape[1]] = half
    mirrored = half[:, (width - 1) // 2 : 0 : -1]
    np.conjugate(mirrored[0], out=spectrum[0, half.shape[1] :])
    np.conjugate(mirrored[:0:-1], out=spectrum[1:, half.shape[1] :])
    return spectrum


def _reach(sigma: float) -> int:
    """Pixels to which a filter reaches."""
    return math.ceil(REACH * sigma * max(1.0, LENGTH))


@lru_cache(maxsize=8)
def half_filters(height: int, width: int, sigma: float, orientations: int) -> F32:
    """Return the (orientations, H, W) float32 real transfer functions of the filters' halves.

    Multiplying a spectrum by one and transforming back gives the half sum of the two means as the real part, and the
    half difference, the side in direction theta minus the other, as the imaginary part.
    """
    from scipy import fft

    reach = _reach(sigma)
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
        np.add.at(kernel, np.ix_(grid % height, grid % width), positive[::-1, ::-1])
        spectrum = fft.fft2(kernel)
        # mean = even part, difference = odd part, whose transfer function is i * imaginary; packed: E + i * (i * O).
        out[n] = spectrum.real - spectrum.imag
    out.flags.writeable = False
    return out
