"""Brute-force nearest neighbours of descriptors."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import ParameterError
from featreg.interfaces import Nearest
from featreg.registry import register
from featreg.runtime import precompiled
from featreg.runtime.machine import processor_has
from featreg.runtime.parameters import Share
from featreg.runtime.threads import side_by_side
from featreg.types import Features, FloatArray, IntArray

# Columns of 64-bit words compared at a time.
BLOCK = 512
# Rows of squared distances held at a time; they stay in the processor's cache.
ROWS = 128
# Pairs of binary descriptors and of others from which on the rows are shared out, and into how many parts.
LARGE, LARGE_EUCLIDEAN, PARTS = 1 << 23, 1 << 20, 8
LARGEST = np.iinfo(np.uint64).max
# Most words of descriptors that are compared in bit slices.
WIDEST = 12


@register("brute-force")
@dataclass(frozen=True)
class BruteForce(Nearest):
    """The nearest secondary descriptor of every reference one: Hamming by counts of bits, L2 by matrix product.

    Parameters
    ----------
    mutual : keep a pair only where each is the other's nearest
    ratio : keep a pair only where its distance is below `ratio` times that of the second nearest; 1 keeps all

    Raises
    ------
    ParameterError
        The two sets have descriptors of different kinds or lengths, or none at all.
    """

    mutual: bool = True
    ratio: Share = 1.0

    def match_features(self, reference: Features, secondary: Features) -> tuple[IntArray, FloatArray]:
        if not len(reference) or not len(secondary):
            return np.zeros((0, 2), np.int64), np.zeros(0)
        a, b = reference.descriptors, secondary.descriptors
        if a is None or b is None or reference.norm != secondary.norm or a.shape[1] != b.shape[1]:
            raise ParameterError(
                f"brute-force needs descriptors of one kind, got {_kind(reference)}, {_kind(secondary)}"
            )
        measure = _hamming if reference.norm == "hamming" else _euclidean
        forward, backward, distance, second = measure(a, b, self.ratio < 1)
        rows = np.arange(len(a))
        keep = np.ones(len(a), np.bool_)
        if self.mutual:
            keep &= backward[forward] == rows
        if self.ratio < 1:
            keep &= distance < self.ratio * second
        pairs = np.column_stack([rows, forward])[keep]
        return pairs, _similarity(distance[keep], a.shape[1], reference.norm)


def _kind(features: Features) -> str:
    if features.descriptors is None:
        return "no descriptors"
    return f"{features.norm} of length {features.descriptors.shape[1]}"


def _similarity(distance: FloatArray, length: int, norm: str) -> FloatArray:
    """1 for equal descriptors, falling with distance."""
    return 1 - distance / (8 * length) if norm == "hamming" else 1 / (1 + distance)


Neighbours = tuple[IntArray, IntArray, FloatArray, FloatArray]


def _hamming(a: NDArray[Any], b: NDArray[Any], ratio: bool) -> Neighbours:
    from featreg.sar.keypoints import binary_kernels

    x, words = as_words(a), as_words(b)
    y = np.ascontiguousarray(words.T)
    rows = np.full(len(a), LARGEST, np.uint64)
    nearest = _by_slices(words) if x.shape[1] <= WIDEST and _slices_are_quicker() else None

    def part(start: int, stop: int) -> NDArray[np.uint64]:
        """The nearest of some rows, and the smallest (distance, row) of each column among them."""
        columns = np.full(len(b), LARGEST, np.uint64)
        if nearest is None:
            binary_kernels.nearest_hamming(x[start:stop], y, BLOCK, rows[start:stop], columns)
        else:
            nearest(x[start:stop], rows[start:stop], columns)
        # Rows were counted from the first of the part.
        return np.where(columns < LARGEST, columns + np.uint64(start), columns)

    columns = np.minimum.reduce(side_by_side([partial(part, *ends) for ends in _parts(len(a), len(b), LARGE)]))
    low = np.uint64(0xFFFFFFFF)
    forward, backward = (rows & low).astype(np.int64), (columns & low).astype(np.int64)
    distance = (rows >> np.uint64(32)).astype(np.float64)
    second = np.zeros(len(a), np.int64)
    if ratio:
        binary_kernels.second_best(x, y, forward, second)
    return forward, backward, distance, second.astype(np.float64)


@lru_cache(maxsize=1)
def _slices_are_quicker() -> bool:
    """Where AVX2 is there but no population count of its width, and the loops are prepared: numba leaves them slow."""
    from featreg.sar.keypoints import hamming_kernels as kernels

    wide = processor_has("avx2") and not processor_has("avx512vpopcntdq")
    kernel: Any = kernels.nearest_by_slices
    return wide and precompiled.prepared_here(kernel)


def _by_slices(words: NDArray[np.uint64]) -> Callable[..., None]:
    """The nearest of rows among these words (M, W) of descriptors, both ways."""
    from featreg.sar.keypoints import hamming_kernels as kernels

    slices = _aligned((-(-len(words) // kernels.COLUMNS), (64 * words.shape[1] + 1) * kernels.LANES))
    kernels.slice_bits(words, slices)

    def nearest(reference: NDArray[np.uint64], rows: NDArray[np.uint64], columns: NDArray[np.uint64]) -> None:
        kernels.nearest_by_slices(reference, slices, _aligned((kernels.MEMORY,)), rows, columns)

    return nearest


def _aligned(shape: tuple[int, ...]) -> NDArray[np.uint64]:
    """Zeros of 64 bits that begin where a line of the processor's cache does."""
    size = math.prod(shape)
    held = np.zeros(size + 7, np.uint64)
    start = -held.ctypes.data % 64 // 8
    return held[start : start + size].reshape(shape)


