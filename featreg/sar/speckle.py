"""Views of a SAR image in which speckle is additive or reduced."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.threads import in_parts
from featreg.types import Image, IntArray, read_only

F32 = NDArray[np.float32]

# Relative to the mean amplitude: darker pixels (shadow, quantised zeros) say nothing more.
FLOOR = 1e-2
# Images of more pixels are summed in bands of so many rows.
LARGE, BAND = 1 << 20, 64
# Pixels of a strip, and steps of a byte for one of the natural logarithm.
STRIP, STEPS = 1 << 16, 28
# Side of the squares in which bytes are made where points are, px, and the share of an image from which on all are.
TILE, MANY = 16, 0.6
# What kernels take for an output that is not asked for.
NO_ROWS, NO_BYTES = np.empty((0, 0), np.float32), np.empty((0, 0), np.uint8)
# What the mean of the logarithm lies below the logarithm of the mean, about, of one look.
BELOW_MEAN = 0.25
# Side of the windows by which looks are told, variance below which one shows nothing, and the share of the most even.
WINDOW, EVEN, FIFTH = 5, 1e-6, 0.2
# Ratio of the looks of two images from which on they are of different kind. Dates of one sensor have at most 11 (8-bit
# products that were smoothed differently), an optical image against a SAR image mostly more, up to 200.
UNLIKE = 12.0


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
    view = image.derive(_byte_view, sigma=float(sigma))
    return view.seen if view.complete else view.whole(image)


def despeckled_bytes_around(
    image: Image, places: Callable[[], IntArray], count: int, reach: int, sigma: float = 1.0
) -> NDArray[np.uint8]:
    """Return `despeckled_bytes`, of which only what lies up to `reach` px around some pixels along x and y is made.

    The rest is arbitrary, or what was made for others before; all of it where they are many. They are the (N, 2) that
    `places` returns, which is asked only where it matters, and as many as `count`.
    """
    view = image.derive(_byte_view, sigma=float(sigma))
    if view.complete:
        return view.seen
    return view.whole(image) if view.worth(count, reach) else view.around(image, places(), reach)


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


def unlike(reference: Image, secondary: Image) -> bool:
    """Return whether the speckle of two images says that they are of different kind, as an optical and a SAR image."""
    looks = equivalent_looks(reference), equivalent_looks(secondary)
    # Two that show no speckle are of one kind: both are infinite.
    return looks[0] != looks[1] and max(looks) >= UNLIKE * min(looks)


def filled_amplitude(image: Image) -> F32:
    """Return the (H, W) float32 amplitude with invalid pixels at the mean of the valid ones."""
    return image.amplitude if image.all_valid else image.derive(_filled_amplitude)


def _filled_amplitude(image: Image) -> F32:
    from featreg.sar import speckle_kernels

    amplitude = np.ascontiguousarray(image.amplitude)
    out = np.empty_like(amplitude)
    valid = np.ascontiguousarray(image.mask).view(np.uint8)
    value = np.float32(mean_amplitude(image))

    def part(first: int, stop: int) -> None:
        some = slice(first, stop)
        speckle_kernels.filled(amplitude[some].ravel(), valid[some].ravel(), value, out[some].ravel())

    in_parts(part, *out.shape)
    return out


def log_floor(image: Image) -> np.float32:
    """Return the least amplitude of which a logarithm is taken."""
    return _floor(mean_amplitude(image))


def _floor(mean: float) -> np.float32:
    return np.float32(max(FLOOR * mean, 1e-30))


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

    amplitude = image.amplitude
    if amplitude.size <= LARGE:
        total = float(cv2.mean(amplitude)[0]) * amplitude.size
    else:
        # In bands that do not depend on the threads, so that the sum does not.
        rows = [slice(first, first + BAND) for first in range(0, len(amplitude), BAND)]
        sums = np.empty(len(rows))

        def part(first: int, stop: int) -> None:
            for k in range(first, stop):
                some = amplitude[rows[k]]
                sums[k] = cv2.mean(some)[0] * some.size

        in_parts(part, len(rows), BAND * amplitude.shape[1])
        total = float(sums.sum())
    return total / max(image.valid_count, 1)


def _log_amplitude(image: Image) -> F32:
    from featreg.sar import speckle_kernels

    amplitude = np.ascontiguousarray(filled_amplitude(image))
    out = np.empty_like(amplitude)
    floor = log_floor(image)

    def part(first: int, stop: int) -> None:
        speckle_kernels.logarithms(amplitude[first:stop].ravel(), floor, out[first:stop].ravel())

    in_parts(part, *out.shape)
    return out


def _despeckled(image: Image, sigma: float) -> F32:
    out = np.empty(image.shape, np.float32)
    _smooth(image, sigma, out, NO_BYTES)
    return out


def _despeckled_halved(image: Image, sigma: float) -> F32:
    import cv2

    height, width = (n // 2 for n in image.shape)
    out = np.empty((height, width), np.float32)
    if not out.size:
        return out
    amplitude, terms = np.ascontiguousarray(filled_amplitude(image)), _byte_terms(image, sigma)

    def part(start: int, stop: int) -> None:
        for first, last, smooth in _smoothed_strips(amplitude, terms, start, stop):
            size = width, (last - first) // 2
            cv2.resize(smooth[:, : 2 * width], size, out[first // 2 : last // 2], 0, 0, cv2.INTER_AREA)

    in_parts(part, 2 * height, image.shape[1], 2)
    return out


def _smoothed_strips(
    amplitude: F32, terms: tuple[np.float32, F32, np.float32], start: int, stop: int
) -> Iterator[tuple[int, int, F32]]:
    """(first, behind the last) row of strips between two rows, and their smoothed log-amplitude.

    `terms` are `_byte_terms`. Strips stay in the cache: of a large image only the amplitude is read and the result
    written.
    """
    from featreg.sar.speckle_kernels import smoothed_logarithms as kernel

    floor, taps, offset = terms
    reach = len(taps) - 1
    height, width = amplitude.shape
    rows = max(2, STRIP // width // 2 * 2)
    for first in range(start, stop, rows):
        last = min(first + rows, stop)
        above, below = max(first - reach, 0), min(last + reach, height)
        smooth = np.empty((below - above, width), np.float32)
        kernel(amplitude[above:below], floor, taps, np.float32(STEPS), offset, 0, len(smooth), smooth, NO_BYTES)
        yield first, last, smooth[first - above : last - above]


class _ByteView:
    """The despeckled bytes of an image, made square by square where they are asked for."""

    def __init__(self, shape: tuple[int, int], sigma: float) -> None:
        self.sigma, self.lock = sigma, threading.Lock()
        self.steps = np.empty(shape, np.uint8)
        self.seen = self.steps.view()
        self.seen.flags.writeable = False
        self.made = np.zeros((-(-shape[0] // TILE), -(-shape[1] // TILE)), np.uint8)
        self.complete = False

    @property
    def nbytes(self) -> int:
        """What it holds, for the store of derived maps."""
        return self.steps.nbytes + self.made.nbytes

    def worth(self, count: int, reach: int) -> bool:
        """Whether so many points are worth making all of it."""
        return count * (2 * reach + TILE) ** 2 > MANY * self.steps.size

    def around(self, image: Image, xy: IntArray, reach: int) -> NDArray[np.uint8]:
        with self.lock:
            if len(xy) and not self.complete:
                self._make(image, xy, reach)
                self.complete = bool(self.made.all())
        return self.seen

    def whole(self, image: Image) -> NDArray[np.uint8]:
        with self.lock:
            if not self.complete:
                _smooth(image, self.sigma, NO_ROWS, self.steps)
                self.complete = True
        return self.seen

    def _make(self, image: Image, xy: IntArray, reach: int) -> None:
        from featreg.sar import speckle_kernels

        low, high = (np.clip((xy + by) // TILE, 0, np.array(self.made.shape[::-1]) - 1) for by in (-reach, reach))
        # Squares in which points' own begin count one more, those behind their ends one less.
        edges = np.zeros((self.made.shape[0] + 1, self.made.shape[1] + 1), np.int64)
        for y, x, by in (
            (low[:, 1], low[:, 0], 1), (low[:, 1], high[:, 0] + 1, -1),
            (high[:, 1] + 1, low[:, 0], -1), (high[:, 1] + 1, high[:, 0] + 1, 1),
        ):  # fmt: skip
            np.add.at(edges, (y, x), by)
        asked = edges.cumsum(axis=0).cumsum(axis=1)[:-1, :-1] > 0
        self.made[asked & (self.made == 0)] = 1
        floor, taps, offset = _byte_terms(image, self.sigma)
        amplitude = np.ascontiguousarray(filled_amplitude(image))

        def part(first: int, stop: int) -> None:
            speckle_kernels.smoothed_logarithms_of_tiles(
                amplitude, floor, taps, np.float32(STEPS), offset, self.made, first, stop, TILE, self.steps
            )

        in_parts(part, len(self.made), TILE * image.shape[1])


def _byte_view(image: Image, sigma: float) -> _ByteView:
    return _ByteView(image.shape, sigma)


def _byte_terms(image: Image, sigma: float) -> tuple[np.float32, F32, np.float32]:
    """Least amplitude, taps of the Gaussian, and what is added to the steps."""
    mean = mean_amplitude(image)
    # A half more rounds to the nearest.
    return _floor(mean), _taps(sigma), np.float32(_byte_offset(mean) + 0.5)


@lru_cache(maxsize=16)
def _taps(sigma: float) -> F32:
    """Those of the middle of a Gaussian and of the pixels beside it."""
    import cv2

    reach = gaussian_reach(sigma)
    return read_only(np.array(cv2.getGaussianKernel(2 * reach + 1, sigma).ravel()[reach:], np.float32))


def _smooth(image: Image, sigma: float, smooth: F32, steps: NDArray[np.uint8]) -> None:
    """Write the smoothed log-amplitude to `smooth` (H, W) or, in bytes, to `steps` (H, W): to that which has rows."""
    from featreg.sar import speckle_kernels

    floor, taps, offset = _byte_terms(image, sigma)
    amplitude = np.ascontiguousarray(filled_amplitude(image))

    def part(top: int, bottom: int) -> None:
        speckle_kernels.smoothed_logarithms(
            amplitude, floor, taps, np.float32(STEPS), offset, top, bottom, smooth, steps
        )

    in_parts(part, *image.shape)


def _byte_offset(mean: float) -> float:
    """What is added to the steps of a logarithm, so that 128 is about the level of the mean amplitude."""
    # The mean of the logarithm of speckle lies that much below the logarithm of its mean, about; the floor of the
    # logarithm lies log(100) = 4.6 below the mean amplitude, so nothing turns negative.
    return 128 - STEPS * (math.log(max(mean, 1e-30)) - BELOW_MEAN)
