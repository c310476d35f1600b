"""Correlation of two maps in overlapping windows on a grid: what windows share is summed once.

For one shift, the sums of products over all windows are sums of one product image. It is summed in pieces, between the
edges of all windows, and a window adds up its pieces: a pixel costs one multiplication a shift, however many windows
it lies in. `featreg.sar.correlation.local_correlations` computes the same for points anywhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from featreg.types import FloatArray, IntArray

F32 = NDArray[np.float32]

#: Longest side of a piece, px: long against the correlation of speckle, short against a window.
PIECE = 8
#: Slopes of neighbouring pieces share the speckle at their border, so that the sum of their squares lacks so much along
#: either axis, px over the side of a piece (measured on speckle in the band of `featreg.displacement.band`).
LEAK = 0.6
#: A piece read further than this from what is expected of a window shows another motion, px along either axis.
APART = 1.5


@dataclass(frozen=True, eq=False)
class WindowGrid:
    """Equal square windows on a grid.

    Parameters
    ----------
    tops, lefts : (rows,), (cols,) int64 first row of the windows and first column, ascending
    window : side, px
    """

    tops: IntArray
    lefts: IntArray
    window: int

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return len(self.tops), len(self.lefts)

    @cached_property
    def row_pieces(self) -> tuple[IntArray, IntArray]:
        """Where pieces begin and end along the rows, and the (rows, 2) range of pieces of each window."""
        return _pieces(self.tops, self.window)

    @cached_property
    def col_pieces(self) -> tuple[IntArray, IntArray]:
        """As `row_pieces`, along the columns."""
        return _pieces(self.lefts, self.window)


def _pieces(starts: IntArray, window: int) -> tuple[IntArray, IntArray]:
    edges = np.unique(np.concatenate([starts, starts + window]))
    cuts = [edges[:1]]
    for low, gap in zip(edges[:-1], np.diff(edges), strict=True):
        parts = -(-gap // PIECE)
        cuts.append(low + np.arange(1, parts + 1) * gap // parts)
    whole = np.concatenate(cuts).astype(np.int64)
    ranges = np.stack([np.searchsorted(whole, starts), np.searchsorted(whole, starts + window)], axis=1)
    return whole, ranges.astype(np.int64)


@dataclass(frozen=True, eq=False)
class Expected:
    """What is expected of the displacement in each window of a grid.

    Parameters
    ----------
    shift : (rows, cols, 2) float64 px (dx, dy) of its middle
    slope : (rows, cols, 2, 2) float64, derivatives of (dx, dy) along (x, y)
    pieces : (R, C, 2) int64 whole px at which each piece of the windows is read in the second map
    """

    shift: FloatArray
    slope: FloatArray
    pieces: IntArray

    @classmethod
    def still(cls, grid: WindowGrid) -> Expected:
        """No displacement anywhere."""
        shape = (len(grid.row_pieces[0]) - 1, len(grid.col_pieces[0]) - 1)
        return cls(np.zeros((*grid.shape, 2)), np.zeros((*grid.shape, 2, 2)), np.zeros((*shape, 2), np.int64))


def read_shift(grid: WindowGrid, expected: Expected) -> FloatArray:
    """Return the (rows, cols, 2) mean of the whole shifts at which the pieces of each window are read, px.

    It differs from the shift expected of the window by what whole pixels leave; where it differs by more, some pieces
    show another motion and are left out, and the expected one stands.
    """
    pieces = expected.pieces
    total = np.zeros((pieces.shape[0] + 1, pieces.shape[1] + 1, 2))
    total[1:, 1:] = pieces.cumsum(axis=0).cumsum(axis=1)
    (_, rows), (_, cols) = grid.row_pieces, grid.col_pieces
    (top, bottom), (left, right) = rows.T[..., None], cols.T
    inside = total[bottom, right] - total[top, right] - total[bottom, left] + total[top, left]
    mean = inside / ((bottom - top) * (right - left))[..., None]
    near = (np.abs(mean - expected.shift) <= 1).all(axis=-1, keepdims=True)
    return np.where(near, mean, expected.shift)


@dataclass(frozen=True, eq=False)
class GridPeaks:
    """The correlation's peaks in the windows of a grid.

    Parameters
    ----------
    shift : (rows, cols, 2) float64 px, displacement of the middle of each window
    covariance : (rows, cols, 2, 2) float64 px^2
    """

    shift: FloatArray
    covariance: FloatArray


def grid_correlations(
    first: F32, second: F32, grid: WindowGrid, search: int, expected: Expected | None = None
) -> FloatArray:
    """Return the correlation coefficients of the windows of a grid, for every small shift around what is expected.

    Parameters
    ----------
    first : (H, W) float32 zero-mean map, holds all windows
    second : (H, W) float32 zero-mean map; what lies beyond its rim counts as its rim
    grid : the windows
    search : largest shift along x and y
    expected : where the pieces of the windows are read in the second map; None for where they are in the first

    Returns
    -------
    (rows, cols, 2 * search + 1, 2 * search + 1) float64
        Element [j, i, search + dy, search + dx] for a window of `first` against the pieces of `second` at (dx, dy) from
        their own shifts; 0 where a window is 0. Pieces whose shift is not that expected in the window are left
        out: a fault parts a window into what moves with its middle and what does not.

    Notes
    -----
    Means are not subtracted: band-passed maps have none over a window. Pieces at shifts of their own make a window that
    follows the strain within it, without resampling.
    """
    from featreg.sar import grid_correlation_kernels as kernels

    side = 2 * search + 1
    out = np.zeros((*grid.shape, side, side))
    if not out.size:
        return out
    expected = expected or Expected.still(grid)
    (row_cuts, rows), (col_cuts, cols) = grid.row_pieces, grid.col_pieces
    shifts = np.ascontiguousarray(expected.pieces, np.int64)
    margin = search + int(np.abs(shifts).max())
    b = _widened(second, margin)
    products = np.empty((*shifts.shape[:2], side, side), np.float32)
    kernels.piece_products(first, b, margin, row_cuts, col_cuts, shifts, products)
    square_a, square_b = np.empty((*shifts.shape[:2], 1, 1), np.float32), np.empty_like(products)
    kernels.piece_products(first, first, 0, row_cuts, col_cuts, np.zeros_like(shifts), square_a)
    kernels.piece_squares(_squares(b), margin, row_cuts, col_cuts, shifts, square_b)
    flat = (*shifts.shape[:2], -1)
    kernels.window_correlations(
        products.reshape(flat), square_a.reshape(flat), square_b.reshape(flat), shifts, rows, cols,
        _places(row_cuts, col_cuts), _table(grid, expected), APART, out.reshape(*grid.shape, -1),
    )  # fmt: skip
    return out


def grid_peaks(first: F32, second: F32, grid: WindowGrid, expected: Expected, residual: FloatArray) -> GridPeaks:
    """Return the displacements of the windows and their covariances, from where their correlation is highest.

    Parameters
    ----------
    first, second : (H, W) float32 zero-mean maps; windows lie at least one pixel inside `first`
    grid, expected : as for `grid_correlations`
    residual : (rows, cols, 2) float64 px, peak of each window's correlation from the shifts of its pieces

    Returns
    -------
    GridPeaks
        NaN where the correlation does not curve downwards.

    Notes
    -----
    A peak is where the slope of the correlation, a sum over pieces, is 0. Where the displacement changes linearly
    within the window, that is so at the mean of the pieces' displacements weighted by their curvatures H, which is
    taken back to the middle of the window. With S the sum of squares of the slopes of the pieces about their mean,
    the covariance is H^-1 S H^-1: speckle, changed ground and a displacement that differs from the linear one all count
    as they are. The slope of a pixel is taken as (a grad b - b grad a) / 2, which is 0 for a pair without noise, so
    that nothing cancels only between pieces.

    References
    ----------
    H. White, "A heteroskedasticity-consistent covariance matrix estimator", Econometrica 48 (1980) 817,
    DOI 10.2307/1912934
    """
    from featreg.sar import grid_correlation_kernels as kernels

    shift, covariance = np.full((*grid.shape, 2), np.nan), np.full((*grid.shape, 2, 2), np.nan)
    if not shift.size:
        return GridPeaks(shift, covariance)
    (row_cuts, rows), (col_cuts, cols) = grid.row_pieces, grid.col_pieces
    shifts = np.ascontiguousarray(expected.pieces, np.int64)
    margin = int(np.abs(shifts).max()) + 1
    slopes = np.empty((*shifts.shape[:2], kernels.SUMS), np.float32)
    kernels.piece_slopes(first, _widened(second, margin), margin, row_cuts, col_cuts, shifts, slopes)
    leak = 1.0
    for cuts in (row_cuts, col_cuts):
        leak /= 1 - LEAK / max(float(np.diff(cuts).mean()), 2 * LEAK)
    kernels.window_peaks(
        slopes, shifts, rows, cols, _places(row_cuts, col_cuts), _table(grid, expected), APART,
        np.ascontiguousarray(residual, np.float64), leak, shift, covariance,
    )  # fmt: skip
    return GridPeaks(shift, covariance)


def piece_middles(grid: WindowGrid) -> tuple[FloatArray, FloatArray]:
    """Return the columns and the rows, px, of the middles of the pieces of a grid."""
    x, y = ((cuts[1:] + cuts[:-1] - 1) / 2 for cuts in (grid.col_pieces[0], grid.row_pieces[0]))
    return x, y


def _places(row_cuts: IntArray, col_cuts: IntArray) -> FloatArray:
    """(2, most) middles of the pieces along x and along y."""
    places = np.zeros((2, max(len(row_cuts), len(col_cuts))))
    for k, cuts in enumerate((col_cuts, row_cuts)):
        places[k, : len(cuts) - 1] = (cuts[1:] + cuts[:-1] - 1) / 2
    return places


def _table(grid: WindowGrid, expected: Expected) -> FloatArray:
    """(rows, cols, 8) displacement, its four derivatives and the middle of each window."""
    half = (grid.window - 1) / 2
    middles = np.stack(np.meshgrid(grid.lefts + half, grid.tops + half), -1)
    slope = expected.slope.reshape(*grid.shape, 4)
    return np.ascontiguousarray(np.concatenate([expected.shift, slope, middles], axis=-1), np.float64)


def _widened(image: F32, margin: int) -> F32:
    import cv2

    if not margin:
        return image
    return np.asarray(cv2.copyMakeBorder(image, margin, margin, margin, margin, cv2.BORDER_REPLICATE), np.float32)


def _squares(image: F32) -> FloatArray:
    """(H + 1, W + 1) sums of the squares above and left of each pixel."""
    import cv2

    return np.asarray(cv2.integral2(image, sdepth=cv2.CV_64F, sqdepth=cv2.CV_64F)[1], np.float64)
