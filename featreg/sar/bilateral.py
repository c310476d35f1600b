"""Bilateral scale space of a SAR image: smoothing that stops at edges, stronger from level to level.

References
----------
C. Tomasi, R. Manduchi, "Bilateral filtering for gray and color images", ICCV 1998, DOI 10.1109/ICCV.1998.710815.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from featreg.sar.gradient_histograms import PolarField
from featreg.sar.speckle import log_amplitude
from featreg.types import Image

F32 = NDArray[np.float32]

# Standard deviations to which the spatial weight reaches.
REACH = 1.5
# Differences of neighbouring pixels from which the noise is taken, about.
SAMPLE = 20_000


@dataclass(frozen=True)
class BilateralSpace:
    """One octave of a bilateral scale space.

    Parameters
    ----------
    intervals : levels to a doubling of sigma; there are three more, so that each interval has neighbours on both sides
    sigma : spatial standard deviation in pixels of the first level
    tone : standard deviation of the weight of a difference of log-amplitudes, in units of the image's own noise
    exact : filter the image itself for every level. Otherwise the fast way: each level filters the one before by what
        is missing, sqrt(sigma_k^2 - sigma_(k-1)^2), as may be done with Gaussians; with bilateral weights it is another
        filter, which flattens more, at less than half the cost
    """

    intervals: int = 3
    sigma: float = 1.2
    tone: float = 5.0
    exact: bool = False

    @property
    def levels(self) -> int:
        return self.intervals + 3

    def sigma_of(self, level: int) -> float:
        return float(self.sigma * 2 ** (level / self.intervals))


def bilateral_levels(image: Image, space: BilateralSpace) -> F32:
    """Return the (levels, H, W) float32 bilaterally smoothed log-amplitude; invalid pixels count as the mean."""
    return image.derive(_bilateral_levels, space=space)


def _bilateral_levels(image: Image, space: BilateralSpace) -> F32:
    import cv2

    source = log_amplitude(image)
    range_sigma = space.tone * noise_level(image)
    out = np.empty((space.levels, *image.shape), np.float32)
    held = 0.0
    for k in range(space.levels):
        wanted = space.sigma_of(k)
        spread = wanted if space.exact else math.sqrt(wanted * wanted - held * held)
        side = 2 * max(1, round(REACH * spread)) + 1
        before = source if space.exact or k == 0 else out[k - 1]
        out[k] = cv2.bilateralFilter(before, side, range_sigma, spread, borderType=cv2.BORDER_REFLECT_101)
        held = wanted
    return out


def bilateral_field(image: Image, space: BilateralSpace, level: int) -> PolarField:
    """Return the gradient of one level of `bilateral_levels` (Sobel's derivative), by length and direction."""
    return image.derive(_bilateral_field, space=space, level=int(level))


def _bilateral_field(image: Image, space: BilateralSpace, level: int) -> PolarField:
    import cv2

    smooth = bilateral_levels(image, space)[level]
    gx = np.asarray(cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=1 / 8), np.float32)
    gy = np.asarray(cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=1 / 8), np.float32)
    if not image.all_valid:
        # Beside nodata, which counts as the mean, there is an edge that is none.
        near = cv2.erode(image.mask.view(np.uint8), np.ones((3, 3), np.uint8)) != 0
        gx, gy = gx * near, gy * near
    return PolarField.of(gx, gy)


def noise_level(image: Image) -> float:
    """Return the standard deviation of the speckle of the log-amplitude, from the differences of neighbouring pixels.

    1.4826 / sqrt(2) times the median absolute difference along rows and columns of valid pixels, at least 1e-3. About
    0.64 for one look and 0.25 for four, less where neighbouring pixels are correlated.
    """
    return image.derive(_noise_level)


def _noise_level(image: Image) -> float:
    view, mask = log_amplitude(image), image.mask
    step = max(1, math.isqrt(view.size // SAMPLE))
    across = np.abs(view[::step, 1:] - view[::step, :-1])[mask[::step, 1:] & mask[::step, :-1]]
    down = np.abs(view[1:, ::step] - view[:-1, ::step])[mask[1:, ::step] & mask[:-1, ::step]]
    both = np.concatenate([across[::step], down[::step]])
    return max(1e-3, 1.4826 / math.sqrt(2) * float(np.median(both))) if both.size else 1e-3
