"""Compiled counts of tie points and robust fits to parts of them; `featreg.pipeline.trust_measures` says what for.

Kinds of models are those of `featreg.geometry.robust_kernels`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from featreg.geometry.reweighting_kernels import middle_of, reweighted, weighted_fit
from featreg.runtime.jit import compact, compiled
from featreg.types import BoolArray, FloatArray, IntArray


@compiled
def _different(first: IntArray, second: IntArray, table: NDArray[np.int32]) -> int:
    """How many different pairs two arrays (M,) hold; `table` (N,), N a power of two above 2 M, is overwritten."""
    table[:] = 0
    count, last = 0, np.uint64(table.shape[0] - 1)
    for i in range(first.shape[0]):
        # Knuth's multiplicative hashing, of two numbers; the upper bits depend on all.
        mixed = np.uint64(first[i]) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(second[i])
        at = ((mixed * np.uint64(0xD6E8FEB86659FD93)) >> np.uint64(32)) & last
        while table[at] != 0 and (first[table[at] - 1] != first[i] or second[table[at] - 1] != second[i]):
            at = (at + np.uint64(1)) & last
        if table[at] == 0:
            table[at] = i + 1
            count += 1
    return count


@compiled
def counted(here: FloatArray, there: FloatArray, side: float, out: IntArray) -> None:
    """Fill out (3,): cells of `side` px that hold points (M, 2) `here`, those `there`, and different pairs of them."""
    m, size = here.shape[0], 8
    while size < 2 * m:
        size *= 2
    table = np.empty(size, np.int32)
    first, second, nothing = np.empty(m, np.int64), np.empty(m, np.int64), np.zeros(m, np.int64)
    for i in range(m):
        # As `featreg.geometry.cells.cells` numbers them.
        first[i] = np.int64(math.floor(here[i, 1] / side)) * (1 << 24) + np.int64(math.floor(here[i, 0] / side))
        second[i] = np.int64(math.floor(there[i, 1] / side)) * (1 << 24) + np.int64(math.floor(there[i, 0] / side))
    out[0], out[1] = _different(first, nothing, table), _different(second, nothing, table)
    out[2] = _different(first, second, table)


@compiled
def _moved(p: FloatArray, x: float, y: float, u: float, v: float) -> float:
    """Squared distance of where a model maps a point from another point."""
    w = 1.0 / (p[6] * x + p[7] * y + p[8])
    a, b = (p[0] * x + p[1] * y + p[2]) * w - u, (p[3] * x + p[4] * y + p[5]) * w - v
    return float(a * a + b * b)


@compiled
def robust_fit(
    kind: int, minimum: int, here: FloatArray, there: FloatArray, tuning: float, least: float, rounds: int,
    weights: FloatArray, p: FloatArray, frame: FloatArray,
) -> bool:  # fmt: skip
    """Fit a model as `featreg.geometry.robust.irls` does with equal prior weights; False where it cannot be fitted.

    Parameters
    ----------
    kind, minimum : of the model
    here, there : (M, 2) px
    tuning, least, rounds : as in `featreg.geometry.reweighting_kernels.reweighted`
    weights : (M,) filled with the weights of the last fit
    p : (9,) filled with the model, in coordinates (xy - frame[:2]) / frame[4] and (uv - frame[2:4]) / frame[4]
    frame : (5,) filled
    """
    m = here.shape[0]
    if m < minimum:
        return False
    if reweighted(kind, minimum, here, there, np.ones(m), tuning, least, rounds, weights) == 0:
        return False
    frame[:] = 0.0
    for i in range(m):
        frame[0] += here[i, 0] / m
        frame[1] += here[i, 1] / m
        frame[2] += there[i, 0] / m
        frame[3] += there[i, 1] / m
    x, y, u, v = np.empty(m), np.empty(m), np.empty(m), np.empty(m)
    size = 0.0
    for i in range(m):
        x[i], y[i] = here[i, 0] - frame[0], here[i, 1] - frame[1]
        u[i], v[i] = there[i, 0] - frame[2], there[i, 1] - frame[3]
        size = max(size, abs(x[i]), abs(y[i]), abs(u[i]), abs(v[i]))
    frame[4] = size
    for i in range(m):
        x[i] /= size
        y[i] /= size
        u[i] /= size
        v[i] /= size
    p[:] = 0.0
    return bool(weighted_fit(kind, x, y, u, v, weights, p))


@compact
def beyond(
    kind: int, minimum: int, here: FloatArray, there: FloatArray, tuning: float, least: float, rounds: int,
    grid: FloatArray, mapped: FloatArray, weights: FloatArray,
) -> float:  # fmt: skip
    """Root mean square distance in px of where a robust fit to points maps a grid from where another model does.

    `grid` and `mapped` are (N, 2) px; the rest is as in `robust_fit`. Negative where the model cannot be fitted.
    """
    p, frame = np.empty(9), np.empty(5)
    if not robust_fit(kind, minimum, here, there, tuning, least, rounds, weights, p, frame):
        return -1.0
    size, total = frame[4], 0.0
    for i in range(grid.shape[0]):
        x, y = (grid[i, 0] - frame[0]) / size, (grid[i, 1] - frame[1]) / size
        u, v = (mapped[i, 0] - frame[2]) / size, (mapped[i, 1] - frame[3]) / size
        total += _moved(p, x, y, u, v)
    return float(size * math.sqrt(total / grid.shape[0]))


@compact
def held_out(
    kind: int, minimum: int, here: FloatArray, there: FloatArray, half: BoolArray, tuning: float, least: float,
    rounds: int,
) -> float:  # fmt: skip
    """Median residual in px of each half of the points (M, 2) from the robust fit to the other; negative without one.

    `half` (M,) marks one of the halves; the rest is as in `robust_fit`.
    """
    m = here.shape[0]
    squares = np.empty(m)
    p, frame = np.empty(9), np.empty(5)
    for part in range(2):
        count = 0
        for i in range(m):
            count += half[i] == (part == 0)
        some, other, weights = np.empty((count, 2)), np.empty((count, 2)), np.empty(count)
        count = 0
        for i in range(m):
            if half[i] == (part == 0):
                some[count, 0], some[count, 1] = here[i, 0], here[i, 1]
                other[count, 0], other[count, 1] = there[i, 0], there[i, 1]
                count += 1
        if not robust_fit(kind, minimum, some, other, tuning, least, rounds, weights, p, frame):
            return -1.0
        size = frame[4]
        for i in range(m):
            if half[i] != (part == 0):
                x, y = (here[i, 0] - frame[0]) / size, (here[i, 1] - frame[1]) / size
                u, v = (there[i, 0] - frame[2]) / size, (there[i, 1] - frame[3]) / size
                squares[i] = _moved(p, x, y, u, v) * (size * size)
    return float(middle_of(squares, m))
