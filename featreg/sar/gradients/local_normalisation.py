"""Local normalisation: what an image is beside its surroundings, in units of how much these vary.

References
----------
J. Li, W. Xu, P. Shi, Y. Zhang, Q. Hu, "LNIFT: locally normalized image for rotation invariant multimodal feature
matching", IEEE TGRS 60 (2022), DOI 10.1109/TGRS.2022.3165940.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.sar.speckle import filled_amplitude
from featreg.types import BoolArray, Image

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]

#: Deviations of so many local standard deviations are the lowest and the highest byte.
RANGE = 3.0
# Local standard deviations below this share of the largest are not divided by.
LEAST = 1e-4


def locally_normalised(image: Image, window: int) -> F32:
    """Return the amplitude less its mean over a square of `window` px, over its standard deviation there.

    (H, W) float32, limited to -3 and 3; 0 where the image is constant and where there is no data. Computed once.
    """
    return image.derive(_locally_normalised, window=int(window))


def as_bytes(normalised: F32) -> U8:
    """Normalised values from -3 to 3 as bytes."""
    return np.asarray(np.rint((normalised + np.float32(RANGE)) * np.float32(127.5 / RANGE)), np.uint8)


def _locally_normalised(image: Image, window: int) -> F32:
    import cv2

    valid: BoolArray = image.mask
    weight = valid.astype(np.float32)
    view = filled_amplitude(image)
    # Of deviations from the mean of all, so that squares do not cancel.
    view = (view - np.float32(view.mean())) * weight
    size = (window, window)

    def mean(of: F32) -> F32:
        return np.asarray(cv2.boxFilter(of, -1, size, normalize=True, borderType=cv2.BORDER_CONSTANT), np.float32)

    share = np.maximum(mean(weight), np.float32(1e-6))
    middle = mean(view) / share
    variance = np.maximum(mean(view * view) / share - middle * middle, 0)
    deviation = np.sqrt(variance)
    floor = np.float32(LEAST) * deviation.max() + np.float32(1e-30)
    return np.asarray(np.clip((view - middle) / np.maximum(deviation, floor), -RANGE, RANGE) * weight, np.float32)
