"""Images of given pixels."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.types import Image

#: The fixture `sar_texture`.
Texture = Callable[..., NDArray[np.float32]]


def image_of(pixels: Any, mask: NDArray[np.bool_] | None = None, dtype: str = "float32") -> Image:
    """The image of (H, W) pixels, valid everywhere or where `mask` is True; its samples were said to be `dtype`."""
    pixels = np.asarray(pixels)
    valid = np.ones(pixels.shape, np.bool_) if mask is None else mask
    return Image(np.where(valid, pixels, 0).astype(np.float32), valid, source_dtype=dtype)
