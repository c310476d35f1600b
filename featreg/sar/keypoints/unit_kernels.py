"""Compiled loops that make unit vectors of histograms in cells, in which no cell decides alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

F32 = NDArray[np.float32]


@compiled
def _add_squares(row: F32, squares: F32) -> None:
    for c in range(squares.shape[0]):
        squares[c] += row[c] * row[c]


@compiled
def _scaled(row: F32, factor: F32, out: F32) -> None:
    for c in range(out.shape[0]):
        out[c] = row[c] * factor[c]


@compiled
def unit_cells(rows: F32, clip: np.float32, out: F32) -> None:
    """Fill `out` with unit vectors of `rows` (N, parts, cells), no cell of which was longer than `clip` in between.

    Rows are brought to unit length, cells clipped, and rows brought to unit length again; rows of zeros stay.
    """
    cells = rows.shape[2]
    squares, factor = np.empty(cells, np.float32), np.empty(cells, np.float32)
    for i in range(rows.shape[0]):
        squares[:] = 0
        for p in range(rows.shape[1]):
            _add_squares(rows[i, p], squares)
        total = 0.0
        for c in range(cells):
            total += squares[c]
        inverse = 1.0 / np.sqrt(total) if total > 0.0 else 0.0
        total = 0.0
        for c in range(cells):
            length = np.sqrt(np.float64(squares[c])) * inverse
            kept = inverse * (clip / length if length > clip else 1.0)
            factor[c] = np.float32(kept)
            total += squares[c] * kept * kept
        again = np.float32(1.0 / np.sqrt(total) if total > 0.0 else 0.0)
        for c in range(cells):
            factor[c] *= again
        for p in range(rows.shape[1]):
            _scaled(rows[i, p], factor, out[i, p])
