"""Compiled loops of the filter before a correlation; `featreg.sar.correlation_filter` says what they compute."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled
from featreg.sar.smoothing_kernels import mirrored

F32 = NDArray[np.float32]

#: Half the side of the filter, px, and separable filters that it is a sum of.
HALF, TERMS = 5, 3
#: A map is worked on in tiles of so many columns and rows, which stay in the cache from one direction to the other.
COLUMNS, ROWS = 128, 16
#: Values from one row of a tile to the next under the filters along x, one after the other.
STRIDE = TERMS * COLUMNS
ROW, TERM = np.uint64(STRIDE), np.uint64(COLUMNS)


@compiled
def _along(row: F32, taps: F32, start: int, count: int, out: F32) -> None:
    """Write `count` values of a row under each of three symmetric filters to `out`, from `start` on in each term."""
    a0, a1, a2, a3, a4, a5 = taps[0, 0], taps[0, 1], taps[0, 2], taps[0, 3], taps[0, 4], taps[0, 5]
    b0, b1, b2, b3, b4, b5 = taps[1, 0], taps[1, 1], taps[1, 2], taps[1, 3], taps[1, 4], taps[1, 5]
    c0, c1, c2, c3, c4, c5 = taps[2, 0], taps[2, 1], taps[2, 2], taps[2, 3], taps[2, 4], taps[2, 5]
    first = np.uint64(start)
    for x in range(np.uint64(count)):
        middle = row[x + np.uint64(5)]
        one = row[x + np.uint64(4)] + row[x + np.uint64(6)]
        two = row[x + np.uint64(3)] + row[x + np.uint64(7)]
        three = row[x + np.uint64(2)] + row[x + np.uint64(8)]
        four = row[x + np.uint64(1)] + row[x + np.uint64(9)]
        five = row[x] + row[x + np.uint64(10)]
        at = first + x
        out[at] = (a0 * middle + a1 * one) + (a2 * two + a3 * three) + (a4 * four + a5 * five)
        out[at + TERM] = (b0 * middle + b1 * one) + (b2 * two + b3 * three) + (b4 * four + b5 * five)
        out[at + TERM + TERM] = (c0 * middle + c1 * one) + (c2 * two + c3 * three) + (c4 * four + c5 * five)


@compiled
def _across(tile: F32, start: int, taps: F32, level: np.float32, out: F32) -> None:
    """Sum over the terms of a symmetric filter across the rows of a tile, the first at `start`, less a level."""
    a0, a1, a2, a3, a4, a5 = taps[0, 0], taps[0, 1], taps[0, 2], taps[0, 3], taps[0, 4], taps[0, 5]
    b0, b1, b2, b3, b4, b5 = taps[1, 0], taps[1, 1], taps[1, 2], taps[1, 3], taps[1, 4], taps[1, 5]
    c0, c1, c2, c3, c4, c5 = taps[2, 0], taps[2, 1], taps[2, 2], taps[2, 3], taps[2, 4], taps[2, 5]
    begin = np.uint64(start)
    r2, r3, r4, r5 = ROW + ROW, ROW * np.uint64(3), ROW * np.uint64(4), ROW * np.uint64(5)
    r6, r7, r8, r9 = ROW * np.uint64(6), ROW * np.uint64(7), ROW * np.uint64(8), ROW * np.uint64(9)
    for x in range(np.uint64(out.shape[0])):
        i = begin + x
        value = (
            (a0 * tile[i + r5] + a1 * (tile[i + r4] + tile[i + r6]))
            + (a2 * (tile[i + r3] + tile[i + r7]) + a3 * (tile[i + r2] + tile[i + r8]))
        ) + (a4 * (tile[i + ROW] + tile[i + r9]) + a5 * (tile[i] + tile[i + r5 + r5]))
        i += TERM
        value += (
            (b0 * tile[i + r5] + b1 * (tile[i + r4] + tile[i + r6]))
            + (b2 * (tile[i + r3] + tile[i + r7]) + b3 * (tile[i + r2] + tile[i + r8]))
        ) + (b4 * (tile[i + ROW] + tile[i + r9]) + b5 * (tile[i] + tile[i + r5 + r5]))
        i += TERM
        value += (
            (c0 * tile[i + r5] + c1 * (tile[i + r4] + tile[i + r6]))
            + (c2 * (tile[i + r3] + tile[i + r7]) + c3 * (tile[i + r2] + tile[i + r8]))
        ) + (c4 * (tile[i + ROW] + tile[i + r9]) + c5 * (tile[i] + tile[i + r5 + r5]))
        out[x] = value - level


@compiled
def _with_rim(row: F32, start: int, out: F32) -> None:
    """Copy a part of a row that may begin before it or end behind it, where it is mirrored."""
    n, count = row.shape[0], out.shape[0]
    first, last = max(0, -start), min(count, n - start)
    for c in range(first):
        out[c] = row[mirrored(start + c, n)]
    for c in range(first, last):
        out[c] = row[start + c]
    for c in range(max(first, last), count):
        out[c] = row[mirrored(start + c, n)]


@compiled
def _filtered(
    view: F32, across: F32, down: F32, level: np.float32, rim: int, tile: F32, row: F32, out: F32
) -> None:  # fmt: skip
    """Fill `out` with a map under the filter, from `rim` pixels before its corner on, beyond which it is mirrored."""
    height, width = view.shape
    for left in range(0, out.shape[1], COLUMNS):
        wide = min(COLUMNS, out.shape[1] - left)
        first = left - rim
        inside = first >= 0 and first + wide + 2 * HALF <= width
        for top in range(0, out.shape[0], ROWS):
            high = min(ROWS, out.shape[0] - top)
            known = 0
            if top > 0:
                known = 2 * HALF
                for k in range(known * STRIDE):
                    tile[k] = tile[k + ROWS * STRIDE]
            for r in range(known, high + 2 * HALF):
                y = mirrored(top + r - rim, height)
                if inside:
                    _along(view[y, first : first + wide + 2 * HALF], across, r * STRIDE, wide, tile)
                else:
                    _with_rim(view[y], first, row[: wide + 2 * HALF])
                    _along(row, across, r * STRIDE, wide, tile)
            for r in range(high):
                _across(tile, r * STRIDE, down, level, out[top + r, left : left + wide])


@compiled
def under_filter(view: F32, across: F32, down: F32, level: np.float32, out: F32) -> None:
    """Fill `out` (H, W) with a map under a sum of three separable symmetric filters, less a level.

    `across` and `down` (3, 6) are the taps along x and y, from the middle on. Beyond its rim the map is mirrored.
    """
    tile, row = np.empty(STRIDE * (ROWS + 2 * HALF), np.float32), np.empty(COLUMNS + 2 * HALF, np.float32)
    _filtered(view, across, down, level, HALF, tile, row, out)


@compiled
def windows_under_filter(windows: F32, across: F32, down: F32, out: F32) -> None:
    """Fill `out` (N, h - 2 * HALF, w - 2 * HALF) with windows (N, h, w) under the same; their rims are used up."""
    tile, row = np.empty(STRIDE * (ROWS + 2 * HALF), np.float32), np.empty(COLUMNS + 2 * HALF, np.float32)
    for i in range(out.shape[0]):
        _filtered(windows[i], across, down, np.float32(0), 0, tile, row, out[i])
