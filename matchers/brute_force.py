"""Brute-force nearest neighbours of descriptors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import ParameterError
from featreg.interfaces import Nearest
from featreg.registry import register
from featreg.types import Features, FloatArray, IntArray

# Columns of 64-bit words compared at a time.
BLOCK = 512
LARGEST = np.iinfo(np.uint64).max


@register("brute-force")
@dataclass(frozen=True)
class BruteForce(Nearest):
    """The nearest secondary descriptor of every reference one: Hamming by population count, L2 by matrix product.

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
    ratio: float = 1.0

    def __post_init__(self) -> None:
        if not 0 < self.ratio <= 1:
            raise ParameterError(f"brute-force needs 0 < ratio <= 1, got {self.ratio}")

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
    from featreg.sar import binary_kernels

    x, y = as_words(a), np.ascontiguousarray(as_words(b).T)
    rows, columns = np.full(len(a), LARGEST, np.uint64), np.full(len(b), LARGEST, np.uint64)
    binary_kernels.nearest_hamming(x, y, BLOCK, rows, columns)
    low = np.uint64(0xFFFFFFFF)
    forward, backward = (rows & low).astype(np.int64), (columns & low).astype(np.int64)
    distance = (rows >> np.uint64(32)).astype(np.float64)
    second = np.zeros(len(a), np.int64)
    if ratio:
        binary_kernels.second_best(x, y, forward, second)
    return forward, backward, distance, second.astype(np.float64)


def as_words(packed: NDArray[Any]) -> NDArray[np.uint64]:
    """View (N, D) bytes as (N, W) 64-bit words, zero-padded to a multiple of four words."""
    missing = -packed.shape[1] % 32
    padded = np.pad(packed, ((0, 0), (0, missing))) if missing else np.ascontiguousarray(packed)
    return padded.view(np.uint64)


def _euclidean(a: NDArray[Any], b: NDArray[Any], ratio: bool) -> Neighbours:
    """Squared distances as |a|^2 + |b|^2 - 2ab, a block of rows at a time, so that memory stays bounded."""
    from featreg.sar import distance_kernels

    # Distances stay; the large common part, which would cancel in the sum, goes. Whole numbers stay whole.
    centre = np.rint(b.mean(axis=0))
    a, b = a - centre, b - centre
    n, m = len(a), len(b)
    forward, backward = np.zeros(n, np.int64), np.zeros(m, np.int64)
    best, second = np.full(n, np.inf, np.float32), np.full(n, np.inf, np.float32)
    column = np.full(m, np.inf, np.float32)
    norms = np.einsum("ij,ij->i", b, b)
    for start in range(0, n, BLOCK):
        rows = a[start : start + BLOCK]
        squared = norms - 2 * (rows @ b.T) + np.einsum("ij,ij->i", rows, rows)[:, None]
        part = slice(start, start + len(rows))
        distance_kernels.two_nearest(squared, start, forward[part], best[part], second[part], column, backward)
    distance, runner_up = (np.sqrt(np.maximum(d, 0)).astype(np.float64) for d in (best, second))
    return forward, backward, distance, runner_up
