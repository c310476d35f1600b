"""Compiled loops of binary descriptors: point-pair tests and Hamming distances by population count."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled, disjoint, inlined

U64 = NDArray[np.uint64]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
I8 = NDArray[np.int8]


@compiled
def describe_level(
    flat: U8, allowed: U8, xy: NDArray[np.float64], image_width: int, image_height: int, numbers: I64,
    number: int, table: NDArray[np.int8], turns: I64, bits: U64, kept: U8,
) -> None:  # fmt: skip
    """Describe the points of one level: set bit b where the first sample of pair b is darker than the second.

    Those of `xy` (N, 2), in pixels of an image of `image_width` and `image_height`, whose `numbers` (N,) is `number`;
    `kept` (N,) becomes 1 where the pixel they fall on is `allowed` (H, W), from which all samples must lie inside.
    `flat` (H * W,) is the level row by row; `table` (T, 4, B) holds the offsets of the pairs for each turn, x of the
    first and of the second samples, then y; `turns` (N,) is the turn of each point.
    """
    height, width = allowed.shape
    count = table.shape[2]
    # Point by point from above, so that what they look at stays in the cache: the last point of each row, then the one
    # of that row before each.
    last, before = np.full(height, -1, np.int64), np.empty(xy.shape[0], np.int64)
    at = np.empty(xy.shape[0], np.int64)
    for i in range(xy.shape[0]):
        if numbers[i] != number:
            continue
        x = np.int64(np.rint((xy[i, 0] + 0.5) * width / image_width - 0.5))
        y = np.int64(np.rint((xy[i, 1] + 0.5) * height / image_height - 0.5))
        if x < 0 or y < 0 or x >= width or y >= height or allowed[y, x] == 0:
            continue
        kept[i] = 1
        at[i] = y * width + x
        before[i] = last[y]
        last[y] = i
    steps = np.empty((table.shape[0], 2 * count), np.int32)
    known = np.zeros(table.shape[0], np.bool_)
    listed, found = np.empty(xy.shape[0] + 2, np.int64), 0
    for row in range(height):
        point = np.int64(last[row])
        while point >= 0:
            listed[found] = point
            found += 1
            point = np.int64(before[point])
    listed[found : found + 2] = -1
    done = 0
    while done < found:
        i, j, k = listed[done], listed[done + 1], listed[done + 2]
        turn = turns[i]
        own = steps[turn]
        if not known[turn]:
            known[turn] = True
            _fill_steps(table[turn, 0], table[turn, 1], table[turn, 2], table[turn, 3], width, own)
        # Points of one turn share the look-up of their offsets.
        if j >= 0 and k >= 0 and turns[j] == turn and turns[k] == turn:
            _compare_three(flat, own, at[i], at[j], at[k], bits[i], bits[j], bits[k])
            done += 3
        else:
            _compare_samples(flat, own, at[i], bits[i])
            done += 1


@compiled
def _compare_samples(flat: U8, steps: NDArray[np.int32], at: int, bits: U64) -> None:
    """Write the comparisons around a pixel, by the offsets of the first samples and of the second ones."""
    middle, count = np.uint64(at), np.uint64(64 * bits.shape[0])
    for word in range(bits.shape[0]):
        value = np.uint64(0)
        for b in range(64):
            n = np.uint64(64 * word + 63 - b)
            first, second = np.uint64(steps[n]), np.uint64(steps[n + count])
            value = value + value + np.uint64(flat[middle + first] < flat[middle + second])
        bits[word] = value


@compiled
def _compare_three(
    flat: U8, steps: NDArray[np.int32], at0: int, at1: int, at2: int, bits0: U64, bits1: U64, bits2: U64
) -> None:
    """`_compare_samples` of three pixels: as many as the processor's registers hold."""
    m0, m1, m2 = np.uint64(at0), np.uint64(at1), np.uint64(at2)
    count = np.uint64(64 * bits0.shape[0])
    for word in range(bits0.shape[0]):
        v0 = v1 = v2 = np.uint64(0)
        for b in range(64):
            n = np.uint64(64 * word + 63 - b)
            first, second = np.uint64(steps[n]), np.uint64(steps[n + count])
            v0 = v0 + v0 + np.uint64(flat[m0 + first] < flat[m0 + second])
            v1 = v1 + v1 + np.uint64(flat[m1 + first] < flat[m1 + second])
            v2 = v2 + v2 + np.uint64(flat[m2 + first] < flat[m2 + second])
        bits0[word], bits1[word], bits2[word] = v0, v1, v2


