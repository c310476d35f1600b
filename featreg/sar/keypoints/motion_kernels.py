"""Compiled loops of grid-based motion statistics; `featreg.matchers.gms` says what they compute."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

I64 = NDArray[np.int64]
B = NDArray[np.bool_]


@compiled
def count_motions(left: I64, right: I64, counts: I64, population: I64, best: I64) -> None:
    """Count the matches of every (left cell, right cell), and find each left cell's most frequent right cell.

    Cells are -1 for matches that fall outside; ties go to the lower cell.
    """
    counts[:] = 0
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
def verify_cells(
    counts: I64, population: I64, best: I64, left_wide: int, left_high: int, right_wide: int, right_high: int,
    ring: I64, factor: float, passed: B,
) -> None:  # fmt: skip
    """Mark the left cells whose best motion is supported by the eight cells around, turned by `ring`.

    `ring` (9, 2) holds the right neighbour (dx, dy) that belongs to each left neighbour in reading order.
    """
    for a in range(best.shape[0]):
        passed[a] = False
        b = best[a]
        if b < 0:
            continue
        score, total, cells = 0, 0, 0
        for k in range(9):
            ax, ay = a % left_wide + k % 3 - 1, a // left_wide + k // 3 - 1
            bx, by = b % right_wide + ring[k, 0], b // right_wide + ring[k, 1]
            if ax < 0 or ay < 0 or ax >= left_wide or ay >= left_high:
                continue
            if bx < 0 or by < 0 or bx >= right_wide or by >= right_high:
                continue
            near = ay * left_wide + ax
            score += counts[near, by * right_wide + bx]
            total += population[near]
            cells += 1
        passed[a] = score >= factor * np.sqrt(total / cells)


@compiled
def mark_matches(left: I64, right: I64, best: I64, passed: B, keep: B) -> None:
    """Keep the matches that move as their cell's verified motion."""
    for i in range(left.shape[0]):
        a = left[i]
        if a >= 0 and right[i] >= 0 and passed[a] and best[a] == right[i]:
            keep[i] = True


@compiled
def matches_of_turns(
    lefts: I64, right: I64, left_wide: int, left_high: int, right_wide: int, right_high: int, rings: I64, factor: float,
    keep: B,
) -> None:  # fmt: skip
    """Mark in `keep` (T, M) the matches kept by each turn of `rings` (T, 9, 2) on any of the grids `lefts` (G, M)."""
    cells = left_wide * left_high
    counts = np.empty((cells, right_wide * right_high), np.int64)
    population, best, passed = np.empty(cells, np.int64), np.empty(cells, np.int64), np.empty(cells, np.bool_)
    keep[:] = False
    for grid in range(lefts.shape[0]):
        count_motions(lefts[grid], right, counts, population, best)
        for turn in range(rings.shape[0]):
            verify_cells(
                counts, population, best, left_wide, left_high, right_wide, right_high, rings[turn], factor, passed
            )
            mark_matches(lefts[grid], right, best, passed, keep[turn])
