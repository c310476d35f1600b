"""Views of a SAR image in which speckle is additive or reduced."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.threads import side_by_side
from featreg.types import Image

F32 = NDArray[np.float32]

# Relative to the mean amplitude: darker pixels (shadow, quantised zeros) say nothing more.
FLOOR = 1e-2
# Pixels of a strip, and steps of a byte for one of the natural logarithm.
STRIP, STEPS = 1 << 16, 28
# Pixels of an image from which on threads share out its rows, and into how many parts.
LARGE, PARTS = 1 << 21, 8
# What the mean of the logarithm lies below the logarithm of the mean, about, of one look.
BELOW_MEAN = 0.25
# Side of the windows by which looks are told, variance below which one shows nothing, and the share of the most even.
WINDOW, EVEN, FIFTH = 5, 1e-6, 0.2


def log_amplitude(image: Image) -> F32:
    """Return the (H, W) float32 natural logarithm of the amplitude, in which speckle is additive.

    Amplitudes are floored at 1 % of their mean; invalid pixels count as the mean amplitude, so that smooth filters near
    them stay in range.
    """
    return image.derive(_log_amplitude)


def despeckled(image: Image, sigma: float = 1.0) -> F32:
    """Return the (H, W) float32 log-amplitude smoothed by a Gaussian of `sigma` pixels, for comparing intensities."""
    return image.derive(_despeckled, sigma=float(sigma))


def despeckled_halved(image: Image, sigma: float = 1.0) -> F32:
    """Return `despeckled` at half size, each sample the mean of 2 x 2 pixels; an odd last row or column is left out."""
    return image.derive(_despeckled_halved, sigma=float(sigma))


def despeckled_bytes(image: Image, sigma: float = 1.0) -> NDArray[np.uint8]:
    """Return `despeckled` in (H, W) uint8 steps of 1/28, 128 being about the mean level, where no more is needed.

    A quarter of the memory, so that scattered look-ups stay in the cache; the step is a fifth of what speckle leaves.
    """
    return image.derive(_despeckled_bytes, sigma=float(sigma))


def equivalent_looks(image: Image) -> float:
    """Return the number of independent looks that the image's most even places show; inf where they show no speckle.

    Notes
    -----
    The variance of the log-amplitude of L looks is a quarter of trigamma(L), about 1 / (4 L) from a few looks on; that
    of the image is taken in windows of 5 x 5 pixels, at their lower fifth. Texture, and looks that neighbouring pixels
    share, move it: it tells images of different kind apart, not four looks from five. Windows that do not vary at all
    (nodata, saturation) say nothing.
    """
    return image.derive(_equivalent_looks)


def filled_amplitude(image: Image) -> F32:
    """Return the (H, W) float32 amplitude with invalid pixels at the mean of the valid ones."""
    return image.amplitude if image.all_valid else image.derive(_filled_amplitude)


def _filled_amplitude(image: Image) -> F32:
    from featreg.sar import speckle_kernels

    amplitude = np.ascontiguousarray(image.amplitude)
    out = np.empty_like(amplitude)
    valid = np.ascontiguousarray(image.mask).view(np.uint8)
    speckle_kernels.filled(amplitude.ravel(), valid.ravel(), np.float32(mean_amplitude(image)), out.ravel())
    return out


def log_floor(image: Image) -> np.float32:
    """Return the least amplitude of which a logarithm is taken."""
    return np.float32(max(FLOOR * mean_amplitude(image), 1e-30))


def gaussian_reach(sigma: float) -> int:
    """Return how many pixels to each side a Gaussian of `sigma` pixels is taken."""
    return max(1, round(2.5 * sigma))


def mean_amplitude(image: Image) -> float:
    """Return the mean amplitude of the valid pixels (0 where there is none)."""
    return image.derive(_mean_amplitude)


def _equivalent_looks(image: Image) -> float:
    import cv2

    view = log_amplitude(image)
    size = (WINDOW, WINDOW)
    mean = cv2.boxFilter(view, cv2.CV_32F, size)
    variance = (cv2.sqrBoxFilter(view, cv2.CV_32F, size) - mean * mean)[:: WINDOW // 2, :: WINDOW // 2]
    told = variance[variance > EVEN]
    if not len(told):
        return float("inf")
    # The inverse of trigamma, to a tenth of it from one look on.
    return float(1 / (4 * np.quantile(told, FIFTH)) + 0.5)


def _mean_amplitude(image: Image) -> float:
    import cv2

    total = float(cv2.mean(image.amplitude)[0]) * image.mask.size
    return total / max(int(np.count_nonzero(image.mask)), 1)


def _log_amplitude(image: Image) -> F32:
    from featreg.sar import speckle_kernels

    amplitude = np.ascontiguousarray(filled_amplitude(image))
    out = np.empty_like(amplitude)
    speckle_kernels.logarithms(amplitude.ravel(), log_floor(image), out.ravel())
    return out


def _despeckled(image: Image, sigma: float) -> F32:
    out = np.empty(image.shape, np.float32)

    def part(start: int, stop: int) -> None:
        for first, last, smooth in _smoothed_strips(image, sigma, start, stop):
            out[first:last] = smooth

    if out.size <= LARGE:
        _smooth(image, sigma, slice(None), out, np.empty((0, 0), np.uint8))
    else:
        side_by_side([partial(part, *ends) for ends in _parts(len(out))])
    return out


def _despeckled_halved(image: Image, sigma: float) -> F32:
    import cv2

    height, width = (n // 2 for n in image.shape)
    out = np.empty((height, width), np.float32)
    if not out.size:
        return out

    def part(start: int, stop: int) -> None:
        for first, last, smooth in _smoothed_strips(image, sigma, start, stop):
            size = width, (last - first) // 2
            cv2.resize(smooth[:, : 2 * width], size, out[first // 2 : last // 2], 0, 0, cv2.INTER_AREA)

    side_by_side([partial(part, *ends) for ends in _parts(2 * height)])
    return out


def _parts(rows: int) -> Iterator[tuple[int, int]]:
    """(first, behind the last) row of parts that threads share out; all but the last have even ends."""
    edges = np.linspace(0, rows, PARTS + 1).astype(int) // 2 * 2
    edges[-1] = rows
    return pairwise(edges.tolist())


def _smoothed_strips(image: Image, sigma: float, start: int, stop: int) -> Iterator[tuple[int, int, F32]]:
    """(first, behind the last) row of strips between two rows, and their smoothed log-amplitude.

    Strips stay in the cache: of a large image only the amplitude is read and the result written.
    """
    reach = gaussian_reach(sigma)
    rows = max(2, STRIP // image.shape[1] // 2 * 2)
    for first in range(start, stop, rows):
        last = min(first + rows, stop)
        above, below = max(first - reach, 0), min(last + reach, image.shape[0])
        smooth = np.empty((below - above, image.shape[1]), np.float32)
        _smooth(image, sigma, slice(above, below), smooth, np.empty((0, 0), np.uint8))
        yield first, last, smooth[first - above : last - above]


def _despeckled_bytes(image: Image, sigma: float) -> NDArray[np.uint8]:
    out = np.empty(image.shape, np.uint8)
    _smooth(image, sigma, slice(None), np.empty((0, 0), np.float32), out)
    return out


def _smooth(image: Image, sigma: float, rows: slice, smooth: F32, steps: NDArray[np.uint8]) -> None:
    """Write the smoothed log-amplitude of some rows to `smooth` or, in bytes, to `steps`: to that which has rows.

    Beyond the first and the last of the rows they are mirrored.
    """
    import cv2

    from featreg.sar import speckle_kernels

    reach = gaussian_reach(sigma)
    taps = np.asarray(cv2.getGaussianKernel(2 * reach + 1, sigma).ravel()[reach:], np.float32)
    # A half more rounds to the nearest.
    offset = np.float32(_byte_offset(image) + 0.5)
    amplitude = np.ascontiguousarray(filled_amplitude(image)[rows])
    speckle_kernels.smoothed_logarithms(amplitude, log_floor(image), taps, np.float32(STEPS), offset, smooth, steps)


def _byte_offset(image: Image) -> float:
    """What is added to the steps of a logarithm, so that 128 is about the mean level."""
    # The mean of the logarithm of speckle lies that much below the logarithm of its mean, about; the floor of the
    # logarithm lies log(100) = 4.6 below the mean amplitude, so nothing turns negative.
    return 128 - STEPS * (math.log(max(mean_amplitude(image), 1e-30)) - BELOW_MEAN)
