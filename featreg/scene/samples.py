"""What a scene looks like, told from small squares of it in place of all its pixels."""

from __future__ import annotations

import numpy as np

from featreg.io.source import Source
from featreg.io.window import Window
from featreg.types import Image, read_only

#: Squares along each axis and the side of one, px; a square counts of which at least this share is data.
SQUARES, SIDE, LEAST_VALID = 5, 200, 0.5


def sampled(source: Source) -> Image:
    """Return squares of a scene, spread evenly over it at its full resolution, one below the other.

    What is told of whole images by their speckle is told of a scene by these: an overview would average the speckle
    away, and takes all pixels. Squares without data are left out; where that is all of them, the image is one invalid
    square.
    """
    height, width = (min(SIDE, n) for n in source.shape)
    rows, columns = (
        np.unique(np.linspace(0, n - side, 2 * SQUARES + 1)[1::2].astype(int)).tolist()
        for n, side in zip(source.shape, (height, width), strict=True)
    )
    seen = [source.read(Window(x, y, width, height)) for y in rows for x in columns]
    told = [image for image in seen if image.mask.mean() >= LEAST_VALID] or seen[:1]
    pixels, mask = (np.concatenate([getattr(image, name) for image in told]) for name in ("pixels", "mask"))
    return Image(read_only(pixels), read_only(mask), None, source.name, source.dtype, source.known_scale)
