"""GMS: grid-based motion statistics, a filter that keeps matches whose neighbours move alike."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import Annotated, Any, ClassVar

import numpy as np
from annotated_types import Gt, Interval

from featreg.interfaces import Filter, FilterContext
from featreg.registry import register
from featreg.types import BoolArray, FloatArray, IntArray, Matches

# The 3 x 3 ring in reading order, walked around once: turning by 45 degrees moves every cell one step.
RING = np.array([(-1, -1), (0, -1), (1, -1), (1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0)])
# Fewer cells along a side have no neighbours to agree with.
LEAST_CELLS = 4.0
SCALES = (1.0, 0.5, 2**-0.5, 2**0.5, 2.0)


@register("gms")
@dataclass(frozen=True)
class Gms(Filter):
    """Keep the matches of cells whose most frequent motion is also that of the cells around.

    Parameters
    ----------
    grid : cells along each side of an image; where the two differ in size, of the larger one
    threshold_factor : a cell's support must reach this many times the root of the mean number of matches a cell
    rotation : try the eight turns of the neighbourhood by 45 degrees, not only the upright one
    scale : try five ratios of the cell sizes (1/2 to 2), not only equal ones

    Notes
    -----
    J. Bian et al., "GMS: Grid-based Motion Statistics for Fast, Ultra-robust Feature Correspondence", CVPR 2017,
    DOI 10.1109/CVPR.2017.302. Of images of one size it gives the same matches as `cv2.xfeatures2d.matchGMS` (held by a
    test), whose cells are shares of each image. Of two sizes the cells are equally large on the ground: a chip has as
    many of them as the part of the scene that it shows, though at least four along a side. Sizes are (H, W) of the
    context, in pixels whose ratio it states; points outside their image are dropped, not folded onto another cell.
    """

    local: ClassVar[bool] = True
    # A block holds fewer tie points than a whole image does.
    block_parameters: ClassVar[Mapping[str, Any]] = MappingProxyType({"grid": 10})

    grid: Annotated[int, Interval(ge=3, le=60)] = 20
    threshold_factor: Annotated[float, Gt(0)] = 6.0
    rotation: bool = True
    scale: bool = False

    def keep(self, matches: Matches, context: FilterContext) -> BoolArray:
        best = np.zeros(len(matches), np.bool_)
        if not len(matches):
            return best
        reference = _unit(matches.reference_xy, context.reference_shape)
        secondary = _unit(matches.secondary_xy, context.secondary_shape)
        sides = _sides(context)
        if sides[0].prod() < sides[1].prod():
            # The features of a small image crowd in few cells; in those of the larger one they stand out.
            reference, secondary, sides = secondary, reference, sides[::-1]
        here = _along(sides[0], sides, self.grid)
        lefts = [_cells(reference, here, dx, dy) for dy in (0.0, 0.5) for dx in (0.0, 0.5)]
        for scale in SCALES if self.scale else SCALES[:1]:
            there = _along(sides[1], sides, int(self.grid * scale))
            kept = self._best_turn(lefts, _cells(secondary, there, 0.0, 0.0), _whole(here), _whole(there))
            if kept.sum() > best.sum():
                best = kept
        return best

    def _best_turn(
        self, lefts: list[IntArray], right: IntArray, left_grid: tuple[int, int], right_grid: tuple[int, int]
    ) -> BoolArray:
        """The matches kept by the turn that keeps most, each turn joined over the four shifts of the grid."""
        from featreg.sar.keypoints import motion_kernels

        turns = _turned()[: 8 if self.rotation else 1]
        kept = np.empty((len(turns), len(right)), np.bool_)
        motion_kernels.matches_of_turns(
            np.array(lefts), right, *left_grid, *right_grid, turns, float(self.threshold_factor), kept
        )
        return np.asarray(kept[np.count_nonzero(kept, axis=1).argmax()])


def _sides(context: FilterContext) -> FloatArray:
    """(2, 2) width and height of the reference, and of the secondary in pixels of the reference."""
    sides = np.array([context.reference_shape[::-1], context.secondary_shape[::-1]], np.float64)
    sides[1] *= context.pixel_ratio
    return sides


def _along(side: FloatArray, sides: FloatArray, grid: int) -> FloatArray:
    """(2,) cells, of one size in both images, along the width and the height of one of them."""
    largest, smallest = sides.max(axis=0), sides.min(axis=0)
    finer = np.maximum(1.0, LEAST_CELLS / (grid * (smallest / largest)))
    return np.asarray(grid * (side / largest) * finer)


def _whole(along: FloatArray) -> tuple[int, int]:
    """Columns and rows of cells, the last of which may be cut."""
    wide, high = np.ceil(along).astype(int).tolist()
    return wide, high


def _unit(xy: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Points as shares of the image's width and height, NaN outside it."""
    size = np.array(shape[::-1], np.float64)
    inside = np.asarray(((xy >= -0.5) & (xy < size - 0.5)).all(axis=1))
    return np.where(inside[:, None], np.maximum(xy, 0) / size, np.nan)


def _cells(unit: FloatArray, along: FloatArray, dx: float, dy: float) -> IntArray:
    """Cell number of each point on a grid moved by (dx, dy) of a cell; -1 outside."""
    from featreg.sar.keypoints import motion_kernels

    out = np.empty(len(unit), np.int64)
    wide, high = _whole(along)
    motion_kernels.cells(unit, float(along[0]), float(along[1]), dx, dy, wide, high, out)
    return out


@cache
def _turned() -> IntArray:
    """(8, 9, 2) the neighbours (dx, dy), in reading order, after the ring was walked on by 0, 1, ... steps."""
    rings = np.zeros((8, 9, 2), np.int64)
    for turn in range(8):
        for step, (dx, dy) in enumerate(RING):
            rings[turn, (dy + 1) * 3 + dx + 1] = RING[(step + turn) % 8]
    return rings
