"""Compiled fit of the coefficients of `featreg.geometry.residual_field`, which says what they are.

Each spline meets only those within three rows of its own, so that the normal equations are a band along the diagonal: a
matrix a of N unknowns is kept as (N, W + 1) numbers a[j + d, j] in row j and column d. No library's threads take part.
"""

from __future__ import annotations

import math

import numpy as np

from featreg.runtime.jit import compiled, disjoint, inlined
from featreg.types import FloatArray, IntArray


@disjoint
def _taken_off(band: FloatArray, at: int, pivot: FloatArray, reach: int) -> None:
    """Take the product of a factor's column, from its diagonal on, with itself off what follows it."""
    first, past = np.uint64(at), np.uint64(reach)
    for d in range(np.uint64(1), past):
        share, row = pivot[d], first + d
        for k in range(past - d):
            band[row, k] -= share * pivot[d + k]


@compiled
def factorised(band: FloatArray) -> bool:
    """Put Cholesky's factor of a band in its place; False where it is not positive."""
    count, wide = band.shape
    pivot = np.empty(wide)
    for j in range(count):
        if not band[j, 0] > 0.0:
            return False
        root = math.sqrt(band[j, 0])
        reach = min(wide, count - j)
        for d in range(reach):
            band[j, d] /= root
            pivot[d] = band[j, d]
        _taken_off(band, j, pivot, reach)
    return True


@compiled
def solved(factor: FloatArray, right: FloatArray) -> None:
    """Put the solution in the place of right-hand sides (N, 2), by what `factorised` made of the band."""
    count, wide = factor.shape
    for j in range(count):
        x, y = right[j, 0] / factor[j, 0], right[j, 1] / factor[j, 0]
        right[j, 0], right[j, 1] = x, y
        for d in range(1, min(wide, count - j)):
            right[j + d, 0] -= factor[j, d] * x
            right[j + d, 1] -= factor[j, d] * y
    for j in range(count - 1, -1, -1):
        x, y = right[j, 0], right[j, 1]
        for d in range(1, min(wide, count - j)):
            x -= factor[j, d] * right[j + d, 0]
            y -= factor[j, d] * right[j + d, 1]
        right[j, 0], right[j, 1] = x / factor[j, 0], y / factor[j, 0]


@compiled
def gathered(
    first: IntArray, values: FloatArray, residual: FloatArray, weights: FloatArray, fold: IntArray, columns: int,
    normal: FloatArray, right: FloatArray,
) -> None:  # fmt: skip
    """Add the points of each fold to its normal equations.

    Parameters
    ----------
    first : (M, 2) numbers of the first of four columns and of four rows of splines that are not zero at each point
    values : (M, 2, 4) what those are there
    residual, weights, fold : (M, 2), (M,), (M,)
    columns : of splines
    normal, right : (F, N, W + 1) and (F, N, 2), zeros
    """
    value, place = np.empty(16), np.empty(16, np.int64)
    for i in range(len(weights)):
        for r in range(4):
            for c in range(4):
                value[4 * r + c] = values[i, 1, r] * values[i, 0, c]
                place[4 * r + c] = (first[i, 1] + r) * columns + first[i, 0] + c
        f = fold[i]
        for k in range(16):
            heavy, j = weights[i] * value[k], place[k]
            right[f, j, 0] += heavy * residual[i, 0]
            right[f, j, 1] += heavy * residual[i, 1]
            for m in range(k, 16):
                normal[f, j, place[m] - j] += heavy * value[m]


@inlined
def _at(first: IntArray, values: FloatArray, columns: int, field: FloatArray, i: int) -> tuple[float, float]:
    """What a field (N, 2) is at a point."""
    x = y = 0.0
    for r in range(4):
        for c in range(4):
            j = (first[i, 1] + r) * columns + first[i, 0] + c
            value = values[i, 1, r] * values[i, 0, c]
            x += value * field[j, 0]
            y += value * field[j, 1]
    return x, y


@compiled
def displaced(first: IntArray, values: FloatArray, columns: int, field: FloatArray, out: FloatArray) -> None:
    """Fill (M, 2) with what a field (N, 2) is at points; the others as of `gathered`."""
    for i in range(len(out)):
        out[i, 0], out[i, 1] = _at(first, values, columns, field, i)


@compiled
def missed(
    first: IntArray, values: FloatArray, residual: FloatArray, weights: FloatArray, fold: IntArray, columns: int,
    which: int, field: FloatArray,
) -> float:  # fmt: skip
    """Weighted sum over the points of a fold of the squared distance of their residuals from a field (N, 2)."""
    total = 0.0
    for i in range(len(weights)):
        if fold[i] == which:
            x, y = _at(first, values, columns, field, i)
            total += weights[i] * ((x - residual[i, 0]) ** 2 + (y - residual[i, 1]) ** 2)
    return total


@compiled
def smoothed(
    first: IntArray, values: FloatArray, residual: FloatArray, weights: FloatArray, fold: IntArray, columns: int,
    penalty: FloatArray, ridge: float, strengths: FloatArray, worse: float, out: FloatArray,
) -> bool:  # fmt: skip
    """Fill `out` with the field at the smoothing that foretells best each fold that is left out.

    Parameters
    ----------
    first, values, residual, weights, fold, columns : as of `gathered`
    penalty : (N, W + 1) band
    ridge : added to the diagonal, over its mean of the points
    strengths : (S,) of the penalty, over that mean, the strongest first
    worse : how many times the least miss ends the search
    out : (N, 2) px

    Returns
    -------
    False where the points and the ridge do not determine the field
    """
    count, wide = penalty.shape
    folds = 1
    for f in fold:
        folds = max(folds, f + 1)
    normal, right = np.zeros((folds, count, wide)), np.zeros((folds, count, 2))
    gathered(first, values, residual, weights, fold, columns, normal, right)
    points = np.zeros(folds, np.int64)
    for i in range(len(fold)):
        points[fold[i]] += 1
    whole, moment, band, unit = np.zeros((count, wide)), np.zeros((count, 2)), np.empty((count, wide)), 0.0
    for f in range(folds):
        for j in range(count):
            for d in range(wide):
                whole[j, d] += normal[f, j, d]
            moment[j, 0] += right[f, j, 0]
            moment[j, 1] += right[f, j, 1]
            unit += normal[f, j, 0] / count
    chosen, best = strengths[len(strengths) - 1], math.inf
    for strength in strengths:
        lost = 0.0
        for f in range(folds):
            if 0 < points[f] < len(fold):
                for j in range(count):
                    for d in range(wide):
                        band[j, d] = whole[j, d] + strength * unit * penalty[j, d] - normal[f, j, d]
                    band[j, 0] += ridge * unit
                    out[j, 0], out[j, 1] = moment[j, 0] - right[f, j, 0], moment[j, 1] - right[f, j, 1]
                if not factorised(band):
                    return False
                solved(band, out)
                lost += missed(first, values, residual, weights, fold, columns, f, out)
        if lost < best:
            chosen, best = strength, lost
        elif lost > worse * best:
            # Rougher fields only get worse from here.
            break
    for j in range(count):
        for d in range(wide):
            band[j, d] = whole[j, d] + chosen * unit * penalty[j, d]
        band[j, 0] += ridge * unit
        out[j, 0], out[j, 1] = moment[j, 0], moment[j, 1]
    if not factorised(band):
        return False
    solved(band, out)
    return True
