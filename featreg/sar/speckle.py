"""Views of a SAR image in which speckle is additive or reduced."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from featreg.types import Image

F32 = NDArray[np.float32]

# Relative to the mean amplitude: darker pixels (shadow, quantised zeros) say nothing more.
FLOOR = 1e-2
# Pixels of a strip.
STRIP = 1 << 16
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


def as_bytes(image: Image, logs: F32, out: NDArray[np.uint8] | None = None) -> NDArray[np.uint8]:
    """Return smoothed logarithms of an image's amplitude in the steps of `despeckled_bytes`, in `out` if given."""
    import cv2

    # The mean of the logarithm of speckle lies that much below the logarithm of its mean, about; the floor of the
    # logarithm lies log(100) = 4.6 below the mean amplitude, so nothing turns negative.
    middle = math.log(max(mean_amplitude(image), 1e-30)) - BELOW_MEAN
    return np.asarray(cv2.convertScaleAbs(logs, out, alpha=28, beta=128 - 28 * middle), np.uint8)


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
    # Invalid pixels hold 0.
    return np.asarray(image.amplitude + np.float32(mean_amplitude(image)) * ~image.mask, np.float32)


def log_floor(image: Image) -> np.float32:
    """Return the least amplitude of which a logarithm is taken."""
    return np.float32(max(FLOOR * mean_amplitude(image), 1e-30))


def gaussian_reach(sigma: float) -> int:
    """Return how many pixels to each side a Gaussian of `sigma` pixels is taken."""
    return round(2.5 * sigma)


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
    amplitude = filled_amplitude(image)
    out = np.empty_like(amplitude)
    for start, stop in _strips(amplitude.shape):
        _log_of_rows(image, amplitude, start, stop, out[start:stop])
    return out


def _despeckled(image: Image, sigma: float) -> F32:
    out = np.empty(image.shape, np.float32)
    for start, stop, smooth in _smoothed_strips(image, sigma):
        out[start:stop] = smooth
    return out


def _despeckled_halved(image: Image, sigma: float) -> F32:
    import cv2

    height, width = (n // 2 for n in image.shape)
    out = np.empty((height, width), np.float32)
    if not out.size:
        return out
    for start, stop, smooth in _smoothed_strips(image, sigma):
        rows = (stop - start) // 2
        if rows:
            size = width, rows
            cv2.resize(smooth[: 2 * rows, : 2 * width], size, out[start // 2 : start // 2 + rows], 0, 0, cv2.INTER_AREA)
    return out


def _despeckled_bytes(image: Image, sigma: float) -> NDArray[np.uint8]:
    out = np.empty(image.shape, np.uint8)
    for start, stop, smooth in _smoothed_strips(image, sigma):
        as_bytes(image, smooth, out[start:stop])
    return out


def _smoothed_strips(image: Image, sigma: float) -> Iterator[tuple[int, int, F32]]:
    """Rows (start, stop) of the image and their smoothed log-amplitude, which is overwritten by the next ones.

    Strips stay in the cache: of a large image only the amplitude is read and the result written.
    """
    import cv2

    amplitude = filled_amplitude(image)
    height, width = amplitude.shape
    reach = gaussian_reach(sigma)
    side = 2 * reach + 1
    rows = min(height, max(2, STRIP // width // 2 * 2) + 2 * reach)
    logs, smooth = np.empty((rows, width), np.float32), np.empty((rows, width), np.float32)
    for start, stop in _strips(amplitude.shape):
        first, last = max(start - reach, 0), min(stop + reach, height)
        part, out = logs[: last - first], smooth[: last - first]
        _log_of_rows(image, amplitude, first, last, part)
        cv2.GaussianBlur(part, (side, side), sigma, out, borderType=cv2.BORDER_REFLECT_101)
        yield start, stop, out[start - first : stop - first]


def _strips(shape: tuple[int, int]) -> Iterator[tuple[int, int]]:
    """(first, behind the last) row of strips of an image that stay in the cache; all but the last have even ends."""
    height, width = shape
    rows = max(2, STRIP // width // 2 * 2)
    for start in range(0, height, rows):
        yield start, min(start + rows, height)


def _log_of_rows(image: Image, amplitude: F32, start: int, stop: int, out: F32) -> None:
    import cv2

    cv2.log(np.maximum(amplitude[start:stop], log_floor(image), out=out), out)
