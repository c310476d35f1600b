"""Views of a SAR image in which speckle is additive or reduced."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.types import Image

F32 = NDArray[np.float32]

# Relative to the mean amplitude: darker pixels (shadow, quantised zeros) say nothing more.
FLOOR = 1e-2


def log_amplitude(image: Image) -> F32:
    """Return the (H, W) float32 natural logarithm of the amplitude, in which speckle is additive.

    Amplitudes are floored at 1 % of their mean; invalid pixels hold the mean of the valid logarithms, so that smooth
    filters near them stay in range.
    """
    return image.derive(_log_amplitude)


def despeckled(image: Image, sigma: float = 1.5) -> F32:
    """Return the (H, W) float32 log-amplitude smoothed by a Gaussian of `sigma` pixels, for comparing intensities."""
    return image.derive(_despeckled, sigma=float(sigma))


def _log_amplitude(image: Image) -> F32:
    import cv2

    amplitude = image.amplitude
    mean = float(cv2.mean(amplitude)[0]) * image.mask.size / max(int(np.count_nonzero(image.mask)), 1)
    logarithm: F32 = cv2.log(np.maximum(amplitude, max(FLOOR * mean, 1e-30)))
    if not image.all_valid and image.mask.any():
        logarithm[~image.mask] = logarithm[image.mask].mean()
    return logarithm


def _despeckled(image: Image, sigma: float) -> F32:
    import cv2

    side = 2 * round(2.5 * sigma) + 1
    smooth: F32 = cv2.GaussianBlur(log_amplitude(image), (side, side), sigma, borderType=cv2.BORDER_REFLECT_101)
    return smooth