def _parts(rows: int, columns: int, large: int) -> list[tuple[int, int]]:
    """(first, behind the last) row of parts that threads share out, whole numbers of blocks; one of small sets."""
    count = PARTS if rows * columns >= large else 1
    step = -(-rows // (count * ROWS)) * ROWS
    return [(start, min(start + step, rows)) for start in range(0, rows, step)]


def as_words(packed: NDArray[Any]) -> NDArray[np.uint64]:
    """View (N, D) bytes as (N, W) 64-bit words, zero-padded to a multiple of four words."""
    missing = -packed.shape[1] % 32
    padded = np.pad(packed, ((0, 0), (0, missing))) if missing else np.ascontiguousarray(packed)
    return padded.view(np.uint64)


def _euclidean(a: NDArray[Any], b: NDArray[Any], ratio: bool) -> Neighbours:
    """Squared distances as one matrix product, a block of rows at a time, so that memory stays bounded.

    With [a, |a|^2, 1] and [-2b, 1, |b|^2] the product is |a|^2 + |b|^2 - 2ab.
    """
    from featreg.sar.keypoints import distance_kernels

    # Distances stay; the large common part, which would cancel in the sum, goes. Whole numbers stay whole.
    centre = np.rint(b.mean(axis=0))
    a, b = a - centre, b - centre
    n, m = len(a), len(b)
    left = np.column_stack([a, np.einsum("ij,ij->i", a, a), np.ones(n, np.float32)])
    # Rows one after the other: each block of the product would otherwise turn them anew.
    right = np.ascontiguousarray(np.column_stack([-2 * b, np.ones(m, np.float32), np.einsum("ij,ij->i", b, b)]).T)
    forward, backward = np.zeros(n, np.int64), np.full(m, -1, np.int64)
    best, column = np.empty(n, np.int32), np.full(m, np.iinfo(np.int32).max, np.int32)
    second = np.full(n, np.inf, np.float32)

    def looked_at(first: int, last: int) -> NDArray[np.int32]:
        """The nearest of some rows, and the smallest distance of each column from them."""
        block, mine = np.empty((ROWS, m), np.float32), column.copy()
        for start in range(first, last, ROWS):
            part = slice(start, min(start + ROWS, last))
            squared = block[: part.stop - start]
            np.matmul(left[part], right, out=squared)
            distance_kernels.nearest(squared.view(np.int32), forward[part], best[part], mine)
            if ratio:
                distance_kernels.second_nearest(squared, forward[part], second[part])
        return mine

    column = np.minimum.reduce(side_by_side([partial(looked_at, *ends) for ends in _parts(n, m, LARGE_EUCLIDEAN)]))
    # Of rows at the same distance from a column that is the nearest of each, the first has it.
    mine = np.flatnonzero(best == column[forward])[::-1]
    backward[forward[mine]] = mine
    distance, runner_up = (np.sqrt(np.maximum(d, 0)).astype(np.float64) for d in (best.view(np.float32), second))
    return forward, backward, distance, runner_up
