"""Compiled loops of grid-based motion statistics; `featreg.matchers.gms` says what they compute."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
F64 = NDArray[np.float64]
B = NDArray[np.bool_]


@compiled
def cells(
    unit: F64, wide_along: float, high_along: float, dx: float, dy: float, wide: int, high: int, out: I64
) -> None:  # fmt: skip
    """Fill `out` (M,) with the cells of points (M, 2), shares of the image, on a grid moved by (dx, dy) of a cell.

    Along the axes lie `wide_along` and `high_along` cells, of which the last may be cut: `wide` and `high` are whole
    numbers of them. Outside, and of NaN, the cell is -1.
    """
    for i in range(unit.shape[0]):
        x, y = np.floor(unit[i, 0] * wide_along + dx), np.floor(unit[i, 1] * high_along + dy)
        inside = x >= 0.0 and y >= 0.0 and x < wide and y < high
        out[i] = np.int64(y) * wide + np.int64(x) if inside else -1


@compiled
def count_motions(left: I64, right: I64, counts: I32, population: I64, best: I64) -> None:
    """Count the matches of every (left cell, right cell), and find each left cell's most frequent right cell.

    `counts` holds zeros before. Cells are -1 for matches that fall outside; ties go to the lower cell.
    """
    population[:] = 0
    best[:] = -1
    for i in range(left.shape[0]):
        a, b = left[i], right[i]
        if a < 0 or b < 0:
            continue
        counts[a, b] += 1
        population[a] += 1
    for i in range(left.shape[0]):
        a, b = left[i], right[i]
        if a < 0 or b < 0:
            continue
        now = best[a]
        if now < 0 or counts[a, b] > counts[a, now] or (counts[a, b] == counts[a, now] and b < now):
            best[a] = b


@compiled
def forget_motions(left: I64, right: I64, counts: I32) -> None:
    """Set the counts of matches back to zero; most of the table never was anything else."""
    for i in range(left.shape[0]):
        if left[i] >= 0 and right[i] >= 0:
            counts[left[i], right[i]] = 0


@compiled
def verify_cells(
    counts: I32, population: I64, best: I64, left_wide: int, left_high: int, right_wide: int, right_high: int,
    rings: I64, factor: float, passed: I64,
) -> None:  # fmt: skip
    """Set bit t of the left cells whose best motion is supported by the eight cells around, turned by ring t.

    `rings` (T, 9, 2) holds the right neighbour (dx, dy) that belongs to each left neighbour in reading order.
    """
    for a in range(best.shape[0]):
        passed[a] = 0
        b = best[a]
        if b < 0:
            continue
        left_x, left_y = a % left_wide, a // left_wide
        right_x, right_y = b % right_wide, b // right_wide
        for turn in range(rings.shape[0]):
            score, total, cells = 0, 0, 0
            for k in range(9):
                ax, ay = left_x + k % 3 - 1, left_y + k // 3 - 1
                bx, by = right_x + rings[turn, k, 0], right_y + rings[turn, k, 1]
                if ax < 0 or ay < 0 or ax >= left_wide or ay >= left_high:
                    continue
                if bx < 0 or by < 0 or bx >= right_wide or by >= right_high:
                    continue
                near = ay * left_wide + ax
                score += counts[near, by * right_wide + bx]
                total += population[near]
                cells += 1
            if score >= factor * np.sqrt(total / cells):
                passed[a] |= 1 << turn


@compiled
def matches_of_turns(
    lefts: I64, right: I64, left_wide: int, left_high: int, right_wide: int, right_high: int, rings: I64, factor: float,
    keep: B,
) -> None:  # fmt: skip
    """Mark in `keep` (T, M) the matches kept by each turn of `rings` (T, 9, 2) on any of the grids `lefts` (G, M)."""
    number = left_wide * left_high
    counts = np.zeros((number, right_wide * right_high), np.int32)
    population, best, passed = np.empty(number, np.int64), np.empty(number, np.int64), np.empty(number, np.int64)
    kept = np.zeros(right.shape[0], np.int64)
    for grid in range(lefts.shape[0]):
        left = lefts[grid]
        count_motions(left, right, counts, population, best)
        verify_cells(
            counts, population, best, left_wide, left_high, right_wide, right_high, rings, factor, passed
        )  # fmt: skip
        # The matches that move as their cell's verified motion.
        for i in range(left.shape[0]):
            a = left[i]
            if a >= 0 and right[i] >= 0 and best[a] == right[i]:
                kept[i] |= passed[a]
        forget_motions(left, right, counts)
    for turn in range(rings.shape[0]):
        for i in range(right.shape[0]):
            keep[turn, i] = (kept[i] >> turn) & 1 == 1
