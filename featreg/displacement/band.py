"""What is correlated of two images: the band of their log-amplitudes that tells a position, on one grid."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from featreg.sar.speckle import log_amplitude
from featreg.types import BoolArray, FloatArray, Image

F32 = NDArray[np.float32]
Map = Callable[[FloatArray], FloatArray]

#: Standard deviations of the two Gaussians whose difference is the band that is correlated, px of the level. Speckle is
#: white: what is finer than the first holds little else, and what is coarser than the second hardly tells a position.
BAND = (0.7, 2.0)
TAPS = (5, 9)


def aligned(secondary: Image, base: Map | None, shape: tuple[int, int]) -> tuple[F32, BoolArray | None]:
    """Return the log-amplitude of the secondary on the reference grid (H, W) as `base` has it, and its mask, None: all.

    Where there is nothing to resample, nothing is.
    """
    import cv2

    log, mask = log_amplitude(secondary), None if secondary.all_valid else secondary.mask
    if base is None:
        height, width = shape
        down, right = max(height - log.shape[0], 0), max(width - log.shape[1], 0)
        if down or right:
            mask = np.pad(secondary.mask, ((0, down), (0, right)))
            log = np.asarray(cv2.copyMakeBorder(log, 0, down, 0, right, cv2.BORDER_REPLICATE), np.float32)
        return np.ascontiguousarray(log[:height, :width]), None if mask is None else mask[:height, :width]
    x, y = np.meshgrid(*(np.arange(n, dtype=np.float64) for n in shape[::-1]))
    mapped = base(np.column_stack([x.ravel(), y.ravel()])).reshape(*shape, 2).astype(np.float32)
    sampled = cv2.remap(log, mapped[..., 0], mapped[..., 1], cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
    valid = cv2.remap(
        secondary.mask.astype(np.float32), mapped[..., 0], mapped[..., 1], cv2.INTER_LINEAR, borderValue=0.0
    )
    return np.asarray(sampled, np.float32), np.asarray(valid > 0.99)


def band(log: F32, mask: BoolArray | None = None) -> F32:
    """Return the band of a log-amplitude that is correlated, 0 on and near pixels that are not data."""
    import cv2

    fine, broad = (
        cv2.GaussianBlur(log, (side, side), s, borderType=cv2.BORDER_REFLECT_101)
        for s, side in zip(BAND, TAPS, strict=True)
    )
    out = np.asarray(cv2.subtract(fine, broad), np.float32)
    if mask is not None and not mask.all():
        side = 2 * round(2 * BAND[1]) + 1
        out *= np.asarray(cv2.erode(mask.view(np.uint8), np.ones((side, side), np.uint8), borderValue=1), np.float32)
    return out


@lru_cache(maxsize=64)
def chance(window: int) -> float:
    """Return one over the standard deviation of the correlation of two unrelated windows of band-passed speckle.

    M. S. Bartlett, "Some aspects of the time-correlation problem", J. R. Stat. Soc. 98 (1935) 536: its variance is the
    sum of the squared autocorrelation of the band over the number of pixels.
    """
    impulse = np.zeros((65, 65), np.float32)
    impulse[32, 32] = 1
    spectrum = np.abs(np.fft.fft2(band(impulse).astype(np.float64))) ** 2
    autocorrelation = np.fft.ifft2(spectrum).real
    return float(window / math.sqrt(((autocorrelation / autocorrelation[0, 0]) ** 2).sum()))
