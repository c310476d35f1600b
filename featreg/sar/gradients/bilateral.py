"""Bilateral scale space of a SAR image: smoothing that stops at edges, stronger from level to level.

Notes
-----
A pixel becomes the mean of those in a disc of 1.5 sigma, weighted by exp(-r^2 / 2 sigma^2) of their distance r and
exp(-d^2 / 2 tone^2) of their difference d in value. The fast cascade takes (1 - d^2 / 16 tone^2)^8 for the latter, 0 at
differences of 4 tone and more: within 2 % of it up to one tone, and without a call of the exponential.

References
----------
C. Tomasi, R. Manduchi, "Bilateral filtering for gray and color images", ICCV 1998, DOI 10.1109/ICCV.1998.710815.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from featreg.sar.gradients.gradient_field import GradientField
from featreg.sar.speckle import log_amplitude
from featreg.types import Image

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]

# Standard deviations to which the spatial weight reaches.
REACH = 1.5
# Differences, in units of the tone, from which on the fast cascade gives no weight.
VANISHING = 4.0
# Differences of neighbouring pixels from which the noise is taken, about, where not all are.
SAMPLE = 8_000


@dataclass(frozen=True)
class BilateralSpace:
    """One octave of a bilateral scale space.

    Parameters
    ----------
    intervals : levels to a doubling of sigma; three more give each interval neighbours on both sides
    sigma : spatial standard deviation in pixels of the first level
    tone : standard deviation of the weight of a difference of log-amplitudes, in units of the image's own noise
    exact : filter the image itself for every level, by a tone in units of the noise of all its pixels. Otherwise the
        fast way: each level filters the one before by what is missing, sqrt(sigma_k^2 - sigma_(k-1)^2), as may be done
        with Gaussians; with bilateral weights it is another filter, which flattens more, at about a tenth of the cost;
        and some pixels tell the noise
    """

    intervals: int = 3
    sigma: float = 1.2
    tone: float = 5.0
    exact: bool = False

    def sigma_of(self, level: int) -> float:
        return float(self.sigma * 2 ** (level / self.intervals))


def bilateral_level(image: Image, space: BilateralSpace, level: int) -> F32:
    """Return the (H, W) float32 bilaterally smoothed log-amplitude of one level; invalid pixels count as the mean."""
    return image.derive(_bilateral_level, space=space, level=int(level))


def _bilateral_level(image: Image, space: BilateralSpace, level: int) -> F32:
    import cv2

    source, wanted = log_amplitude(image), space.sigma_of(level)
    tone = space.tone * noise_level(image, whole=space.exact)
    if space.exact:
        side = 2 * _radius(wanted) + 1
        return np.asarray(cv2.bilateralFilter(source, side, tone, wanted, borderType=cv2.BORDER_REFLECT_101))
    held = 0.0
    if level:
        source, held = bilateral_level(image, space, level - 1), space.sigma_of(level - 1)
    out = np.empty(image.shape, np.float32)
    _smooth(source, math.sqrt(wanted * wanted - held * held), tone, out)
    return out


def _smooth(image: F32, sigma: float, tone: float, out: F32) -> None:
    """Fill `out` with the bilateral mean of (H, W) `image`, mirrored at its borders."""
    from featreg.sar.gradients import bilateral_kernels

    radius = _radius(sigma)
    near = [(y, x) for y in range(radius + 1) for x in range(1, radius + 1) if x * x + y * y <= radius * radius]
    # Neighbours that a mirror exchanges are added at once, so a mirrored image gives the mirrored result to the bit.
    steps = np.array([((y, x), (y, -x) if y else (x, 0)) for y, x in near], np.int64)
    spatial = np.exp(-(steps[:, 0] ** 2).sum(axis=1) / (2 * sigma * sigma)).astype(np.float32)
    rows, columns = (_mirrored(length, radius) for length in image.shape)
    # Beyond these the tone is as good as none and infinite; a difference over it would overflow.
    unit = np.float32(min(max(VANISHING * tone, 1e-30), 1e30))
    bilateral_kernels.smooth(image, unit, steps, spatial, rows, columns, out)


def _radius(sigma: float) -> int:
    return max(1, round(REACH * sigma))


def _mirrored(length: int, pad: int) -> I64:
    """Indices from `pad` before to `pad` behind 0 to length - 1, mirrored about the first and the last one."""
    period = max(1, 2 * (length - 1))
    index = np.arange(-pad, length + pad) % period
    return np.minimum(index, period - index) if length > 1 else index


def bilateral_extrema(image: Image, space: BilateralSpace, interval: int, threshold: float) -> I64:
    """Return the flat indices of the extrema of the difference of levels of an interval, in reading order.

    Interval k lies between the levels k + 1 and k + 2. Its difference, the coarser level less the finer, is there the
    greatest or least among its 26 neighbours in space and scale, and further from 0 than `threshold`.
    """
    from featreg.sar.gradients import bilateral_kernels

    height, width = image.shape
    # Of four pixels in a square at most one is the greatest and one the least.
    at = np.empty(2 * ((height + 1) // 2) * ((width + 1) // 2), np.int64)
    first, finer, coarser, last = (bilateral_level(image, space, k) for k in range(interval, interval + 4))
    return at[: bilateral_kernels.extrema(first, finer, coarser, last, np.float32(threshold), at)].copy()


def bilateral_field(image: Image, space: BilateralSpace, level: int) -> GradientField:
    """Return the gradient of one `bilateral_level`, by Sobel's derivative; 0 beside nodata."""
    return image.derive(_bilateral_field, space=space, level=int(level))


def _bilateral_field(image: Image, space: BilateralSpace, level: int) -> GradientField:
    import cv2

    smooth = bilateral_level(image, space, level)
    gx = np.asarray(cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=1 / 8), np.float32)
    gy = np.asarray(cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=1 / 8), np.float32)
    if not image.all_valid:
        # Beside nodata, which counts as the mean, there is an edge that is none.
        near = cv2.erode(image.mask.view(np.uint8), np.ones((3, 3), np.uint8)) != 0
        gx, gy = gx * near, gy * near
    return GradientField(gx, gy)


def noise_level(image: Image, *, whole: bool = False) -> float:
    """Return the standard deviation of the speckle of the log-amplitude, from the differences of neighbouring pixels.

    1.4826 / sqrt(2) times the median absolute difference along rows and columns of valid pixels, at least 1e-3. About
    0.58 for one look, whose long tail of dark pixels the median leaves out, and 0.26 for four; less where neighbouring
    pixels are correlated. Unless `whole`, about 8000 differences are taken, spread over the image.
    """
    return image.derive(_noise_level, whole=bool(whole))


def _noise_level(image: Image, whole: bool) -> float:
    view, mask = log_amplitude(image), image.mask
    step = 1 if whole else max(1, math.isqrt(2 * view.size // SAMPLE))
    every = slice(None, None, step)
    across = (view[every, 1::step] - view[every, :-1:step])[mask[every, 1::step] & mask[every, :-1:step]]
    down = (view[1::step, every] - view[:-1:step, every])[mask[1::step, every] & mask[:-1:step, every]]
    both = np.abs(np.concatenate([across, down]))
    return max(1e-3, 1.4826 / math.sqrt(2) * float(np.median(both))) if both.size else 1e-3
