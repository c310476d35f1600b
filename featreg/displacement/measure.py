"""Displacements of the cells of two images in memory: from coarse levels to fine ones, then to the sub-pixel peak."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from featreg.displacement.cells import CellGrid, Reason
from featreg.displacement.neighbours import LEAST, company, filled, outliers, smoothed
from featreg.pipeline.aligned import halved
from featreg.sar.correlation import peaks, quadratic_steps
from featreg.sar.grid_correlation import Expected, WindowGrid, grid_correlations, grid_peaks, piece_middles, read_shift
from featreg.sar.speckle import log_amplitude
from featreg.types import BoolArray, FloatArray, Image

F32 = NDArray[np.float32]
Map = Callable[[FloatArray], FloatArray]

#: Standard deviations of the two Gaussians whose difference is the band that is correlated, px of the level. Speckle is
#: white: what is finer than the first holds little else, and what is coarser than the second hardly tells a position.
BAND = (0.7, 2.0)
TAPS = (5, 9)
#: Largest shift searched at the coarsest level, px of that level, and around the prediction at finer ones.
WIDE, NARROW = 5, 2
#: Shortest side of a window at any level, px of that level.
LEAST_WINDOW = 32
#: By how much a peak must stand above 0, and above its rival at the coarsest level, in standard deviations of the
#: correlation of unrelated windows.
LEAST_SNR, RIVAL_SNR = 5.0, 1.5
#: The same for a cell with too few neighbours to be judged by.
LONELY_SNR = 7.0
#: Shifts so near to the peak belong to it, px of the level.
OWN = 2
#: Of the test against the neighbours, at coarse levels and at the end.
COARSE_LIMIT, LIMIT = 3.0, 4.0
#: Passes at full size: the first is around what the coarse levels predict, the last around what the one before found.
#: One is enough where next to no window is strained by more than STRAIN px from side to side; more than two, up to the
#: second number, while less than the share ENOUGH of the windows that correlate have their peak within reach.
STRAIN = 0.4
PASSES, MOST_PASSES, ENOUGH = 2, 4, 0.95
#: Variances of a cell that a motion not linear within its window must exceed to count.
BENT = 2.0
#: RMS distance of a neighbourhood from a plane, px, beyond which it is none.
ROUGH = 0.5


@dataclass(frozen=True, eq=False)
class Measured:
    """What was measured of each cell.

    Parameters
    ----------
    displacement : (rows, cols, 2) float64 px, reference -> secondary; NaN where there is none
    covariance : (rows, cols, 2, 2) float64 px^2
    peak : (rows, cols) float64 correlation coefficient
    snr : (rows, cols) float64, the peak over the standard deviation of the correlation of unrelated windows
    reason : (rows, cols) uint8, of `Reason`
    """

    displacement: FloatArray
    covariance: FloatArray
    peak: FloatArray
    snr: FloatArray
    reason: NDArray[np.uint8]


def measure(
    reference: Image,
    secondary: Image,
    grid: CellGrid,
    search: float,
    base: Map | None = None,
    extent: tuple[float, float, float, float] | None = None,
) -> Measured:
    """Measure the displacement of each cell.

    Parameters
    ----------
    reference, secondary : the images
    grid : the cells of the reference
    search : largest displacement looked for around `base`, px
    base : known map of (N, 2) reference to secondary pixels; None for none
    extent : (left, top, right, bottom) px between which the whole secondary lies, of which `secondary` may be a part;
        None where it is all

    Returns
    -------
    Measured
        Displacements are whole ones, those of `base` included.
    """
    a, mask_a = log_amplitude(reference), None if reference.all_valid else reference.mask
    b, mask_b = aligned(secondary, base, reference.shape)
    field, clear = _coarse((a, mask_a), (b, mask_b), grid, search)
    shape = grid.cells
    rows, cols = (
        np.flatnonzero((starts >= 1) & (starts + grid.window <= n - 1))
        for starts, n in ((grid.tops, reference.shape[0]), (grid.lefts, reference.shape[1]))
    )
    cells = np.ix_(rows, cols)
    if extent is None:
        extent = (0.0, 0.0, secondary.shape[1] - 1.0, secondary.shape[0] - 1.0)
    shift, covariance = np.full((*shape, 2), np.nan), np.full((*shape, 2, 2), np.nan)
    peak, sound = np.full(shape, np.nan), np.zeros(shape, np.bool_)
    found = _at_full_size(
        band(a, mask_a), band(b, mask_b), WindowGrid(grid.tops[rows], grid.lefts[cols], grid.window),
        field[cells],
    )  # fmt: skip
    shift[cells], covariance[cells], peak[cells], sound[cells] = found
    snr = peak * chance(grid.window)
    reason = np.full(shape, Reason.OUTSIDE, np.uint8)
    reason[cells] = Reason.GOOD
    sound &= np.isfinite(shift).all(axis=-1) & np.isfinite(covariance[..., 0, 0])
    where = np.where(sound[..., None], shift, field)
    for bad, why in (
        (~_seen(where, grid, base, extent), Reason.OUTSIDE),
        (_masked(where, grid, mask_a, mask_b), Reason.MASKED),
        (~sound | ~(snr >= LEAST_SNR), Reason.NO_PEAK),
        (~clear, Reason.AMBIGUOUS),
        (~(np.abs(where) <= search + 1).all(axis=-1), Reason.OUTSIDE),
    ):
        reason[bad & (reason == Reason.GOOD)] = why
    # A weak peak that no neighbour bears out may be chance.
    reason[(reason == Reason.GOOD) & (snr < LONELY_SNR) & (company(reason == Reason.GOOD) < LEAST)] = Reason.NO_PEAK
    reason[outliers(where.astype(np.float32), reason == Reason.GOOD, LIMIT)] = Reason.OUTLIER
    if base is not None:
        centres = np.stack(np.meshgrid(grid.x, grid.y), -1)
        turn = _linear(base, centres + where)
        shift = _mapped(base, centres + shift) - centres
        covariance = turn @ covariance @ turn.swapaxes(-1, -2)
    nothing = np.isin(reason, (Reason.MASKED, Reason.NO_PEAK, Reason.OUTSIDE))
    shift[nothing], covariance[nothing] = np.nan, np.nan
    return Measured(shift, covariance, peak, snr, reason)


def _at_full_size(
    first: F32, second: F32, windows: WindowGrid, field: F32
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Shift, its covariance, height of the peak and whether it is sound, of windows that moved by about `field`."""
    shape = windows.shape
    if not (shape[0] and shape[1]):
        return np.zeros((*shape, 2)), np.zeros((*shape, 2, 2)), np.zeros(shape), np.zeros(shape, np.bool_)
    for k in range(MOST_PASSES):
        expected = expectation(field, windows)
        surface = grid_correlations(first, second, windows, 1, expected)
        step, _, curved = quadratic_steps(surface.reshape(-1, 3, 3))
        residual, sound = step.reshape(*shape, 2), curved.reshape(shape)
        height = surface.max(axis=(2, 3))
        high = height * chance(windows.window) >= LEAST_SNR
        strained = np.abs(expected.slope).max(axis=(2, 3)) * windows.window > STRAIN
        calm = strained.mean() <= 1 - ENOUGH
        if (calm or k + 1 >= PASSES) and (sound & high).sum() >= ENOUGH * high.sum():
            break
        best = surface.reshape(*shape, 9).argmax(axis=-1)
        climbed = np.stack([best % 3 - 1, best // 3 - 1], axis=-1)
        read = read_shift(windows, expected)
        moved = (read + np.where(sound[..., None], residual, climbed)).astype(np.float32)
        field = smoothed(filled(moved, high & ~outliers(moved, high, COARSE_LIMIT)))
    made = grid_peaks(first, second, windows, expected, residual)
    covariance = made.covariance + _bent(made.shift, made.covariance, sound & high, windows)
    return made.shift, covariance, height, sound


def _bent(shift: FloatArray, covariance: FloatArray, good: BoolArray, windows: WindowGrid) -> FloatArray:
    """(rows, cols, 2, 2) px^2 by which windows miss the motion of their middle where this is not linear within them.

    The mean of a quadratic displacement over a window of side w lies w^2 / 24 times the sum of its two second
    derivatives from the displacement of the middle. These are differences of cells half a window apart, which err
    themselves: what counts is by how much the square of that distance exceeds `BENT` variances of the cell.
    """
    rows, cols = windows.shape
    steps = [
        float(np.diff(starts).mean()) if len(starts) > 1 else windows.window for starts in (windows.tops, windows.lefts)
    ]
    down, right = (max(1, round(windows.window / 2 / step)) for step in steps)
    field = filled(np.nan_to_num(shift).astype(np.float32), good & np.isfinite(shift).all(axis=-1)).astype(np.float64)
    wide = np.pad(field, ((down, down), (right, right), (0, 0)), mode="edge")
    inner_rows, inner_cols = slice(down, down + rows), slice(right, right + cols)
    along_y = wide[2 * down :, inner_cols] + wide[:rows, inner_cols] - 2 * field
    along_x = wide[inner_rows, 2 * right :] + wide[inner_rows, :cols] - 2 * field
    missed = windows.window**2 / 24 * (along_y / (down * steps[0]) ** 2 + along_x / (right * steps[1]) ** 2)
    out = np.zeros_like(covariance)
    for k in range(2):
        out[..., k, k] = np.maximum(missed[..., k] ** 2 - BENT * np.nan_to_num(covariance[..., k, k]), 0)
    return out


def expectation(field: F32, windows: WindowGrid) -> Expected:
    """Return what a field (rows, cols, 2) of the windows' middles says of the windows and of their pieces.

    The slope of a cell is that of the plane of least squares through the 5 x 5 cells around, 0 where the cells lie too
    far from any plane, as along a fault.
    """
    import cv2

    side = min(5, *(n - (n + 1) % 2 for n in windows.shape))
    at = np.arange(side) - side // 2
    slope = np.zeros((*windows.shape, 2, 2))
    if side > 1:
        flat, ramp = np.full(side, 1 / side), at / (at**2).sum()

        def fit(along_x: FloatArray, along_y: FloatArray) -> F32:
            return np.asarray(cv2.sepFilter2D(field, -1, along_x, along_y, borderType=cv2.BORDER_REPLICATE), np.float32)

        mean, right, down = fit(flat, flat), fit(ramp, flat), fit(flat, ramp)
        power = cv2.blur(field * field, (side, side), borderType=cv2.BORDER_REPLICATE) - mean**2
        power -= (right**2 + down**2) * np.mean(at**2)
        plane = power.sum(axis=-1, keepdims=True) <= ROUGH**2
        steps = [float(np.diff(starts).mean()) for starts in (windows.lefts, windows.tops)]
        slope = np.where(plane[..., None], np.stack([right, down], -1) / steps, 0.0)
    half = (windows.window - 1) / 2
    map_x, map_y = np.meshgrid(
        *(
            np.interp(middles, starts + half, np.arange(len(starts))).astype(np.float32)
            for middles, starts in zip(piece_middles(windows), (windows.lefts, windows.tops), strict=True)
        )
    )
    pieces = cv2.remap(field, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return Expected(field.astype(np.float64), slope, np.rint(pieces).astype(np.int64))


def aligned(secondary: Image, base: Map | None, shape: tuple[int, int]) -> tuple[F32, BoolArray | None]:
    """Return the log-amplitude of the secondary on the reference grid (H, W) as `base` has it, and its mask, None: all.

    Where there is nothing to resample, nothing is.
    """
    import cv2

    log, mask = log_amplitude(secondary), None if secondary.all_valid else secondary.mask
    if base is None:
        height, width = shape
        down, right = max(height - log.shape[0], 0), max(width - log.shape[1], 0)
        if down or right:
            mask = np.pad(secondary.mask, ((0, down), (0, right)))
            log = np.asarray(cv2.copyMakeBorder(log, 0, down, 0, right, cv2.BORDER_REPLICATE), np.float32)
        return np.ascontiguousarray(log[:height, :width]), None if mask is None else mask[:height, :width]
    x, y = np.meshgrid(*(np.arange(n, dtype=np.float64) for n in shape[::-1]))
    mapped = base(np.column_stack([x.ravel(), y.ravel()])).reshape(*shape, 2).astype(np.float32)
    sampled = cv2.remap(log, mapped[..., 0], mapped[..., 1], cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
    valid = cv2.remap(
        secondary.mask.astype(np.float32), mapped[..., 0], mapped[..., 1], cv2.INTER_LINEAR, borderValue=0.0
    )
    return np.asarray(sampled, np.float32), np.asarray(valid > 0.99)


def band(log: F32, mask: BoolArray | None = None) -> F32:
    """Return the band of a log-amplitude that is correlated, 0 on and near pixels that are not data."""
    import cv2

    fine, broad = (
        cv2.GaussianBlur(log, (side, side), s, borderType=cv2.BORDER_REFLECT_101)
        for s, side in zip(BAND, TAPS, strict=True)
    )
    out = np.asarray(cv2.subtract(fine, broad), np.float32)
    if mask is not None and not mask.all():
        side = 2 * round(2 * BAND[1]) + 1
        out *= np.asarray(cv2.erode(mask.view(np.uint8), np.ones((side, side), np.uint8), borderValue=1), np.float32)
    return out


@lru_cache(maxsize=64)
def chance(window: int) -> float:
    """Return one over the standard deviation of the correlation of two unrelated windows of band-passed speckle.

    M. S. Bartlett, "Some aspects of the time-correlation problem", J. R. Stat. Soc. 98 (1935) 536: its variance is the
    sum of the squared autocorrelation of the band over the number of pixels.
    """
    impulse = np.zeros((65, 65), np.float32)
    impulse[32, 32] = 1
    spectrum = np.abs(np.fft.fft2(band(impulse).astype(np.float64))) ** 2
    autocorrelation = np.fft.ifft2(spectrum).real
    return float(window / math.sqrt(((autocorrelation / autocorrelation[0, 0]) ** 2).sum()))


def _coarse(
    first: tuple[F32, BoolArray | None], second: tuple[F32, BoolArray | None], grid: CellGrid, search: float
) -> tuple[F32, BoolArray]:
    """Displacements (rows, cols, 2) to a fraction of a pixel by the halved levels; and where one peak stood alone."""
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


def _seen(shift: FloatArray, grid: CellGrid, base: Map | None, extent: tuple[float, float, float, float]) -> BoolArray:
    """(rows, cols) whether the corners of the displaced windows lie in the secondary."""
    left, top, right, bottom = extent
    seen = np.ones(grid.cells, np.bool_)
    for down in (0, grid.window - 1):
        for across in (0, grid.window - 1):
            at = np.stack(np.broadcast_arrays(grid.lefts + across, (grid.tops + down)[:, None]), -1) + shift
            x, y = np.moveaxis(at if base is None else _mapped(base, at), -1, 0)
            seen &= (x >= left - 0.5) & (x <= right + 0.5) & (y >= top - 0.5) & (y <= bottom + 0.5)
    return seen


def _masked(shift: FloatArray, grid: CellGrid, *masks: BoolArray | None) -> BoolArray:
    """(rows, cols) whether a window holds pixels that are not data, in the first mask or, displaced, in the second."""
    import cv2

    out = np.zeros(grid.cells, np.bool_)
    for k, mask in enumerate(masks):
        if mask is None:
            continue
        hole = (~mask).astype(np.float32)
        holes = cv2.boxFilter(hole, -1, (grid.window, grid.window), anchor=(0, 0), normalize=False)
        whole = np.rint(k * np.nan_to_num(shift)).astype(np.int64)
        tops = np.clip(grid.tops[:, None] + whole[..., 1], 0, mask.shape[0] - 1)
        lefts = np.clip(grid.lefts + whole[..., 0], 0, mask.shape[1] - 1)
        out |= holes[tops, lefts] > 0.5
    return out


def _mapped(base: Map, xy: FloatArray) -> FloatArray:
    return np.asarray(base(xy.reshape(-1, 2).astype(np.float64)), np.float64).reshape(xy.shape)


def _linear(base: Map, xy: FloatArray) -> FloatArray:
    """(..., 2, 2) linear part of a map around points, by central differences."""
    columns = [_mapped(base, xy + step) - _mapped(base, xy - step) for step in (np.array([0.5, 0]), np.array([0, 0.5]))]
    return np.stack(columns, axis=-1)
