"""Compiled loops of dense local correlation; `featreg.sar.correlation` says what they compute."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.jit import compiled

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]


@compiled
def _move_window(enter_a: F32, enter_b: F32, leave_a: F32, leave_b: F32, sums: F32) -> None:
    for x in range(sums.shape[0]):
        sums[x] += enter_a[x] * enter_b[x] - leave_a[x] * leave_b[x]


@compiled
def _enter_window(enter_a: F32, enter_b: F32, sums: F32) -> None:
    for x in range(sums.shape[0]):
        sums[x] += enter_a[x] * enter_b[x]


@compiled
def _window_total(sums: F32, start: int, count: int) -> float:
    """Sum of `count` values: four running totals, so that the additions need not wait for each other."""
    a = b = c = d = np.float32(0)
    fours = count // 4 * 4
    for k in range(start, start + fours, 4):
        a += sums[k]
        b += sums[k + 1]
        c += sums[k + 2]
        d += sums[k + 3]
    for k in range(start + fours, start + count):
        a += sums[k]
    return (a + b) + (c + d)


@compiled
def product_sums(a: F32, b: F32, xs: I64, ys: I64, half: int, search: int, out: F32) -> None:
    """Fill out[i, dy, dx] with the sum over the window of a[p] * b[p + (dx, dy)] around each point, by running sums.

    Points are sorted by y and lie at least half + search pixels inside. The cost hardly grows with their number: each
    shift moves one row of column sums down the image, and a point adds up the columns of its window.
    """
    height, width = a.shape
    inner = width - 2 * search
    sums = np.zeros(inner, np.float32)
    for dy in range(-search, search + 1):
        for dx in range(-search, search + 1):
            sums[:] = 0
            first = half + search
            left = search + dx
            for y in range(first - half, first + half):
                _enter_window(a[y, search : search + inner], b[y + dy, left : left + inner], sums)
            point = 0
            for y in range(first, height - first):
                top, bottom = y - half - 1, y + half
                if y == first:
                    _enter_window(a[bottom, search : search + inner], b[bottom + dy, left : left + inner], sums)
                else:
                    _move_window(
                        a[bottom, search : search + inner],
                        b[bottom + dy, left : left + inner],
                        a[top, search : search + inner],
                        b[top + dy, left : left + inner],
                        sums,
                    )
                while point < ys.shape[0] and ys[point] == y:
                    out[point, dy + search, dx + search] = _window_total(sums, xs[point] - search - half, 2 * half + 1)
                    point += 1