@disjoint
def _fill_steps(x1: I8, x2: I8, y1: I8, y2: I8, width: int, steps: NDArray[np.int32]) -> None:
    """How far each sample of B pairs lies behind the middle in a level of so many columns: B first ones, B second."""
    wide, count = np.int32(width), np.uint64(x1.shape[0])
    for b in range(count):
        steps[b] = np.int32(x1[b]) + wide * np.int32(y1[b])
        steps[b + count] = np.int32(x2[b]) + wide * np.int32(y2[b])


@inlined
def _ones(x: np.uint64) -> np.uint64:
    """Number of set bits, in the form that compilers turn into one instruction."""
    x = x - ((x >> np.uint64(1)) & np.uint64(0x5555555555555555))
    x = (x & np.uint64(0x3333333333333333)) + ((x >> np.uint64(2)) & np.uint64(0x3333333333333333))
    x = (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (x * np.uint64(0x0101010101010101)) >> np.uint64(56)


@inlined
def lowest_byte(word: np.uint64) -> np.uint64:
    """Which byte, the first in memory being 0, holds the lowest set bit of eight bytes that are not all 0."""
    below = (word & (~word + np.uint64(1))) - np.uint64(1)
    below = below - ((below >> np.uint64(1)) & np.uint64(0x5555555555555555))
    below = (below & np.uint64(0x3333333333333333)) + ((below >> np.uint64(2)) & np.uint64(0x3333333333333333))
    below = (below + (below >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (below * np.uint64(0x0101010101010101)) >> np.uint64(59)


@compiled
def _add_distances(a: U64, words: U64, start: int, distances: U64) -> None:
    for j in range(distances.shape[0]):
        distances[j] += _ones(a[start] ^ words[j])


@compiled
def _distances_four(a0: int, a1: int, a2: int, a3: int, b0: U64, b1: U64, b2: U64, b3: U64, out: U64) -> None:
    for j in range(out.shape[0]):
        out[j] = _ones(a0 ^ b0[j]) + _ones(a1 ^ b1[j]) + _ones(a2 ^ b2[j]) + _ones(a3 ^ b3[j])


@compiled
def _add_four(a0: int, a1: int, a2: int, a3: int, b0: U64, b1: U64, b2: U64, b3: U64, out: U64) -> None:
    for j in range(out.shape[0]):
        out[j] += _ones(a0 ^ b0[j]) + _ones(a1 ^ b1[j]) + _ones(a2 ^ b2[j]) + _ones(a3 ^ b3[j])


@compiled
def _keep_best(distances: U64, i: int, base: int, columns: U64) -> np.uint64:
    """Smallest (distance, column) of a row as one number, and the running smallest (distance, row) of each column."""
    best = np.uint64(0xFFFFFFFFFFFFFFFF)
    for j in range(distances.shape[0]):
        key = distances[j] << np.uint64(32)
        best = min(best, key | np.uint64(base + j))
        columns[j] = min(columns[j], key | np.uint64(i))
    return best


@compiled
def nearest_hamming(reference: U64, secondary: U64, block: int, rows: U64, columns: U64) -> None:
    """Nearest neighbours both ways: rows[i] = distance << 32 | j, columns[j] = distance << 32 | i, ties by index.

    `reference` is (N, W) words, `secondary` (W, M), W a multiple of four; `rows` and `columns` start at the largest
    number. `block` columns are compared at a time, so that they stay in the first cache.
    """
    n, width = reference.shape
    m = secondary.shape[1]
    scratch = np.zeros(block, np.uint64)
    for start in range(0, m, block):
        stop = min(start + block, m)
        distances = scratch[: stop - start]
        for i in range(n):
            a = reference[i]
            b0, b1, b2, b3 = (
                secondary[0, start:stop],
                secondary[1, start:stop],
                secondary[2, start:stop],
                secondary[3, start:stop],
            )
            _distances_four(a[0], a[1], a[2], a[3], b0, b1, b2, b3, distances)
            for k in range(4, width, 4):
                b0, b1 = secondary[k, start:stop], secondary[k + 1, start:stop]
                b2, b3 = secondary[k + 2, start:stop], secondary[k + 3, start:stop]
                _add_four(a[k], a[k + 1], a[k + 2], a[k + 3], b0, b1, b2, b3, distances)
            best = _keep_best(distances, i, start, columns[start:stop])
            rows[i] = min(rows[i], best)


@compiled
def second_best(reference: U64, secondary: U64, taken: NDArray[np.int64], out: NDArray[np.int64]) -> None:
    """Smallest distance of each reference row to any secondary column but the `taken` one."""
    n, width = reference.shape
    m = secondary.shape[1]
    distances = np.zeros(m, np.uint64)
    for i in range(n):
        distances[:] = 0
        for k in range(width):
            _add_distances(reference[i], secondary[k], k, distances)
        distances[taken[i]] = np.uint64(1) << np.uint64(40)
        out[i] = np.int64(distances.min())
