"""Compiled loops over the candidates of `featreg.geometry.correlated`, which says what they compute."""

from __future__ import annotations

import math

import numpy as np

from featreg.geometry.cholesky_kernels import factor_in_place, solve_in_place
from featreg.runtime.jit import compact, compiled
from featreg.types import FloatArray, IntArray

#: exp(-x) of more than this is nothing beside 1.
NOTHING = 36.0


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
                            far = 0.5 * distance2[i, j] / (square + blur)
                            if far < NOTHING:
                                value += share * square / (square + blur) * math.exp(-far)
                    if i == j:
                        # A point shares all of its error with itself.
                        value = alone[i] + (1.0 - alone[i]) * value
                    made[i, j] = made[j, i] = value


@compiled
def estimators(weight: FloatArray, design: FloatArray, least: float, out: FloatArray) -> bool:
    """Fill out (P, C, 2) with what an error of each coordinate of each cell adds to each parameter of the fit.

    `weight` (C,) and `design` (C, 2, P) are those of the cells. False where they do not determine the parameters: a
    pivot of the normal equations is at most `least` of what it was.
    """
    cells, _, count = design.shape
    normal, column = np.zeros((count, count)), np.empty(count)
    for c in range(cells):
        for axis in range(2):
            for p in range(count):
                value = weight[c] * design[c, axis, p]
                if value != 0.0:
                    for q in range(count):
                        normal[p, q] += value * design[c, axis, q]
    if not factor_in_place(normal, least):
        return False
    for c in range(cells):
        for axis in range(2):
            for p in range(count):
                column[p] = weight[c] * design[c, axis, p]
            solve_in_place(normal, column)
            for p in range(count):
                out[p, c, axis] = column[p]
    return True


