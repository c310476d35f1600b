"""Compiled loops over the candidates of `featreg.geometry.correlated`, which says what they compute."""

from __future__ import annotations

import math

import numpy as np

from featreg.runtime.jit import compiled
from featreg.types import FloatArray, IntArray


@compiled
def shared_parts(
    distance2: FloatArray,
    variance: FloatArray,
    alone: FloatArray,
    lengths: FloatArray,
    mixtures: FloatArray,
    out: FloatArray,
) -> None:
    """Fill out[2 * k + m] (C, C) with what the means of two cells share for length k, px, and mixture m.

    Parameters
    ----------
    distance2 : (C, C) px^2 between the cells
    variance : (C,) px^2 of the places in each
    alone : (C,) 1 / number of points in each
    lengths : (K,) px
    mixtures : (M, G, 2) shares and widths of Gaussian functions; share 0 where there are fewer
    out : (K * M, C, C)
    """
    n = distance2.shape[0]
    for k in range(lengths.shape[0]):
        for m in range(mixtures.shape[0]):
            made = out[k * mixtures.shape[0] + m]
            for i in range(n):
                for j in range(i + 1):
                    value, blur = 0.0, variance[i] + variance[j]
                    for g in range(mixtures.shape[1]):
                        share = mixtures[m, g, 0]
                        if share > 0.0:
                            square = (mixtures[m, g, 1] * lengths[k]) ** 2
                            value += (
                                share * square / (square + blur) * math.exp(-0.5 * distance2[i, j] / (square + blur))
                            )
                    if i == j:
                        # A point shares all of its error with itself.
                        value = alone[i] + (1.0 - alone[i]) * value
                    made[i, j] = made[j, i] = value


@compiled
def whitened(
    own: FloatArray,
    shared: FloatArray,
    parts: FloatArray,
    both: FloatArray,
    outer: FloatArray,
    squares: FloatArray,
    logs: FloatArray,
    traces: FloatArray,
) -> bool:
    """Whiten the cells' derivatives and errors by each candidate; False where one is not positive definite.

    Parameters
    ----------
    own : (C,) variances of the cells' means without any in common
    shared : (S, C, C) what they have in common; the candidates are own alone, and own + parts[p] * shared[s]
    parts : (P,)
    both : (C, Q) derivatives and errors, those along both axes side by side; (C, 2, Q / 2) in order
    outer : (C, C) weights of the covariances whose sum is `traces`
    squares : (1 + S * P, Q / 2, Q / 2) filled with what the whitened rows give times themselves, both axes together
    logs : (1 + S * P,) filled with the sum of the logarithms of the factor's diagonal
    traces : (1 + S * P,) filled with the sum of outer * candidate
    """
    n, width = both.shape
    half = width // 2
    a, white, column = np.empty((n, n)), np.empty((n, width)), np.empty(n)
    for k in range(squares.shape[0]):
        trace = 0.0
        for i in range(n):
            for j in range(n):
                a[i, j] = parts[(k - 1) % parts.shape[0]] * shared[(k - 1) // parts.shape[0], i, j] if k > 0 else 0.0
            a[i, i] += own[i]
            for j in range(n):
                trace += outer[i, j] * a[i, j]
        traces[k] = trace
        total = 0.0
        for i in range(n):
            for q in range(width):
                white[i, q] = both[i, q]
        # Cholesky's factor by columns, each at once taken out of what is right of it and of the rows to be whitened.
        for j in range(n):
            if not a[j, j] > 0.0:
                return False
            root = math.sqrt(a[j, j])
            total += math.log(root)
            per = 1.0 / root
            for q in range(width):
                white[j, q] *= per
            for i in range(j + 1, n):
                column[i] = a[i, j] * per
            for i in range(j + 1, n):
                factor = column[i]
                for q in range(width):
                    white[i, q] -= factor * white[j, q]
                for q in range(j + 1, i + 1):
                    a[i, q] -= factor * column[q]
        logs[k] = total
        square = squares[k]
        square[:] = 0.0
        for i in range(n):
            for p in range(half):
                for q in range(half):
                    square[p, q] += white[i, p] * white[i, q] + white[i, half + p] * white[i, half + q]
    return True


@compiled
def group_sums(values: FloatArray, weights: FloatArray, group: IntArray, sums: FloatArray) -> None:
    """Add to sums[g] (G, K) the rows of values (M, K) of the points whose group is g, times their weights (M,)."""
    for i in range(values.shape[0]):
        total, weight = sums[group[i]], weights[i]
        for k in range(values.shape[1]):
            total[k] += weight * values[i, k]


@compiled
def group_normals(
    design: FloatArray, error: FloatArray, group: IntArray, normal: FloatArray, moment: FloatArray
) -> None:
    """Add to normal[g] (G, P, P) and moment[g] (G, P) the normal equations of the points whose group is g.

    `design` (M, 2, P) are the derivatives and `error` (M, 2) the errors of both coordinates of each point.
    """
    count = design.shape[2]
    for i in range(design.shape[0]):
        g = group[i]
        for axis in range(2):
            row, e = design[i, axis], error[i, axis]
            for p in range(count):
                value = row[p]
                if value != 0.0:
                    moment[g, p] += value * e
                    for q in range(count):
                        normal[g, p, q] += value * row[q]
