"""The one way to 8 bits: what every algorithm that takes 8-bit images is given."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import ParameterError, suggest
from featreg.types import Image

METHODS = ("auto", "log-stretch", "linear-stretch", "identity")
LOW, HIGH = 0.01, 0.99
SAMPLES = 1 << 15


def to_uint8(image: Image, method: str = "auto", fill: str = "zero") -> NDArray[np.uint8]:
    """Return the amplitude of `image` stretched to 8 bits; call it as ``image.derive(to_uint8)``.

    Parameters
    ----------
    image : the image; complex samples are used by their amplitude
    method : "log-stretch" maps the natural logarithm of the amplitude between the 1st and the 99th percentile of the
        valid positive pixels to 0..255; "linear-stretch" does the same with the amplitude itself; "identity" keeps the
        values of an 8-bit source; "auto" is identity for 8-bit amplitude sources, else log-stretch
    fill : what invalid pixels become: "zero", or "median" (the middle grey of the valid pixels, which leaves hardly any
        edge along the border of the valid area)

    Returns
    -------
    (H, W) uint8; all zero where the valid pixels do not vary

    Raises
    ------
    ParameterError
        An unknown method or fill, or "identity" for a source that was not 8-bit.

    Notes
    -----
    The percentiles are order statistics of a regular subsample of about 32 000 pixels, the same at every call. In the
    logarithm, multiplicative speckle has the same spread everywhere, and a gain between two images drops out.
    """
    if method not in METHODS:
        raise ParameterError(f"unknown normalise method '{method}', {suggest(method, METHODS)}")
    if fill not in ("zero", "median"):
        raise ParameterError(f"fill must be 'zero' or 'median', got '{fill}'")
    eight_bit = image.source_dtype == "uint8" and image.scale == "amplitude"
    if method == "auto":
        method = "identity" if eight_bit else "log-stretch"
    if method == "identity" and not eight_bit:
        raise ParameterError(
            f"normalise method 'identity' needs an 8-bit source, got {image.source_dtype} {image.scale}; "
            "use 'log-stretch' or 'linear-stretch'"
        )
    grey = _identity(image) if method == "identity" else _stretch(image, logarithm=method == "log-stretch")
    if not image.all_valid:
        grey[~image.mask] = 0
        if fill == "median":
            values = _sample(grey, image.mask)
            grey[~image.mask] = values[values.size // 2] if values.size else 0
    return grey


def _identity(image: Image) -> NDArray[np.uint8]:
    import cv2

    return np.asarray(cv2.convertScaleAbs(image.amplitude), dtype=np.uint8)


def _stretch(image: Image, logarithm: bool) -> NDArray[np.uint8]:
    import cv2

    amplitude = image.amplitude
    values = _sample(amplitude, image.mask, above=0.0 if logarithm else -1.0)
    if values.size == 0:
        return np.zeros(image.shape, np.uint8)
    low, high = (float(values[round(q * (values.size - 1))]) for q in (LOW, HIGH))
    if not high > low:
        return np.zeros(image.shape, np.uint8)
    stretched: Any = np.maximum(amplitude, np.float32(low))
    if logarithm:
        stretched = cv2.log(stretched)
        low, high = float(np.log(low)), float(np.log(high))
    gain = 255.0 / (high - low)
    return np.asarray(cv2.convertScaleAbs(stretched, alpha=gain, beta=-gain * low), dtype=np.uint8)


def _sample(values: NDArray[Any], mask: NDArray[np.bool_], above: float = -1.0) -> NDArray[Any]:
    """Return the sorted valid values greater than `above` on a regular grid, or all such where the grid meets none."""
    step = max(1, round((values.size / SAMPLES) ** 0.5))
    for stride in (step, 1):
        seen = values[::stride, ::stride]
        chosen = seen[mask[::stride, ::stride] & (seen > above)]
        if chosen.size:
            break
    return np.sort(chosen)