@compiled
def whitened(
    own: FloatArray, shared: FloatArray, parts: FloatArray, both: FloatArray, left: FloatArray, logs: FloatArray
) -> bool:
    """Fit the cells' errors by their derivatives under each candidate; False where one is not positive definite.

    Parameters
    ----------
    own : (C,) variances of the cells' means without any in common
    shared : (S, C, C) what they have in common; the candidates are own alone, and own + parts[p] * shared[s]
    parts : (P,)
    both : (C, Q) derivatives and errors, those along both axes side by side; (C, 2, Q / 2) in order
    left : (1 + S * P,) filled with the sum of squares of the whitened errors that the fit leaves
    logs : (1 + S * P,) filled with the logarithm of the determinant of the candidate, of both axes together, and of the
        normal equations
    """
    n, width = both.shape
    half, wide = width // 2, n + width
    # Each row of a candidate, and behind it what is to be whitened: one loop eliminates both.
    rows = np.empty(n * wide)
    square, information, moment = np.empty((half, half)), np.empty((half - 1, half - 1)), np.empty(half - 1)
    for k in range(left.shape[0]):
        for i in range(n):
            here = np.uint64(i * wide)
            if k > 0:
                part, common = parts[(k - 1) % parts.shape[0]], shared[(k - 1) // parts.shape[0]]
                for j in range(np.uint64(n)):
                    rows[here + j] = part * common[i, j]
            else:
                for j in range(np.uint64(n)):
                    rows[here + j] = 0.0
            rows[here + np.uint64(i)] += own[i]
            for q in range(width):
                rows[here + np.uint64(n + q)] = both[i, q]
        total = 0.0
        square[:] = 0.0
        for j in range(n):
            middle = np.uint64(j * wide + j)
            pivot = rows[middle]
            if not pivot > 0.0:
                return False
            total += 2.0 * math.log(pivot)
            per = 1.0 / pivot
            for i in range(j + 1, n):
                factor = per * rows[middle + np.uint64(i - j)]
                below = middle + np.uint64((i - j) * wide)
                # The matrix stays symmetric: what is left of its diagonal is not needed.
                for q in range(np.uint64(i - j), np.uint64(wide - j)):
                    rows[below + q] -= factor * rows[middle + q]
            first = np.uint64(j * wide + n)
            for p in range(half):
                x, y = per * rows[first + np.uint64(p)], per * rows[first + np.uint64(half + p)]
                for q in range(p, half):
                    square[p, q] += x * rows[first + np.uint64(q)] + y * rows[first + np.uint64(half + q)]
        for p in range(half - 1):
            moment[p] = square[p, half - 1]
            for q in range(p, half - 1):
                information[p, q] = information[q, p] = square[p, q]
        if not factor_in_place(information, 0.0):
            return False
        solve_in_place(information, moment)
        rest = square[half - 1, half - 1]
        for p in range(half - 1):
            rest -= moment[p] * square[p, half - 1]
            total += 2.0 * math.log(information[p, p])
        left[k], logs[k] = max(rest, 0.0), total
    return True


@compiled
def interval(variances: FloatArray, share: FloatArray, z: float, outside: float) -> float:
    """Standard deviation times `z` beyond which an error lies with the chance `outside`, of a mixture of normal ones.

    `variances` (K,) > 0 and `share` (K,), whose sum is 1, are those of the mixture.
    """
    # What lies outside falls along a curve that bends upwards: Newton's steps come from below and never go beyond.
    least = variances[0]
    for k in range(variances.shape[0]):
        least = min(least, variances[k])
    width = math.sqrt(least)
    for _ in range(50):
        beyond, slope = -outside, 0.0
        for k in range(share.shape[0]):
            per = z / math.sqrt(2.0 * variances[k])
            within = per * width
            beyond += share[k] * math.erfc(within)
            slope += share[k] * (2.0 / math.sqrt(math.pi)) * per * math.exp(-within * within)
        step = beyond / slope
        width += step
        if step < 1e-9 * width:
            break
    return width


@compiled
def gathered(
    here: FloatArray, error: FloatArray, design: FloatArray, weights: FloatArray, low: FloatArray, side: float,
    sums: FloatArray,
) -> None:  # fmt: skip
    """Add up the tie points of each cell.

    Parameters
    ----------
    here, error : (M, 2) px, their places and errors
    design : (M, 2, P) derivatives
    weights : (M,)
    low, side : (2,) px, the corner of the box, and the side of a cell
    sums : (G, G, 7 + 2 P) filled, for the cells of each row and column: of the weights, of their squares, and, times
        the weights, of the places from the corner (x, y) and their squared lengths, of the errors, of the derivatives
    """
    last, count = sums.shape[0] - 1, design.shape[2]
    sums[:] = 0.0
    for i in range(here.shape[0]):
        # Places from the corner of the box, so that their variance keeps its digits.
        x, y, w = here[i, 0] - low[0], here[i, 1] - low[1], weights[i]
        total = sums[min(int(y / side), last), min(int(x / side), last)]
        total[0] += w
        total[1] += w * w
        total[2] += w * x
        total[3] += w * y
        total[4] += w * (x * x + y * y)
        total[5] += w * error[i, 0]
        total[6] += w * error[i, 1]
        for p in range(count):
            total[7 + p] += w * design[i, 0, p]
            total[7 + count + p] += w * design[i, 1, p]


@compact
def left_out(
    design: FloatArray, error: FloatArray, group: IntArray, groups: int, at: FloatArray, least: float, out: FloatArray
) -> int:
    """Sum up how far fits without one group of points after another move other points.

    Parameters
    ----------
    design, error : (M, 2, P) derivatives and (M, 2) errors of both coordinates of each point
    group, groups : (M,) numbers below `groups`
    at : (N, 2, P) derivatives of the other points
    least : a fit fails where a pivot of its normal equations is at most so much of what it was
    out : (N, 2, 2) filled with the sum over groups of d d^T, d being the departure from the mean of all fits

    Returns
    -------
    number of groups that hold a point, with nothing filled where these are fewer than 3; -1 where a fit fails
    """
    count = design.shape[2]
    normal, moment, many = np.zeros((groups, count, count)), np.zeros((groups, count)), np.zeros(groups)
    group_normals(design, error, group, normal, moment)
    for i in range(group.shape[0]):
        many[group[i]] += 1
    held = 0
    total, wanted, mean = np.zeros((count, count)), np.zeros(count), np.zeros(count)
    for g in range(groups):
        held += 1 if many[g] > 0 else 0
        for p in range(count):
            wanted[p] += moment[g, p]
            for q in range(count):
                total[p, q] += normal[g, p, q]
    if held < 3:
        return int(held)
    for g in range(groups):
        if many[g] > 0:
            for p in range(count):
                moment[g, p] = wanted[p] - moment[g, p]
                for q in range(count):
                    normal[g, p, q] = total[p, q] - normal[g, p, q]
            if not factor_in_place(normal[g], least):
                return -1
            solve_in_place(normal[g], moment[g])
            for p in range(count):
                mean[p] += moment[g, p] / held
    out[:] = 0.0
    for g in range(groups):
        if many[g] > 0:
            for i in range(at.shape[0]):
                x = y = 0.0
                for p in range(count):
                    step = moment[g, p] - mean[p]
                    x += at[i, 0, p] * step
                    y += at[i, 1, p] * step
                out[i, 0, 0] += x * x
                out[i, 0, 1] += x * y
                out[i, 1, 0] += x * y
                out[i, 1, 1] += y * y
    return int(held)


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
