"""Regions that several windows share, so that what they look at is computed once and nothing else is."""

from __future__ import annotations

import numpy as np

from featreg.types import IntArray

#: An image of at most so many pixels may be one region.
LARGEST = 4_000_000


def merged_regions(xy: IntArray, side: int, most: int, shape: tuple[int, int]) -> list[IntArray]:
    """Group windows around points so that those of a group lie in one rectangle.

    Parameters
    ----------
    xy : (N, 2) int64 centres (x, y) of the windows
    side : of the windows, px
    most : two windows may be of one group where the rectangle that holds both has at most so many pixels
    shape : (H, W) of the image

    Returns
    -------
    rows of `xy`, each in one group, the groups in the order in which they were found

    Notes
    -----
    Section 2.5 of "A high-precision matching method for heterogeneous SAR images based on ROEWA and angle-weighted
    gradient", Remote Sensing 17 (2025) 749, DOI 10.3390/rs17050749: of the sets that lie near enough to each point the
    largest is a group, and its points are taken out, until none is left. Of equal sets that of the first point counts.
    Departure: where all rectangles together would have more pixels than the image, all windows are one group, unless
    the image is larger than 4 million pixels.
    """
    wide, high = (np.abs(xy[:, None, axis] - xy[None, :, axis]) + side for axis in (0, 1))
    near = wide * high <= max(most, side**2)
    left = np.ones(len(xy), np.bool_)
    counts = near.sum(axis=1)
    groups = []
    while left.any():
        centre = int(np.where(left, counts, -1).argmax())
        rows = np.flatnonzero(near[centre] & left)
        left[rows] = False
        counts = counts - near[:, rows].sum(axis=1)
        groups.append(rows)
    height, width = shape
    if height * width <= LARGEST and sum(_area(xy[rows], side) for rows in groups) >= height * width:
        return [np.arange(len(xy))]
    return groups


def _area(xy: IntArray, side: int) -> int:
    """Pixels of the smallest rectangle that holds windows around (N, 2) points."""
    wide, high = (np.ptp(xy, axis=0) + side).tolist()
    return int(wide * high)
