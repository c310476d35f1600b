"""Compiled loops of the ground under the lines of sight of a sensor by rational polynomials."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.geolocation.rpc_kernels import CHUNK, newton
from featreg.runtime.jit import compiled
from featreg.types import FloatArray

#: Evaluations of the heights before a point is left to who brackets it; gentle ground needs four.
ROUNDS = 8
#: A point is followed by secants only while each step leaves at most this part of the gap before: it then has one
#: crossing near, which plain rounds would find too.
SHRINKING = 0.5


@compiled
def _nearest_ground(
    coefficients: FloatArray, sample: FloatArray, line: FloatArray, high: FloatArray, x: FloatArray, y: FloatArray,
    off: FloatArray, tolerance: float, most: int,
) -> None:  # fmt: skip
    """Newton's steps of a chunk from where `x`, `y` are; `off` as `newton` leaves it."""
    a, b, c, d = coefficients[0], coefficients[1], coefficients[2], coefficients[3]
    for _ in range(most):
        newton(a, b, c, d, sample, line, high, x, y, off, tolerance)
        worst = 0.0
        for i in range(off.shape[0]):
            worst = max(worst, off[i])
        if worst <= tolerance:
            break


@compiled
def _heights(
    x: FloatArray, y: FloatArray, norm: FloatArray, cells: FloatArray, tile: FloatArray, left: int, top: int,
    out: FloatArray,
) -> None:  # fmt: skip
    """Bilinear heights of a chunk of normalised ground points; NaN where they lie beyond the tile."""
    width, height, turn = int(cells[6]), int(cells[7]), cells[9]
    for i in range(x.shape[0]):
        longitude = (x[i] * norm[4] + norm[5] + 180.0) % 360.0 - 180.0
        latitude = y[i] * norm[6] + norm[7]
        longitude = longitude - turn * np.rint((longitude - cells[8]) / turn)
        u = cells[0] * longitude + cells[1] * latitude + cells[2] - 0.5
        v = cells[3] * longitude + cells[4] * latitude + cells[5] - 0.5
        out[i] = np.nan
        if not (np.isfinite(u) and np.isfinite(v)):
            continue
        u, v = min(max(u, 0.0), width - 1.0), min(max(v, 0.0), height - 1.0)
        column, row = min(int(np.floor(u)), max(width - 2, 0)), min(int(np.floor(v)), max(height - 2, 0))
        s, t = u - column, v - row
        column, row = column - left, row - top
        right, below = column + 1 if width > 1 else column, row + 1 if height > 1 else row
        if column < 0 or row < 0 or right >= tile.shape[1] or below >= tile.shape[0]:
            continue
        upper = tile[row, column] * (1 - s) + tile[row, right] * s
        lower = tile[below, column] * (1 - s) + tile[below, right] * s
        out[i] = upper * (1 - t) + lower * t


@compiled
def ground_of(
    coefficients: FloatArray, norm: FloatArray, cells: FloatArray, tile: FloatArray, left: int, top: int,
    start: float, close: float, tolerance: float, most: int, xy: FloatArray, ground: FloatArray, level: FloatArray,
    found: NDArray[np.uint8],
) -> None:  # fmt: skip
    """Write where the lines of sight of image points meet the ground.

    Parameters
    ----------
    coefficients : (4, 20) of the rational polynomials, see `featreg.geolocation.rpc_kernels`
    norm : (10,) scale and offset, one after the other, of sample, line, longitude, latitude and height
    cells : (10,) the map from longitude and latitude to columns and rows of the elevation model, counted from the
        corner of its first cell (6 numbers as GDAL has them), its width and height, its middle longitude and a turn
    tile, left, top : a part of the model, and its first column and row
    start : metres at which every search begins
    close : heights count as found to so many metres
    tolerance, most : of Newton's iteration, in normalised image coordinates, and its most steps
    xy : (N, 2) image points
    ground, level : (N, 2) longitude and latitude and (N,) heights, NaN where they are not found;
        the first is written only where they are
    found : (N,) written: 1 where the ground was found, 0 where it takes more care or lies beyond the tile

    Notes
    -----
    The gap DEM(lonlat(h)) - h is driven to 0: one plain round, then secants.
    """
    count = xy.shape[0]
    size = min(CHUNK, count)
    sample, line, high = np.empty(size), np.empty(size), np.empty(size)
    east, north, off, dem = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    before, gap, state = np.empty(size), np.empty(size), np.empty(size, np.uint8)
    for first in range(0, count, CHUNK):
        n = min(CHUNK, count - first)
        s, t, z, x, y, o = sample[:n], line[:n], high[:n], east[:n], north[:n], off[:n]
        for i in range(n):
            s[i], t[i] = (xy[first + i, 0] - norm[1]) / norm[0], (xy[first + i, 1] - norm[3]) / norm[2]
            x[i], y[i], o[i], level[first + i], state[i] = 0.0, 0.0, np.inf, start, 0
            z[i] = (start - norm[9]) / norm[8]
        _nearest_ground(coefficients, s, t, z, x, y, o, tolerance, most)
        for turn in range(ROUNDS):
            _heights(x, y, norm, cells, tile, left, top, dem[:n])
            still = False
            for i in range(n):
                if state[i]:
                    continue
                if not o[i] <= tolerance:
                    # The height is that of some other place than the line of sight's.
                    state[i] = 2
                    continue
                here = level[first + i]
                now = dem[i] - here
                if abs(now) <= close:
                    state[i], step = 1, now
                elif not np.isfinite(now) or (turn and not abs(now) <= SHRINKING * abs(gap[i])):
                    state[i] = 2
                    continue
                elif turn:
                    step, still = -now * (here - before[i]) / (now - gap[i]), True
                else:
                    step, still = now, True
                before[i], gap[i], level[first + i] = here, now, here + step
                z[i], o[i] = (here + step - norm[9]) / norm[8], np.inf
            _nearest_ground(coefficients, s, t, z, x, y, o, tolerance, most)
            if not still:
                break
        for i in range(n):
            good = state[i] == 1 and o[i] <= tolerance
            found[first + i] = np.uint8(good)
            if not good:
                level[first + i] = np.nan
            else:
                ground[first + i, 0] = (x[i] * norm[4] + norm[5] + 180.0) % 360.0 - 180.0
                ground[first + i, 1] = y[i] * norm[6] + norm[7]
