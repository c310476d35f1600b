"""Ratio gradients from odd Gabor filters: the means under the two halves of the filter, and the log of their ratio.

References
----------
S. Paul, U. C. Pati, "A Gabor Odd Filter-Based Ratio Operator for SAR Image Matching", IEEE Geosci. Remote Sens. Lett.
16 (2019) 397, DOI 10.1109/LGRS.2018.2872979.
"""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.buffers import keeping, scratch
from featreg.sar.gradients.fourier import fast_length, inverse_transform, transform
from featreg.sar.gradients.gradient_field import GradientField, clear_of_nodata
from featreg.sar.speckle import filled_amplitude, mean_amplitude
from featreg.types import Image

F32 = NDArray[np.float32]

# Wavelength and length along the edge of the filter, in units of its standard deviation across the edge.
WAVELENGTH, LENGTH = 4.0, 1.5
# Standard deviations to which a filter reaches.
REACH = 3.0
# Pixels nearer than so many standard deviations to nodata, which counts as the mean, get no gradient.
BLIND = 2.0
# Side, at most about, of the equal pieces in which an image is filtered, without their margins: a spectrum stays in the
# processor's cache.
PIECE = 300
# Filters of more bytes are made anew each time.
KEPT = 32 << 20


def gabor_gradients(
    image: Image, sigma: float, orientations: int = 6, floor: float = 0.01, sparse: bool = False
) -> tuple[F32, F32]:
    """Return the ratio gradients of an image, from odd Gabor filters in several directions.

    Parameters
    ----------
    image : amplitude (of any number of looks) or complex; invalid pixels count as the mean amplitude
    sigma : standard deviation in pixels of the filter's envelope across the edge
    orientations : directions over half a turn, at least 2
    floor : added to both means, relative to the mean amplitude of the image
    sparse : compute them in every other row and column only, and interpolate linearly in between: a third of the
        time. At a sigma of two pixels that smooths speckle's gradients by 29 % of their root mean square, of 2.8 by
        16 %; descriptors match as well

    Returns
    -------
    gx, gy : (H, W) float32
        x and (downwards) y components, towards growing amplitude; 0 within 2 sigma of invalid pixels.

    Notes
    -----
    With the filter exp(-(u^2 + (v / 1.5)^2) / (2 sigma^2)) sin(2 pi u / (4 sigma)), u across the edge, the positive
    half is where it is positive and the negative half where it is negative, both by amount and of unit sum. They are
    mirror images of each other, so that one complex Fourier product with a real array gives the half sum of the two
    means as its real and their half difference as its imaginary part. Every other sample of these is the transform of
    the spectrum folded to half its size. The logarithms of the ratios r(theta) are projected:
    g = 2 / n * sum of r(theta) (cos theta, sin theta), which is exact for a straight edge seen as a cosine. Borders are
    reflected.
    """
    (field,) = gabor_fields(image, (sigma,), (2 if sparse else 1,), 1, orientations, floor)
    return field.x, field.y


def gabor_fields(
    image: Image, sigmas: tuple[float, ...], spacings: tuple[int, ...], grid: int, orientations: int, floor: float
) -> tuple[GradientField, ...]:
    """Return `gabor_gradients` of several standard deviations in every `grid`-th row and column, from the first on.

    `spacings` is for each of them how far apart gradients are computed: `grid`, or twice that, with those in between
    interpolated linearly. The components are (ceil(H / grid), ceil(W / grid)). The image is transformed once for all.
    """
    return image.derive(
        _gabor_fields, sigmas=tuple(map(float, sigmas)), spacings=spacings, grid=grid, orientations=int(orientations),
        floor=float(floor),
    )  # fmt: skip


