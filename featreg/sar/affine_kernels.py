"""Compiled bilinear interpolation of a map at the places to which an affine map takes a grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]

#: Pixels of a row that are looked up at once, and rows of such runs, one below the other.
RUN, ROWS = 128, 32
#: float32 values that lie in one line of the cache.
LINE = 16


@compiled
def _places(
    u: np.float32, v: np.float32, along: np.float32, down: np.float32, low_x: np.float32, high_x: np.float32,
    low_y: np.float32, high_y: np.float32, last_x: np.int32, last_y: np.int32, width: np.int32, ramp: F32, at: I32,
    right: F32, below: F32,
) -> None:  # fmt: skip
    """Places (u, v) + k (along, down) brought into a map: the pixel before each, and the rest along x and y."""
    for k in range(np.uint64(at.shape[0])):
        x = min(max(u + along * ramp[k], low_x), high_x)
        y = min(max(v + down * ramp[k], low_y), high_y)
        column, row = min(np.int32(x), last_x), min(np.int32(y), last_y)
        right[k], below[k] = x - np.float32(column), y - np.float32(row)
        at[k] = np.int32(row * width + column)


@compiled
def looked_up(flat: F32, first: int, width: int, at: I32, right: F32, below: F32, out: F32) -> None:
    """Values between the four pixels from each of some places on, counted from the pixel `first`."""
    base, row, one = np.uint64(first), np.uint64(width), np.uint64(1)
    for k in range(np.uint64(at.shape[0])):
        # Offsets may be negative; the sum is not, and wraps to it.
        i = base + np.uint64(np.int64(at[k]))
        j = i + row
        across = right[k]
        upper = flat[i] + across * (flat[i + one] - flat[i])
        lower = flat[j] + across * (flat[j + one] - flat[j])
        out[k] = upper + below[k] * (lower - upper)


@compiled
def _start(first: float, last: float, size: int) -> float:
    """Where the whole pixels of a run from `first` to `last` begin to be counted."""
    return float(np.floor(min(max(min(first, last), 0.0), size - 1.0)))


@compiled
def _run(
    flat: F32, height: int, width: int, u: float, v: float, across: float, downward: float, ramp: F32, at: I32,
    right: F32, below: F32, out: F32,
) -> None:  # fmt: skip
    """Fill a run of pixels at the places (u, v) + k (across, downward)."""
    zero = np.float32(0)
    end_u, end_v = u + across * (out.shape[0] - 1), v + downward * (out.shape[0] - 1)
    along, down = np.float32(across), np.float32(downward)
    x0, y0 = _start(u, end_u, width), _start(v, end_v, height)
    # A run that lies beyond the rim as a whole stays at it.
    if max(u, end_u) <= 0.0 or min(u, end_u) >= width - 1.0:
        u, along = x0, zero
    if max(v, end_v) <= 0.0 or min(v, end_v) >= height - 1.0:
        v, down = y0, zero
    _places(
        np.float32(u - x0), np.float32(v - y0), along, down, zero, np.float32(width - 1.0 - x0), zero,
        np.float32(height - 1.0 - y0), np.int32(width - 2.0 - x0), np.int32(height - 2.0 - y0), np.int32(width), ramp,
        at, right, below,
    )  # fmt: skip
    looked_up(flat, int(y0) * width + int(x0), width, at, right, below, out)


@compiled
def _touched(flat: F32, width: int, left: int, right: int, top: int, bottom: int) -> np.float32:
    """Read a box of a map once, a value of each line of the cache: in turn, which many reads at a time can be."""
    total = np.float32(0)
    for y in range(top, bottom + 1):
        here, end = np.uint64(y * width + left), np.uint64(y * width + right)
        while here <= end:
            total += flat[here]
            here += np.uint64(LINE)
        total += flat[end]
    return np.float32(total)


@compiled
def _within(place: float, size: int) -> int:
    return int(min(max(place, 0.0), size - 1.0))


@compiled
def sampled_affinely(flat: F32, height: int, width: int, affine: F64, top: int, out: F32) -> float:
    """Fill `out` (h, w) with a map, given row by row, at the places to which `affine` (2, 3) takes a grid.

    `out` is the part of the grid from the row `top` on. Beyond its rim the map goes on as its last pixels; it has two
    rows and columns at least. Places are told to 1e-4 px, by coordinates in float32 along each run of pixels, which
    begins where float64 says; it may be up to some thousand pixels long in the map. What is returned means nothing: it
    keeps the compiler from leaving out reads that only fetch the map.
    """
    ramp, at = np.empty(RUN, np.float32), np.empty(RUN, np.int32)
    right, below = np.empty(RUN, np.float32), np.empty(RUN, np.float32)
    for k in range(RUN):
        ramp[k] = np.float32(k)
    total = np.float32(0)
    a, b, c, d = affine[0, 0], affine[0, 1], affine[1, 0], affine[1, 1]
    for begin in range(0, out.shape[0], ROWS):
        rows = min(ROWS, out.shape[0] - begin)
        for left in range(0, out.shape[1], RUN):
            count = min(RUN, out.shape[1] - left)
            u, v = a * left + b * (top + begin) + affine[0, 2], c * left + d * (top + begin) + affine[1, 2]
            along, down, aside, under = a * (count - 1), c * (count - 1), b * (rows - 1), d * (rows - 1)
            total += _touched(
                flat, width, _within(u + min(along, 0.0) + min(aside, 0.0), width),
                _within(u + max(along, 0.0) + max(aside, 0.0) + 1.0, width),
                _within(v + min(down, 0.0) + min(under, 0.0), height),
                _within(v + max(down, 0.0) + max(under, 0.0) + 1.0, height),
            )  # fmt: skip
            for r in range(begin, begin + rows):
                u, v = a * left + b * (top + r) + affine[0, 2], c * left + d * (top + r) + affine[1, 2]
                _run(flat, height, width, u, v, a, c, ramp, at[:count], right, below, out[r, left : left + count])
    return float(total)
