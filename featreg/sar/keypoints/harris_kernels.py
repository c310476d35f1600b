"""Compiled loops of the Harris response of a gradient field, and of the maxima of a response."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
I64 = NDArray[np.int64]


@compiled
def _products_of_row(gx: F32, gy: F32, xx: F32, xy: F32, yy: F32) -> None:
    for i in range(gx.shape[0]):
        xx[i] = gx[i] * gx[i]
        xy[i] = gx[i] * gy[i]
        yy[i] = gy[i] * gy[i]


@compiled
def products(gx: F32, gy: F32, maps: F32) -> None:
    """Fill maps (3, H, W) with gx^2, gx gy and gy^2."""
    for y in range(gx.shape[0]):
        _products_of_row(gx[y], gy[y], maps[0, y], maps[1, y], maps[2, y])


@compiled
def _response_of_row(xx: F32, xy: F32, yy: F32, d: np.float32, out: F32) -> None:
    for i in range(out.shape[0]):
        trace = xx[i] + yy[i]
        out[i] = xx[i] * yy[i] - xy[i] * xy[i] - d * trace * trace


@compiled
def response(maps: F32, d: np.float32, out: F32) -> None:
    """Fill `out` with det - d trace^2 of the matrices whose elements xx, xy, yy are maps (3, H, W)."""
    for y in range(maps.shape[1]):
        _response_of_row(maps[0, y], maps[1, y], maps[2, y], d, out[y])


@compiled
def _peaks_of_row(above: F32, here: F32, below: F32, threshold: np.float32, peak: U8) -> None:
    for column in range(here.shape[0] - 2):
        x0 = np.uint64(column)
        x1, x2 = x0 + np.uint64(1), x0 + np.uint64(2)
        value = here[x1]
        before = max(max(above[x0], above[x1]), max(above[x2], here[x0]))
        after = max(max(below[x0], below[x1]), max(below[x2], here[x2]))
        peak[x1] = np.uint8((value > before) & (value >= after) & (value > threshold))


@compiled
def collect_peaks(response: F32, allowed: U8, threshold: np.float32, at: I64) -> int:
    """Gather the flat indices of local maxima above `threshold` at pixels with `allowed` != 0; return how many."""
    height, width = response.shape
    peak = np.zeros((width + 7) // 8 * 8, np.uint8)
    eights = peak.view(np.uint64)
    count = 0
    for y in range(1, height - 1):
        _peaks_of_row(response[y - 1], response[y], response[y + 1], threshold, peak[:width])
        for k in range(eights.shape[0]):
            if eights[k] == 0:
                continue
            for x in range(8 * k, min(8 * k + 8, width)):
                if peak[x] != 0 and allowed[y, x] != 0:
                    at[count] = y * width + x
                    count += 1
    return count
