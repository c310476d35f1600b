"""Displacements of cells by the halved levels of two images, from the coarsest on."""

from __future__ import annotations

import math

import numpy as np

from featreg.displacement.band import F32, band, chance
from featreg.displacement.cells import CellGrid
from featreg.displacement.expectation import expectation
from featreg.displacement.neighbours import filled, outliers, smoothed
from featreg.pipeline.aligned import halved
from featreg.sar.correlation import peaks
from featreg.sar.grid_correlation import Expected, WindowGrid, grid_correlations, read_shift
from featreg.types import BoolArray, FloatArray

#: Largest shift searched at the coarsest level, px of that level, and around the prediction at finer ones.
WIDE, NARROW = 5, 2
#: Shortest side of a window at any level, px of that level.
LEAST_WINDOW = 32
#: By how much a peak must stand above 0, and above its rival at the coarsest level, in standard deviations of the
#: correlation of unrelated windows.
LEAST_SNR, RIVAL_SNR = 5.0, 1.5
#: Shifts so near to the peak belong to it, px of the level.
OWN = 2
#: Of the test against the neighbours, before the end.
COARSE_LIMIT = 3.0


def coarse_field(
    first: tuple[F32, BoolArray | None], second: tuple[F32, BoolArray | None], grid: CellGrid, search: float
) -> tuple[F32, BoolArray]:
    """Return displacements (rows, cols, 2) to a fraction of a pixel by halved levels; where one peak stood alone."""
    levels = [(first, second)]
    while len(levels) <= levels_of(search) and min(levels[-1][0][0].shape) >= 4 * LEAST_WINDOW:
        levels.append((_halved(*levels[-1][0]), _halved(*levels[-1][1])))
    top = len(levels) - 1
    # Of the level before the first there is nothing.
    before, field, clear = grid, np.zeros((*grid.cells, 2), np.float32), np.ones(grid.cells, np.float32)
    for level in range(top, min(top, 1) - 1, -1):
        (a, mask_a), (b, mask_b) = levels[level]
        here = _level_grid(grid, 2**level, a.shape)
        field, clear = 2 * _at(field, before, here, 0.5), _at(clear, before, here, 0.5)
        windows = _inner_windows(here)
        reach = NARROW if level < top else min(max(NARROW, math.ceil(search / 2**level) + 1), min(a.shape) // 2)
        expected = expectation(field, windows) if level < top else Expected.still(windows)
        surface = grid_correlations(band(a, mask_a), band(b, mask_b), windows, reach, expected)
        found = peaks(surface.reshape(-1, 2 * reach + 1, 2 * reach + 1))
        unit = chance(windows.window)
        good = (found.sound & (found.height * unit >= LEAST_SNR)).reshape(here.cells)
        if level == top:
            clear = _stands_alone(surface, RIVAL_SNR / unit).astype(np.float32)
        good &= clear > 0.5
        # A peak counts from where the pieces were read, which whole pixels keep from what was expected.
        moved = (read_shift(windows, expected) + found.shift.reshape(*here.cells, 2)).astype(np.float32)
        good &= ~outliers(moved, good, COARSE_LIMIT)
        field = smoothed(filled(moved, good))
        before = here
    factor = 2 ** min(top, 1)
    return factor * _at(field, before, grid, 1 / factor), _at(clear, before, grid, 1 / factor) > 0.5


def _level_grid(grid: CellGrid, factor: int, shape: tuple[int, int]) -> CellGrid:
    """Cells at a level: windows of no fewer pixels than say something, that overlap by three quarters at most."""
    window = min(max(grid.window // factor, LEAST_WINDOW), *shape)
    return CellGrid(shape, max(grid.step // factor, window // 4, 1), window)


def _at(values: F32, old: CellGrid, new: CellGrid, scale: float) -> F32:
    """Values of the cells of one grid at the middles of another, whose pixels are `scale` of the old one's each."""
    import cv2

    x, y = (
        (((middle + 0.5) * scale - 0.5 - first) / old.step).astype(np.float32)
        for middle, first in ((new.x, old.x[0]), (new.y, old.y[0]))
    )
    map_x, map_y = np.meshgrid(x, y)
    return np.asarray(cv2.remap(values, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)


def levels_of(search: float) -> int:
    """How often images are halved, at least once, so that a few shifts reach `search` px."""
    return max(1, math.ceil(math.log2(max(search, 1) / (WIDE - 1))))


def _halved(log: F32, mask: BoolArray | None) -> tuple[F32, BoolArray | None]:
    return halved(log), None if mask is None else halved(mask.astype(np.float32)) > 0.99


def _inner_windows(grid: CellGrid) -> WindowGrid:
    """The windows of the cells, moved inwards at the rim."""
    tops, lefts = (
        np.clip(starts, 0, n - grid.window).astype(np.int64)
        for starts, n in ((grid.tops, grid.shape[0]), (grid.lefts, grid.shape[1]))
    )
    return WindowGrid(tops, lefts, grid.window)


def _stands_alone(surface: FloatArray, margin: float) -> BoolArray:
    """Whether no shift away from the peak comes within `margin` of it."""
    rows, cols, side, _ = surface.shape
    flat = surface.reshape(rows, cols, -1)
    best = flat.argmax(axis=-1)
    dy, dx = np.divmod(best, side)
    at = np.arange(side)
    near = (np.abs(at - dy[..., None]) <= OWN)[..., :, None] & (np.abs(at - dx[..., None]) <= OWN)[..., None, :]
    rival = np.where(near, -1.0, surface).reshape(rows, cols, -1).max(axis=-1)
    return np.asarray(rival < flat.max(axis=-1) - margin)
