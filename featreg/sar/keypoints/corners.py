"""Corners of a map: FAST corners, their orientation, and two ways to a sub-pixel position.

References
----------
E. Rosten, T. Drummond, "Machine learning for high-speed corner detection", ECCV 2006, DOI 10.1007/11744023_34.
E. Rublee et al., "ORB: an efficient alternative to SIFT or SURF", ICCV 2011, DOI 10.1109/ICCV.2011.6126544.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.threads import in_parts
from featreg.sar.pyramid import REACH
from featreg.types import BoolArray, FloatArray, IntArray

CENTROID_ITERATIONS = 8
CORNER_ITERATIONS = 3


def fast_corners(
    image: NDArray[np.uint8], threshold: int, allowed: BoolArray, n_features: int
) -> tuple[IntArray, NDArray[np.uint8]]:
    """Return the FAST-9/16 corners of a map, local maxima of their score.

    Parameters
    ----------
    image : (H, W) uint8
    threshold : least difference between the centre and nine contiguous points of the circle of radius 3, 0 to 254
    allowed : (H, W) bool, where a corner may lie
    n_features : how many to return at most

    Returns
    -------
    xy : (N, 2) int64 pixels, best score first, equal scores in reading order
    score : (N,) uint8, the smallest difference along the best arc
    """
    from featreg.sar.keypoints import corner_kernels

    # Of four pixels at most one is a maximum.
    height, width = image.shape
    at, values = np.empty(height * width // 4 + 1, np.int64), np.empty(height * width // 4 + 1, np.uint8)
    flat, good, counts = np.ascontiguousarray(image), allowed.view(np.uint8), {}

    def part(first: int, stop: int) -> None:
        room = slice(first * width // 4, stop * width // 4 + (stop == height))
        counts[first] = (
            room.start,
            corner_kernels.collect_corners(flat, threshold, good, first, stop, n_features, at[room], values[room]),
        )

    in_parts(part, height, width, 4)
    found = [slice(start, start + count) for _, (start, count) in sorted(counts.items())]
    if len(found) > 1:
        at, values = (np.concatenate([column[some] for some in found]) for column in (at, values))
    else:
        at, values = at[found[0]], values[found[0]]
    most = min(len(at), n_features)
    xy, score = np.empty((most, 2), np.int64), np.empty(most, np.uint8)
    corner_kernels.in_order(at, values, width, xy, score)
    return xy, score


def orientation(
    image: NDArray[np.float32] | NDArray[np.uint8], xy: IntArray, radius: int, stride: int = 3
) -> FloatArray:
    """Return the (N,) angle from each point to the intensity centroid of the disc of `radius` pixels around it.

    Radians, counter-clockwise as seen. One pixel in `stride` of the disc along x and along y is used.
    """
    from featreg.sar.keypoints import corner_kernels

    angle = np.zeros(len(xy))
    xs, ys = np.ascontiguousarray(xy.T)
    corner_kernels.intensity_centroid(image, xs, ys, radius, stride, angle)
    return angle


def orient_level(
    level: NDArray[np.uint8],
    xy: FloatArray,
    shape: tuple[int, int],
    numbers: IntArray,
    number: int,
    radius: int,
    angle: FloatArray,
) -> None:
    """Write `orientation` of the pixels of a level (H, W) on which some points fall to their places in `angle` (N,).

    They are those of `xy` (N, 2), in pixels of an image of that shape (H, W), whose `numbers` (N,) is `number`.
    """
    from featreg.sar.keypoints import corner_kernels

    height, width = shape
    corner_kernels.centroids_of_level(level, xy, width, height, numbers, number, radius, 3, angle)


def refine_centroid(edges: NDArray[np.uint8], xy: IntArray, sigma: float) -> tuple[FloatArray, BoolArray]:
    """Return (N, 2) sub-pixel positions, the iterated 7 x 7 centroid of the edge strength, and (N,) bool where found.

    The weight is a Gaussian of `sigma` pixels. A point that would move farther than 2 pixels stays at its pixel and is
    marked False.
    """
    from featreg.sar.keypoints import corner_kernels

    moved = np.empty((len(xy), 2))
    good = np.empty(len(xy), np.uint8)
    corner_kernels.edge_centroid(edges, xy.astype(np.float64), sigma, CENTROID_ITERATIONS, REACH, moved, good)
    return moved, good.view(np.bool_)


def refine_corner(
    gx: NDArray[np.float32], gy: NDArray[np.float32], xy: IntArray, sigma: float
) -> tuple[FloatArray, BoolArray]:
    """Return (N, 2) sub-pixel positions by Eq. 6 and 7 of Wang et al. 2022, iterated, and (N,) bool: where they hold.

    `gx`, `gy` are (H, W) gradients; the weight is a Gaussian of `sigma` pixels on 7 x 7. A point that would move
    farther than 2 pixels, or whose equations are singular, stays at its pixel and is marked
    False.
    """
    from featreg.sar.keypoints import corner_kernels

    moved = np.empty((len(xy), 2))
    good = np.empty(len(xy), np.uint8)
    corner_kernels.corner_intersection(gx, gy, xy.astype(np.float64), sigma, CORNER_ITERATIONS, REACH, moved, good)
    return moved, good.astype(np.bool_)
