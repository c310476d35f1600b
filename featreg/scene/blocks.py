"""The blocks of a scene: nearly equal rectangles of the reference, each the owner of the points on its pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from featreg.errors import ParameterError
from featreg.interfaces import Matcher
from featreg.io.window import Window
from featreg.pipeline.feature_matcher import FeatureMatcher
from featreg.pipeline.locate import Locate
from featreg.pipeline.pipeline import Pipeline
from featreg.pipeline.refine import Refine

#: Side of a block in pixels, as in the SAR-ORB paper (section 2.2); of large scenes blocks are larger.
BLOCK = 600
#: How the secondary is divided: where the prior puts each block, or into equal parts as in section 2.2 of that paper.
SPLITS = ("prior", "proportional")
#: Fewest blocks along each axis of a square scene that blocks larger than `BLOCK` must leave, so that gates have enough
#: to judge by and workers enough to do, and the side of the largest. A block of `sar-orb` costs 29 ns for each pixel
#: that is read, halo included, and 28 ms whatever its size: 103 ns for each of its own pixels at 600 px, 65 at 1000, 55
#: at 1200. Beyond 1000 px the matches, so many a block, become too thin on pairs that have changed.
ALONG, LARGEST = 5, 1000
#: Memory that finding keypoints in the window of a block larger than `BLOCK` may take, bytes: each worker has its own.
MEMORY = 1 << 30
#: Smallest side: below it the halo is most of what is read.
SMALLEST = 128
#: The halo is a multiple of this, so that the levels of a pyramid begin alike.
WHOLE = 8


@dataclass(frozen=True)
class Block:
    """One block: its number in reading order, its row and column among the blocks, and the pixels that it owns."""

    index: int
    row: int
    col: int
    window: Window


def halo_of(matcher: Matcher, *measures: Locate | Refine | None) -> int:
    """Pixels read beyond a block on each side, so that points at its rim are described and measured whole."""
    reach = max(float(matcher.reach), 0.0, *(float(one.reach) for one in measures if one is not None))
    if not math.isfinite(reach) or reach < 0:
        raise ParameterError(f"{type(matcher).__name__}.reach must be a number of pixels >= 0, got {matcher.reach!r}")
    return WHOLE * math.ceil(reach / WHOLE)


def suitable_side(area: Window, pipeline: Pipeline, split: str = SPLITS[0]) -> int:
    """The side of the blocks of an area, px, that takes least time a pixel while gates and workers have blocks enough.

    Where nothing is refined, the matches of the blocks are the tie points, so many a block, and the block is the small
    one; so it is where the scenes are divided as the paper does it, and for matchers that compare no features, of whose
    work nothing is known: one may reduce larger windows, or take memory by the square of their pixels. No block is so
    large that finding its keypoints takes more than `MEMORY`, unless the small one does.
    """
    matcher = pipeline.matcher
    if pipeline.refine is None or split == "proportional" or not isinstance(matcher, FeatureMatcher):
        return BLOCK
    rim = 2 * halo_of(matcher, pipeline.locate, pipeline.refine)

    def takes(side: int) -> float:
        # Along a short side of the area blocks may be a third larger than they are asked to be.
        tall, wide = (max(b - a for a, b in pairwise(_edges(0, n, side))) + rim for n in area.shape)
        return matcher.detector.window_bytes((tall, wide))

    most = max(MEMORY, takes(BLOCK))
    # What networks look at part by part takes less at some larger sides.
    sides = range(round(min(max(BLOCK, math.sqrt(area.size) / ALONG), LARGEST)), BLOCK, -1)
    return next((side for side in sides if takes(side) <= most), BLOCK)


def plan_blocks(area: Window, size: int = BLOCK) -> tuple[Block, ...]:
    """Divide a rectangle into blocks of about `size` x `size` pixels, in reading order.

    The sides differ by at most one pixel, because a sliver left over at the border would cost as much as a block and
    hold too few points to judge them by; so they lie between 2/3 and 4/3 of `size` once the area is that large.
    """
    if isinstance(size, bool) or size < SMALLEST:
        raise ParameterError(f"block must be a whole number of pixels >= {SMALLEST}, got {size}")
    xs, ys = _edges(area.x, area.width, size), _edges(area.y, area.height, size)
    blocks: list[Block] = []
    for row, (top, bottom) in enumerate(pairwise(ys)):
        for col, (left, right) in enumerate(pairwise(xs)):
            blocks.append(Block(len(blocks), row, col, Window(left, top, right - left, bottom - top)))
    return tuple(blocks)


def proportional_part(part: Window, area: Window, other: Window) -> Window:
    """The part of a rectangle that corresponds to a part of another one, edges rounded to whole pixels.

    Parts that share an edge share it there too, so that blocks tile the other rectangle.
    """
    across, down = other.width / area.width, other.height / area.height
    left, right = (other.x + round((x - area.x) * across) for x in (part.x, part.x + part.width))
    top, bottom = (other.y + round((y - area.y) * down) for y in (part.y, part.y + part.height))
    return Window(left, top, right - left, bottom - top)


def middle_of(block: Block, size: int = BLOCK) -> Block:
    """The block with at most `size` x `size` pixels about its middle."""
    window = block.window
    height, width = (min(size, n) for n in window.shape)
    x, y = window.x + (window.width - width) // 2, window.y + (window.height - height) // 2
    return replace(block, window=Window(x, y, width, height))


def spread_out(blocks: tuple[Block, ...], count: int) -> tuple[Block, ...]:
    """About `count` blocks that lie evenly over all of them, in reading order."""
    rows, cols = blocks[-1].row + 1, blocks[-1].col + 1
    high = min(rows, max(1, round((count * rows / cols) ** 0.5)))
    wide = min(cols, max(1, round(count / high)))
    chosen = {(int((i + 0.5) * rows / high), int((j + 0.5) * cols / wide)) for i in range(high) for j in range(wide)}
    return tuple(block for block in blocks if (block.row, block.col) in chosen)


def _edges(start: int, length: int, size: int) -> list[int]:
    count = max(1, round(length / size))
    edges: list[int] = np.rint(np.linspace(start, start + length, count + 1)).astype(int).tolist()
    return edges
