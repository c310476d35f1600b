"""Displacements of the cells of two images in memory: from what coarse levels say to the sub-pixel peak."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from featreg.displacement.band import F32, Map, aligned, band, chance
from featreg.displacement.cells import CellGrid, Reason
from featreg.displacement.coarse import COARSE_LIMIT, LEAST_SNR, coarse_field
from featreg.displacement.expectation import expectation
from featreg.displacement.neighbours import LEAST, company, filled, outliers, smoothed
from featreg.sar.correlation import quadratic_steps
from featreg.sar.grid_correlation import WindowGrid, grid_correlations, grid_peaks, read_shift
from featreg.sar.speckle import log_amplitude
from featreg.types import BoolArray, FloatArray, Image

#: `LEAST_SNR` of a cell with too few neighbours to be judged by.
LONELY_SNR = 7.0
#: Of the test against the neighbours at the end.
LIMIT = 4.0
#: Passes at full size: the first is around what the coarse levels predict, the last around what the one before found.
#: One is enough where next to no window is strained by more than STRAIN px from side to side; more than two, up to the
#: second number, while less than the share ENOUGH of the windows that correlate have their peak within reach.
STRAIN = 0.4
PASSES, MOST_PASSES, ENOUGH = 2, 4, 0.95
#: Variances of a cell that a motion not linear within its window must exceed to count.
BENT = 2.0


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
    field, clear = coarse_field((a, mask_a), (b, mask_b), grid, search)
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
