"""An image on another grid for correlation: real samples, or complex ones whose spectrum is not around zero."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.types import BoolArray, FloatArray


def aligned(
    pixels: NDArray[Any], valid: BoolArray, matrix: FloatArray, shape: tuple[int, int]
) -> tuple[NDArray[Any], BoolArray]:
    """Return an image, and which of it is data, on the (H, W) grid whose pixels `matrix` (2, 3) maps to it; cubic.

    Notes
    -----
    The spectrum of focused complex images lies anywhere, and interpolation keeps only what is near zero frequency: the
    mean phase steps along both axes are removed before and put back at the places that were interpolated.
    """
    import cv2

    size = (shape[1], shape[0])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    inverse = np.asarray(matrix, np.float64)
    linear = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    share = cv2.warpAffine(valid.view(np.uint8) * np.uint8(255), inverse, size, flags=linear)
    inside = np.asarray(share) == 255
    if not np.iscomplexobj(pixels):
        return np.asarray(cv2.warpAffine(pixels, inverse, size, flags=flags), np.float32), inside
    kx = float(np.angle(np.vdot(pixels[:, :-1], pixels[:, 1:])))
    ky = float(np.angle(np.vdot(pixels[:-1], pixels[1:])))
    height, width = pixels.shape
    ramp = np.exp(-1j * (kx * np.arange(width)[None, :] + ky * np.arange(height)[:, None]))
    flat = np.ascontiguousarray(pixels * ramp.astype(np.complex64))
    both = cv2.warpAffine(flat.view(np.float32).reshape(height, width, 2), inverse, size, flags=flags)
    moved = np.ascontiguousarray(both, np.float32).view(np.complex64)[..., 0]
    x, y = np.arange(shape[1])[None, :], np.arange(shape[0])[:, None]
    there = [inverse[i, 0] * x + inverse[i, 1] * y + inverse[i, 2] for i in (0, 1)]
    return (moved * np.exp(1j * (kx * there[0] + ky * there[1]))).astype(np.complex64), inside