def _gabor_fields(
    image: Image, sigmas: tuple[float, ...], spacings: tuple[int, ...], grid: int, orientations: int, floor: float
) -> tuple[GradientField, ...]:
    import cv2

    from featreg.sar.gradients import gabor_kernels

    small, gain = np.float32(max(floor, 1e-30)), np.float32(1 / max(mean_amplitude(image), 1e-30))
    margin, widest = _reach(max(sigmas)), max(spacings)
    # One sample more than there are pairs, so that the last pixel too lies between two.
    beyond = margin + widest
    padded = cv2.copyMakeBorder(filled_amplitude(image), margin, beyond, margin, beyond, cv2.BORDER_REFLECT_101)
    wide = np.multiply(padded, gain, out=padded, dtype=np.float32)
    fine = [-(-side // grid) for side in image.shape]
    shapes = [fine if spacing == grid else [side // 2 + 1 for side in fine] for spacing in spacings]
    coarse = shapes[spacings.index(widest)]
    samples = [np.zeros((2, *shape), np.float32) for shape in shapes]
    with keeping():
        for rows, columns in product(*(_pieces(side, PIECE // widest) for side in coarse)):
            outer = tuple(slice(widest * s.start, widest * s.stop + 2 * margin) for s in (rows, columns))
            _piece(wide[outer], margin, (rows, columns), sigmas, spacings, orientations, small, samples)
    found = []
    for sigma, spacing, field in zip(sigmas, spacings, samples, strict=True):
        components = field
        if spacing != grid:
            components = np.empty((2, *fine), np.float32)
            for one, component in zip(field, components, strict=True):
                gabor_kernels.interpolate(one, component)
        if not image.all_valid:
            components[:, ~clear_of_nodata(image, BLIND * sigma)[::grid, ::grid]] = 0
        found.append(GradientField(*components))
    return tuple(found)


def _pieces(length: int, most: int) -> list[slice]:
    """Cut a length into as few nearly equal slices as are hardly longer than `most`."""
    count = max(1, math.ceil((length - 1) / most))
    ends = [length * n // count for n in range(count + 1)]
    return [slice(start, stop) for start, stop in pairwise(ends)]


def _piece(
    amplitude: F32, margin: int, at: tuple[slice, ...], sigmas: tuple[float, ...], spacings: tuple[int, ...],
    orientations: int, small: np.float32, fields: list[F32],
) -> None:  # fmt: skip
    """Add the gradients of one piece of the image, of which `amplitude` has `margin` pixels more on all sides.

    `at` is where its rows and columns stand in the fields (2, H, W) of the widest spacing.
    """
    from featreg.sar.gradients import gabor_kernels

    # The first sample is to lie at a place of the spectrum that stays when it is folded.
    widest = max(spacings)
    first = -(-margin // widest) * widest
    height, width = (fast_length(side + first - margin) for side in amplitude.shape)
    # A real transform would give half of the spectrum, and filling in the other half takes longer than computing it.
    # New memory costs as much as a transform, so all directions and pieces use the same.
    spectrum = _complex("spectrum", height, width)
    gabor_kernels.embedded(amplitude, first - margin, first - margin, spectrum)
    transform(spectrum)
    bank = _filters if 4 * orientations * height * width <= KEPT else half_filters
    for sigma, spacing, (gx, gy) in zip(sigmas, spacings, fields, strict=True):
        means = _complex("means", height // spacing, width // spacing)
        ratio = widest // spacing
        top, left = (ratio * part.start for part in at)
        bottom, right = (min(ratio * part.stop, side) for part, side in zip(at, gx.shape, strict=True))
        for n, transfer in enumerate(bank(height, width, sigma, orientations)):
            theta = math.pi * n / orientations
            x, y = (np.float32(2 / orientations * f(theta)) for f in (math.cos, math.sin))
            if spacing == 1:
                np.multiply(spectrum, transfer, out=means)
            else:
                gabor_kernels.filter_folded(spectrum, transfer, means)
            inverse_transform(means)
            gabor_kernels.add_ratios(
                means, first // spacing, top, left, bottom - top, right - left, small, x, y, gx, gy
            )  # fmt: skip


def _complex(name: str, height: int, width: int) -> NDArray[np.complex64]:
    """Room of this thread that holds what the last one of the name wrote."""
    return scratch(f"gabor {name}", (height, 2 * width)).view(np.complex64)


def _reach(sigma: float) -> int:
    """Pixels to which a filter reaches."""
    return math.ceil(REACH * sigma * max(1.0, LENGTH))


def half_filters(height: int, width: int, sigma: float, orientations: int) -> F32:
    """Return the (orientations, H, W) float32 real transfer functions of the filters' halves, divided by H * W.

    Multiplying a spectrum by one and transforming back, without the usual division by the size, gives the half sum of
    the two means as the real part, and the half difference, the side in direction theta minus the other, as the
    imaginary part.
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
        out[n] = (spectrum.real - spectrum.imag) / (height * width)
    out.flags.writeable = False
    return out


# A pyramid of four scales takes two or three sizes for each, and images differ in size.
_filters = lru_cache(maxsize=16)(half_filters)
