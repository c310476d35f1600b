"""Compiled loops that make unit vectors of histograms in cells, in which no cell decides alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

F32 = NDArray[np.float32]

#: Vectors that lie side by side in the processor's lanes.
LANES = 64


@compiled
def _add_squares(values: F32, out: F32) -> None:
    for i in range(out.shape[0]):
        out[i] += values[i] * values[i]


@compiled
def _add(values: F32, out: F32) -> None:
    for i in range(out.shape[0]):
        out[i] += values[i]


@compiled
def _inverse_roots(squares: F32, out: F32) -> None:
    """0 where there is nothing."""
    for i in range(out.shape[0]):
        inverse = np.float32(1) / np.sqrt(squares[i])
        out[i] = inverse if squares[i] > np.float32(0) else np.float32(0)


@compiled
def _clipped(squares: F32, inverse: F32, clip: np.float32, total: F32) -> None:
    """Turn the squared lengths of a cell into what it is multiplied by, and add up its squared length after that."""
    for i in range(total.shape[0]):
        square = squares[i] * inverse[i] * inverse[i]
        kept = clip / np.sqrt(square)
        kept = kept if kept < np.float32(1) else np.float32(1)
        squares[i] = kept * inverse[i]
        total[i] += square * kept * kept if square > np.float32(0) else np.float32(0)


@compiled
def _scaled(values: F32, one: F32, two: F32) -> None:
    for i in range(values.shape[0]):
        values[i] *= one[i] * two[i]


@compiled
def unit_lanes(vectors: F32, squares: F32, total: F32, inverse: F32, clip: np.float32) -> None:
    """Make unit vectors of the columns of `vectors` (parts * cells, lanes), as `unit_cells` does of rows.

    `squares` (cells, lanes), `total` and `inverse` (lanes,) are room.
    """
    cells = squares.shape[0]
    total[:] = np.float32(0)
    for cell in range(cells):
        squares[cell] = np.float32(0)
        for at in range(cell, vectors.shape[0], cells):
            _add_squares(vectors[at], squares[cell])
        _add(squares[cell], total)
    _inverse_roots(total, inverse)
    total[:] = np.float32(0)
    for cell in range(cells):
        _clipped(squares[cell], inverse, clip, total)
    _inverse_roots(total, inverse)
    for at in range(vectors.shape[0]):
        _scaled(vectors[at], squares[at % cells], inverse)


@compiled
def unit_cells(rows: F32, cells: int, clip: np.float32, out: F32) -> None:
    """Fill `out` with unit vectors of `rows` (N, parts * cells), no cell of which was longer than `clip` in between.

    Rows are brought to unit length, cells clipped, and rows brought to unit length again; rows of zeros stay.
    """
    count, length = rows.shape
    vectors, squares = np.zeros((length, LANES), np.float32), np.empty((cells, LANES), np.float32)
    total, inverse = np.empty(LANES, np.float32), np.empty(LANES, np.float32)
    for start in range(0, count, LANES):
        lanes = min(LANES, count - start)
        for i in range(lanes):
            for k in range(length):
                vectors[k, i] = rows[start + i, k]
        unit_lanes(vectors, squares, total, inverse, clip)
        for i in range(lanes):
            for k in range(length):
                out[start + i, k] = vectors[k, i]
