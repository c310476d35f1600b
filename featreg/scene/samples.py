"""What a scene looks like, told from small squares of it in place of all its pixels."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from featreg.io.source import Source
from featreg.io.window import Window
from featreg.types import Image, read_only

#: Squares along each axis and the side of one, px; a square counts of which at least this share is data.
SQUARES, SIDE, LEAST_VALID = 5, 200, 0.5
#: So many times as many along each axis, where fewer squares count than this: data may be a narrow strip.
FINER, FEWEST = (1, 2, 4), 5


def sampled(source: Source) -> Image:
    """Return squares of a scene, spread evenly over it at its full resolution, one below the other.

    What is told of whole images by their speckle is told of a scene by these: an overview would average the speckle
    away, and takes all pixels. Squares without data are left out; where hardly any is left, squares that lie closer
    together are looked at, and where no square is half data those with most of it are taken. Where there is none at
    all, the image is one invalid square.
    """
    told: list[Image] = []
    some: list[Image] = []
    for finer in FINER:
        whole = True
        for image in _squares(source, finer * SQUARES):
            if image.valid_count >= LEAST_VALID * image.mask.size:
                told.append(image)
                continue
            some, whole = sorted([*some, image], key=lambda one: -one.valid_count)[:FEWEST], False
        if whole or len(told) >= FEWEST:
            break
    told = told[:: math.ceil(len(told) / SQUARES**2)] if told else [one for one in some if one.valid_count] or some[:1]
    pixels, mask = (np.concatenate([getattr(image, name) for image in told]) for name in ("pixels", "mask"))
    return Image(read_only(pixels), read_only(mask), None, source.name, source.dtype, source.known_scale)


def _squares(source: Source, along: int) -> Iterator[Image]:
    """At most so many squares along each axis of a scene, and no more than lie side by side there or `SQUARES`."""
    height, width = (min(SIDE, n) for n in source.shape)
    rows, columns = (
        np.unique(np.linspace(0, n - side, 2 * min(along, max(SQUARES, n // side)) + 1)[1::2].astype(int)).tolist()
        for n, side in zip(source.shape, (height, width), strict=True)
    )
    for y in rows:
        for x in columns:
            yield source.read(Window(x, y, width, height))
