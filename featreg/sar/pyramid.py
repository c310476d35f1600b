"""Scale pyramids of an image: every level an `Image` of its own, made from the one before."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from featreg.types import BoolArray, FloatArray, Image

SMALLEST = 32
# Radius, in pixels of a level, from which a point of that level is described.
SUPPORT = 20.0


def pyramid(image: Image, levels: int = 8, factor: float = 1.2) -> tuple[Image, ...]:
    """Return up to `levels` amplitude images, each `factor` smaller than the one before; the first is the image.

    Levels whose shorter side would fall below 32 pixels are left out. A pixel of a level is valid where all that it
    averages is valid. Linear interpolation between neighbours, because at steps of 1.2 it averages as area weighting
    does, at a tenth of its cost.
    """
    return image.derive(_pyramid, levels=levels, factor=float(factor))


def to_base(xy: FloatArray, level: Image, base: Image) -> FloatArray:
    """Map (N, 2) points of a pyramid level to the base image: ``(x + 0.5) * s - 0.5`` on each axis."""
    scale = np.array([base.shape[1] / level.shape[1], base.shape[0] / level.shape[0]])
    return (xy + 0.5) * scale - 0.5


def share_out(total: int, supply: Sequence[int], decay: float) -> list[int]:
    """Share `total` keypoints over levels that have `supply` of them, each level wanting `decay` times less.

    What a level cannot fill goes to the next finer one, and what the finest cannot to the coarser ones.
    """
    want = np.array([decay**-level for level in range(len(supply))])
    counts = np.minimum(np.rint(want / want.sum() * total).astype(int), supply)
    for level in [*range(len(supply) - 1, -1, -1), *range(len(supply))]:
        counts[level] += max(0, min(supply[level] - counts[level], total - int(counts.sum())))
    return [int(count) for count in counts]


def clearance(image: Image) -> NDArray[np.float32]:
    """Return the (H, W) float32 distance in pixels of every pixel to the nearest invalid pixel or to the outside."""
    return image.derive(_clearance)


def _pyramid(image: Image, levels: int, factor: float) -> tuple[Image, ...]:
    import cv2

    height, width = image.shape
    chain = [Image(image.amplitude, image.mask, source_dtype=image.source_dtype) if image.is_complex else image]
    for level in range(1, levels):
        size = (round(width / factor**level), round(height / factor**level))
        if min(size) < SMALLEST:
            break
        before = chain[-1]
        pixels = cv2.resize(before.amplitude, size, interpolation=cv2.INTER_LINEAR)
        mask: BoolArray
        if before.all_valid:
            mask = np.ones(pixels.shape, np.bool_)
        else:
            share = cv2.resize(before.mask.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
            mask = share > 0.999
            pixels[~mask] = 0
        chain.append(Image(np.asarray(pixels, np.float32), mask, source_dtype=image.source_dtype))
    return tuple(chain)


def _clearance(image: Image) -> NDArray[np.float32]:
    import cv2

    height, width = image.shape
    if image.all_valid:
        x, y = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)
        return np.minimum(np.minimum(x, x[::-1])[None, :], np.minimum(y, y[::-1])[:, None]) + np.float32(1)
    inside = np.pad(image.mask.astype(np.uint8), 1)
    distance: NDArray[np.float32] = cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_5)
    return np.ascontiguousarray(distance[1:-1, 1:-1])
