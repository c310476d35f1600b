"""DAISY: how gradients are directed around a keypoint, gathered by Gaussians whose middles lie on rings.

References
----------
E. Tola, V. Lepetit, P. Fua, "DAISY: an efficient dense descriptor applied to wide-baseline stereo", IEEE TPAMI 32
(2010) 815, DOI 10.1109/TPAMI.2009.77.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.sar.gradients.gradient_field import GradientField, from_base
from featreg.sar.keypoints.gradient_histograms import CELL_CLIP, along_rows, harmonic_weights
from featreg.types import Features, FloatArray, Image, IntArray

F32 = NDArray[np.float32]

#: Cells of the inner and the outer ring around the one in the middle, how far out they lie, and the standard deviation
#: of the Gaussians, relative to the radius. The cells of the inner ring lie between two of the outer one.
RING_CELLS, RING_RADII, SIGMA = (4, 8), (0.43, 0.83), 0.2
CELLS = 1 + sum(RING_CELLS)
#: Numbers of a cell: the gradients' length, and the cosine and sine of their directions and of twice these.
PARTS = 5
LENGTH = PARTS * CELLS
# One Gaussian serves the radii that are nearest to one of these: MIDDLE times powers of WIDTHS, px of the image.
MIDDLE, WIDTHS = 12.0, 2 ** (2 / 3)
# Maps are made of the largest blocks of which the Gaussian's standard deviation is at least so many; it reaches to so
# many standard deviations.
FINEST, REACH = 0.85, 2.5
# Blocks of the whole map for each point from which on windows around the points are made instead, so many at a time.
SPARSE, WINDOWS = 600, 64
# Larger radii are taken as so many times the longer side of the image, all of which lies in the middle cell then.
LARGEST_RADIUS = 20.0


@dataclass(frozen=True)
class Gradients:
    """Gradient fields of one size: `function(image, *parameters)` gives a tuple of them, in every `grid`-th pixel.

    The function stands in a module, and computes the fields of an image once.
    """

    function: Callable[..., tuple[GradientField, ...]]
    parameters: tuple[Any, ...]
    grid: int = 1


@dataclass(frozen=True, eq=False)
class Pool:
    """`maps` (5, R, C): Gaussian means of what lies in blocks of `block` pixels, the field's first at (margin, margin).

    They are, but for a factor, of the gradients' length, and of that times cosine and sine of their direction,
    counter-clockwise as seen, and of twice their direction.
    """

    maps: F32
    block: int
    margin: int


def daisy(image: Image, level: Image, gradients: Gradients, points: Features, radius: FloatArray) -> F32:
    """Return unit descriptors of keypoints.

    Parameters
    ----------
    image : to which the points belong
    level : the image, or a level of its pyramid, on which the gradients are computed
    gradients : which they are; where there are several, the sum of their lengths and harmonics is described
    points : N keypoints; cells and directions are relative to their angles
    radius : (N,) of the descriptors in pixels of the image; at most 20 times its longer side is taken

    Returns
    -------
    (N, 65) float32, 0 where there is no gradient

    Notes
    -----
    Of the directions in a cell the length and two harmonics are kept, as in `gradient_histograms.gloh`, of which this
    is the quicker relative: 13 round cells for GLOH's 17 sectors, and every pixel counts instead of samples. Five maps
    of the image are smoothed once for all keypoints of about one radius and read at 13 places for each; where points
    are few, the same is done in windows around them, which differs by rounding. What lies outside the image counts as
    no gradient. No cell of a unit descriptor is longer than 0.3 before it is brought to unit length again.
    """
    out = np.empty((len(points), LENGTH), np.float32)
    radius = np.minimum(radius, LARGEST_RADIUS * max(image.shape))
    # Pixels of the fields for one of the image.
    smaller = level.shape[1] / image.shape[1] / gradients.grid
    xy, angle = from_base(points.xy, level, image) / gradients.grid, np.ascontiguousarray(points.angle, np.float64)
    order = along_rows(xy, level.shape[1])
    width = np.rint(np.log(np.maximum(radius, 1e-3) / MIDDLE) / math.log(WIDTHS))[order]
    for one in np.unique(width):
        rows = order[width == one]
        sigma = SIGMA * MIDDLE * WIDTHS ** float(one) * smaller
        _describe(level, gradients, sigma, xy[rows], radius[rows] * smaller, angle[rows], rows, out)
    return out


def _describe(
    level: Image, gradients: Gradients, sigma: float, xy: FloatArray, radius: FloatArray, angle: FloatArray,
    rows: IntArray, out: F32,
) -> None:  # fmt: skip
    """Write the descriptors of points (M, 2), in pixels of the fields, to rows (M,) of an array."""
    block, _ = _blocks(sigma)
    if level.shape[0] * level.shape[1] <= (block * gradients.grid) ** 2 * SPARSE * len(rows):
        pool = level.derive(_pooled, gradients=gradients, sigma=sigma)
        _sample(pool.maps, (xy + 0.5) / pool.block - 0.5 + pool.margin, radius / pool.block, angle, rows, out)
        return
    for start in range(0, len(rows), WINDOWS):
        part = slice(start, start + WINDOWS)
        maps, at = _windows(
            gradients.function(level, *gradients.parameters), sigma, xy[part], float(radius[part].max())
        )
        _sample(maps, at, radius[part] / block, angle[part], rows[part], out)


def _sample(maps: F32, xy: FloatArray, radius: FloatArray, angle: FloatArray, rows: IntArray, out: F32) -> None:
    from featreg.sar.keypoints import daisy_kernels

    daisy_kernels.sampled(
        maps.reshape(-1), maps.shape[1], maps.shape[2], rows, xy, radius, angle, _cells(), harmonic_weights(2),
        np.float32(CELL_CLIP), out,
    )  # fmt: skip


def _pooled(level: Image, gradients: Gradients, sigma: float) -> Pool:
    fields = gradients.function(level, *gradients.parameters)
    block, reach = _blocks(sigma)
    margin = reach + 1
    rows, columns = (-(-side // block) + 2 * margin for side in fields[0].x.shape)
    corner = np.full((1, 2), -margin, np.int64)
    return Pool(_smoothed(fields, sigma, corner, rows, columns), block, margin)


def _windows(fields: tuple[GradientField, ...], sigma: float, xy: FloatArray, radius: float) -> tuple[F32, FloatArray]:
    """Maps of windows around points (M, 2), one below the other, and where the points lie in them."""
    block, reach = _blocks(sigma)
    at = (xy + 0.5) / block - 0.5
    beyond = math.ceil(max(RING_RADII) * radius / block) + reach + 1
    side = 2 * beyond + 1
    corners = np.floor(np.clip(at, -4.0 * beyond, 1e6)).astype(np.int64) - beyond
    maps = _smoothed(fields, sigma, corners, len(xy) * side, side)
    return maps, at - corners + np.column_stack([np.zeros(len(xy)), side * np.arange(len(xy))])


def _smoothed(fields: tuple[GradientField, ...], sigma: float, corners: IntArray, rows: int, columns: int) -> F32:
    """Smoothed maps (5, rows, columns) of windows that begin at blocks (M, 2), one below the other."""
    import cv2

    from featreg.sar.keypoints import daisy_kernels

    block, reach = _blocks(sigma)
    sums = np.zeros((PARTS, rows, columns), np.float32)
    for field in fields:
        daisy_kernels.add_binned(field.x, field.y, block, corners, np.float32(1), sums)
    taps = cv2.getGaussianKernel(2 * reach + 1, _beside_blocks(sigma, block)).astype(np.float32)
    tall = sums.reshape(PARTS * rows, columns)
    maps = cv2.sepFilter2D(tall, cv2.CV_32F, taps, taps, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(maps, np.float32).reshape(sums.shape)


def _blocks(sigma: float) -> tuple[int, int]:
    """Side of the blocks for a Gaussian, and how many of them it reaches."""
    block = 1
    while _beside_blocks(sigma, 2 * block) >= FINEST:
        block *= 2
    return block, max(1, math.ceil(REACH * _beside_blocks(sigma, block)))


def _beside_blocks(sigma: float, block: int) -> float:
    """The standard deviation, in blocks, of the Gaussian that smooths by `sigma` pixels together with the blocks."""
    return math.sqrt(max(sigma**2 - (block**2 - 1) / 12, 0.01)) / block


@lru_cache(maxsize=1)
def _cells() -> F32:
    """(2, 13) middles of the cells in units of the radius, y up, of a point whose direction is along x."""
    middles = [np.zeros((2, 1))]
    for ring, (count, radius) in enumerate(zip(RING_CELLS, RING_RADII, strict=True)):
        turns = (np.arange(count) + 0.5 * ring) * 2 * np.pi / count
        middles.append(radius * np.array([np.cos(turns), np.sin(turns)]))
    return np.ascontiguousarray(np.column_stack(middles), np.float32)
