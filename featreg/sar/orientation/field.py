"""The double-angle field of ratio gradients: the direction of structure, blind to reversed contrast.

References
----------
A. J. Fitch, A. Kadyrov, W. J. Christmas, J. Kittler, "Orientation correlation", BMVC 2002, DOI 10.5244/C.16.11, of
gradients with their sign. R. Fjortoft et al., "An optimal multiedge detector for SAR image segmentation", IEEE TGRS 36
(1998) 793, DOI 10.1109/36.673672, of the gradients (`featreg.sar.gradients.ratio`).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from featreg.sar.gradients.ratio import FLOOR, LEAST_EDGE, log_ratios
from featreg.sar.speckle import filled_amplitude
from featreg.types import BoolArray, Image

F32 = NDArray[np.float32]

#: Samples nearer than so many alpha to one without data have no direction.
BLIND = 2.0
# Pixels from which the median strength of the gradients is taken.
SAMPLE = 5_000


def orientation_field(image: Image, alpha: float = 3.0) -> F32:
    """Return the orientation field of an image, computed once.

    Parameters
    ----------
    image : Image
        Amplitude or complex; nothing within 2 alpha of invalid pixels is looked at.
    alpha : float
        Of the ROEWA gradients, px.

    Returns
    -------
    (H, W, 2) float32
        Real and imaginary part of z = (gx + i gy)^2 / (|g|^2 + m), m the median of |g|^2 where it is not 0; |z| < 1.
        0 where there is no gradient, no data, and within alpha of the border of the image.

    Notes
    -----
    A structure turned by t, clockwise as seen, turns z by 2 t; one of reversed contrast leaves it. With the plain
    (gx + i gy)^2 / |g| a few strong edges outweigh all others; the median keeps weak and strong ones alike, and what
    is noise at almost no strength small.
    """
    return image.derive(_orientation_field, alpha=float(alpha))


def _orientation_field(image: Image, alpha: float) -> F32:
    return field_of(filled_amplitude(image), alpha, None if image.all_valid else image.mask)


def field_of(amplitude: F32, alpha: float, mask: BoolArray | None = None) -> F32:
    """As `orientation_field`, of a plain (H, W) float32 array whose invalid pixels hold about the mean amplitude."""
    import cv2

    from featreg.sar.orientation import field_kernels

    out = np.empty((*amplitude.shape, 2), np.float32)
    log_ratios(amplitude, alpha, FLOOR, both=out)
    out[:, [0, -1], 0] = 0
    out[[0, -1], :, 1] = 0
    seen = np.ones(amplitude.shape, np.bool_)
    if mask is not None:
        side = 2 * math.ceil(BLIND * alpha) + 1
        seen = np.asarray(cv2.erode(mask.view(np.uint8), np.ones((side, side), np.uint8))).view(np.bool_)
    step = max(1, math.isqrt(amplitude.size // SAMPLE))
    strength = np.square(out[::step, ::step]).sum(axis=2)
    some = strength[(strength > 0) & seen[::step, ::step]]
    if not some.size or not float(some.max()) > LEAST_EDGE**2:
        return np.zeros_like(out)
    # A mean over the few samples left at the rim is noise along one axis: an edge that follows every rim.
    rim = math.ceil(alpha)
    seen[:rim], seen[-rim:], seen[:, :rim], seen[:, -rim:] = False, False, False, False
    field_kernels.double_angle(out, seen, np.float32(np.median(some)))
    return out


def turned(field: F32, degrees: float) -> F32:
    """The field (H, W, 2) of the same structures turned counter-clockwise as seen, each sample in its place."""
    angle = math.radians(-2 * degrees)
    c, s = np.float32(math.cos(angle)), np.float32(math.sin(angle))
    x, y = field[..., 0], field[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)
