"""Scale pyramids of an image: every level an `Image` of its own, made from the one before."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.threads import in_parts
from featreg.types import BoolArray, FloatArray, Image, everywhere, read_only

SMALLEST = 32
# Radius, in pixels of a level, from which a point of that level is described.
SUPPORT = 20.0
# How far, in pixels of a level, the sub-pixel position of a point may lie from its pixel.
REACH = 2.0
# A reduced pixel counts where at least this share of it, of 255, is data.
WHOLE = 254
# By what the valid part of an image is measured, px: the distance of the pixels of its mask that are looked at, and
# half of the side of the squares that must fit into it.
MESH, PROBE = 4, 24
# The mask of an image without invalid pixels, as kernels take it.
ALL = np.empty((0, 0), np.uint8)


def pyramid(image: Image, levels: int = 8, factor: float = 1.2) -> tuple[Image, ...]:
    """Return up to `levels` amplitude images, each `factor` smaller than the one before; the first is the image.

    Levels whose shorter side would fall below 32 pixels are left out. A pixel of a level is valid where all that it
    averages is valid. Linear interpolation between neighbours, because at steps of 1.2 it averages as area weighting
    does, at a tenth of its cost.
    """
    base = image.derive(_amplitude_image) if image.is_complex else image
    # The image itself stays out of its store of derived maps: a cycle would keep all of them alive until collected.
    count = level_count(image.shape, levels, factor)
    return (base, *(base.derive(_level, number=number, factor=float(factor)) for number in range(1, count)))


@lru_cache(maxsize=256)
def level_count(shape: tuple[int, int], most: int, factor: float) -> int:
    """Return how many levels, at most so many, the pyramid of an image of that shape (H, W) has; at least 1."""
    count = 1
    while count < most and min(_level_size(shape, count, factor)) >= SMALLEST:
        count += 1
    return count


def to_base(xy: FloatArray, level: Image, base: Image) -> FloatArray:
    """Map (N, 2) points of a pyramid level to the base image: ``(x + 0.5) * s - 0.5`` on each axis."""
    scale = np.array([base.shape[1] / level.shape[1], base.shape[0] / level.shape[0]])
    return np.asarray((xy + 0.5) * scale - 0.5)


def reduced(image: Image, factor: float) -> Image:
    """Return the amplitude image `factor` times as large, at most 1, by area weighting; kept with the image.

    A pixel is valid where all that it averages is valid.
    """
    height, width = (max(1, round(n * factor)) for n in image.shape)
    if (height, width) == image.shape:
        return image
    return image.derive(_reduced_to, height=height, width=width)


def share_out(total: int, supply: Sequence[int], decay: float) -> list[int]:
    """Share `total` keypoints over levels that have `supply` of them, each level wanting `decay` times less.

    What a level cannot fill goes to the next finer one, and what the finest cannot to the coarser ones.
    """
    want = [decay**-level for level in range(len(supply))]
    counts = [min(int(share / sum(want) * total), there) for share, there in zip(want, supply, strict=True)]
    for level in [*range(len(supply) - 1, -1, -1), *range(len(supply))]:
        counts[level] += max(0, min(supply[level] - counts[level], total - sum(counts)))
    return counts


def clear(image: Image, radius: float) -> BoolArray:
    """Return the (H, W) bool map of pixels around which a square of `radius` pixels is valid and inside the image."""
    return image.derive(_clear, reach=math.ceil(radius))


def valid_width(image: Image) -> float:
    """How wide, in pixels, what is valid of an image is: its shorter side, or less where it is a strip in a frame.

    Of a straight strip of width w, squares of half side r fit around a share 1 - 2 r / w of its pixels; squares, for
    they are what must be valid around a keypoint, so that a diagonal strip is as wide as the largest of them in it.
    """
    shorter = min(image.shape)
    return shorter if image.all_valid else min(shorter, image.derive(_strip_width))


def _strip_width(image: Image) -> float:
    mask = np.ascontiguousarray(image.mask[::MESH, ::MESH])
    there = np.count_nonzero(mask)
    inner = np.count_nonzero(whole_squares(mask, PROBE // MESH, outside=True))
    return math.inf if inner == there else 2 * PROBE * there / (there - inner)


def _amplitude_image(image: Image) -> Image:
    return Image(image.amplitude, image.mask, source_dtype=image.source_dtype)


def _level_size(shape: tuple[int, int], number: int, factor: float) -> tuple[int, int]:
    """(width, height) of a level."""
    return round(shape[1] / factor**number), round(shape[0] / factor**number)


def _level(image: Image, number: int, factor: float) -> Image:
    from featreg.sar import pyramid_kernels

    before = image if number == 1 else image.derive(_level, number=number - 1, factor=factor)
    width, height = _level_size(image.shape, number, factor)
    pixels, whole = np.empty((height, width), np.float32), before.all_valid
    mask: BoolArray = everywhere((height, width)) if whole else np.empty((height, width), np.bool_)
    valid = ALL if whole else np.ascontiguousarray(before.mask).view(np.uint8)
    across, down = _neighbours(before.shape[1], width), _neighbours(before.shape[0], height)
    amplitude = np.ascontiguousarray(before.amplitude)

    def part(first: int, stop: int) -> None:
        some = slice(first, stop)
        to = ALL if whole else mask[some].view(np.uint8)
        pyramid_kernels.interpolated(amplitude, valid, *across, down[0][some], down[1][some], pixels[some], to)

    in_parts(part, height, width)
    return Image(read_only(pixels), read_only(mask), source_dtype=image.source_dtype)


@lru_cache(maxsize=64)
def _neighbours(count: int, fewer: int) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """The first of the two of `count` >= 2 places between which each of `fewer` lies, and the share of the second."""
    at = (np.arange(fewer) + 0.5) * (count / fewer) - 0.5
    first = np.clip(np.floor(at), 0, count - 2).astype(np.int32)
    share = np.clip(at - first, 0, 1).astype(np.float32)
    return read_only(first), read_only(share)


def _reduced_to(image: Image, height: int, width: int) -> Image:
    import cv2

    size, whole = (width, height), image.shape[0] // height
    if image.shape == (whole * height, whole * width):
        pixels, amplitude = np.empty((height, width), np.float32), image.amplitude

        def part(first: int, stop: int) -> None:
            rows = amplitude[whole * first : whole * stop]
            cv2.resize(rows, (width, stop - first), pixels[first:stop], interpolation=cv2.INTER_AREA)

        in_parts(part, height, image.shape[1])
    else:
        pixels = np.asarray(cv2.resize(image.amplitude, size, interpolation=cv2.INTER_AREA), np.float32)
    mask = everywhere((pixels.shape[0], pixels.shape[1]))
    if not image.all_valid:
        share = cv2.resize(image.mask.view(np.uint8) * np.uint8(255), size, interpolation=cv2.INTER_AREA)
        mask = np.asarray(share >= WHOLE)
        pixels = np.where(mask, pixels, np.float32(0))
    return Image(read_only(pixels), read_only(mask), source_dtype=image.source_dtype)


def _clear(image: Image, reach: int) -> BoolArray:
    if image.all_valid:
        inside = np.zeros(image.shape, np.bool_)
        inside[reach : image.shape[0] - reach, reach : image.shape[1] - reach] = True
        return inside
    return whole_squares(image.mask, reach)


def whole_squares(mask: BoolArray, reach: int, *, outside: bool = False) -> BoolArray:
    """Return where all of the square of `reach` pixels around is True in a mask (H, W), `outside` beyond its border."""
    from featreg.sar import mask_kernels

    whole = np.empty(mask.shape, np.uint8)
    mask_kernels.whole_squares(np.ascontiguousarray(mask).view(np.uint8), reach, int(outside), whole)
    return whole.view(np.bool_)
