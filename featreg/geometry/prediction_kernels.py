"""Compiled prediction errors of fits; `featreg.geometry.correlated` and `featreg.geometry.uncertainty` say of what."""

from __future__ import annotations

import math

import numpy as np

from featreg.geometry.correlated_kernels import estimators, gathered, interval, shared_parts, whitened
from featreg.runtime.jit import compiled
from featreg.types import FloatArray

#: Candidates of less than this share of all likelihood do not count towards the interval.
UNLIKELY = 1e-5
#: What `predicted` returns.
NO_FREEDOM, UNDETERMINED, TOO_CLOSE, EXACT, KNOWN = 0, 1, 2, 3, 4


@compiled
def _in_cells(
    sums: FloatArray, place: FloatArray, variance: FloatArray, weight: FloatArray, alone: FloatArray, both: FloatArray
) -> None:
    """Fill what is known of the cells that hold tie points, in their order, from the sums of `gathered`.

    `place` (C, 2) px, `variance` (C,) px^2 of the places along either axis, `weight` (C,) sum of the weights, `alone`
    (C,) one over the number of independent points of equal weight, `both`
    (C, 2 * (P + 1)) mean derivatives along either axis and, behind each, errors.
    """
    count, c = both.shape[1] // 2 - 1, 0
    for y in range(sums.shape[0]):
        for x in range(sums.shape[1]):
            total = sums[y, x]
            if total[0] > 0.0:
                per = 1.0 / total[0]
                place[c, 0], place[c, 1] = per * total[2], per * total[3]
                middle = place[c, 0] * place[c, 0] + place[c, 1] * place[c, 1]
                variance[c] = 0.5 * max(per * total[4] - middle, 0.0)
                weight[c], alone[c] = total[0], total[1] * per * per
                both[c, count], both[c, 2 * count + 1] = per * total[5], per * total[6]
                for p in range(count):
                    both[c, p], both[c, count + 1 + p] = per * total[7 + p], per * total[7 + count + p]
                c += 1


@compiled
def _add(row: FloatArray, factor: float, other: FloatArray) -> None:
    """Add a multiple of one row to another, of which it is no part."""
    for k in range(np.uint64(row.shape[0])):
        row[k] += factor * other[k]


@compiled
def _added_product(start: float, one: FloatArray, other: FloatArray) -> float:
    """A number and the products of two rows, added in their order."""
    total = start
    for k in range(np.uint64(one.shape[0])):
        total += one[k] * other[k]
    return total


@compiled
def predicted(
    here: FloatArray, error: FloatArray, weights: FloatArray, design: FloatArray, at: FloatArray, cells: int,
    lengths: FloatArray, parts: FloatArray, mixtures: FloatArray, least: float, z: float, outside: float,
    covariance: FloatArray, numbers: FloatArray,
) -> int:  # fmt: skip
    """Fill the covariance of where a fit maps points, averaged over what the tie points may have in common.

    Parameters
    ----------
    here, error, weights, design, at : of a `featreg.geometry.uncertainty.Linearised`
    cells : along the longer side of the tie points' box
    lengths : over that side
    parts, mixtures : as of `featreg.geometry.correlated_kernels.whitened` and `shared_parts`
    least : as of `estimators`
    z, outside : of the interval that the covariance stands for
    covariance : (N, 2, 2) filled, px^2
    numbers : (4,) filled: cells with tie points, degrees of freedom, correlation length in px, sigma in px

    Returns
    -------
    `NO_FREEDOM`, `UNDETERMINED` or `TOO_CLOSE` where it cannot be told, `EXACT` where no error is left, or `KNOWN`
    """
    m, count, points = here.shape[0], design.shape[2], at.shape[0]
    low, high = np.empty(2), np.empty(2)
    for axis in range(2):
        low[axis] = high[axis] = here[0, axis]
        for i in range(m):
            low[axis], high[axis] = min(low[axis], here[i, axis]), max(high[axis], here[i, axis])
    extent = max(high[0] - low[0], high[1] - low[1])
    sums = np.empty((cells, cells, 7 + 2 * count))
    gathered(here, error, design, weights, low, max(extent, 1e-9) / cells, sums)
    n = 0
    for y in range(cells):
        for x in range(cells):
            n += 1 if sums[y, x, 0] > 0.0 else 0
    dof = 2 * n - count
    numbers[0], numbers[1], numbers[2], numbers[3] = n, dof, 0.0, 0.0
    covariance[:] = 0.0
    if dof < 1:
        return NO_FREEDOM
    place, variance, weight, alone = np.empty((n, 2)), np.empty(n), np.empty(n), np.empty(n)
    both, own = np.empty((n, 2 * (count + 1))), np.empty(n)
    _in_cells(sums, place, variance, weight, alone, both)
    means, estimator = np.empty((n, 2, count)), np.empty((count, n, 2))
    distance2 = np.empty((n, n))
    for c in range(n):
        own[c] = 1.0 / weight[c]
        for axis in range(2):
            for p in range(count):
                means[c, axis, p] = both[c, axis * (count + 1) + p]
        for d in range(n):
            distance2[c, d] = (place[c, 0] - place[d, 0]) ** 2 + (place[c, 1] - place[d, 1]) ** 2
    if not estimators(weight, means, least, estimator):
        return UNDETERMINED
    shared = np.empty((lengths.shape[0] * mixtures.shape[0], n, n))
    tried = np.empty(lengths.shape[0])
    for k in range(lengths.shape[0]):
        tried[k] = lengths[k] * extent
    shared_parts(distance2, variance, alone, tried, mixtures, shared)
    # How much a shift of each cell along each axis moves each mapped point along each axis.
    moved, outer = np.zeros((4 * points, n)), np.zeros((n, n))
    for i in range(points):
        for axis in range(2):
            for p in range(count):
                for along in range(2):
                    line = moved[4 * i + 2 * axis + along]
                    for c in range(n):
                        line[c] += at[i, axis, p] * estimator[p, c, along]
    for i in range(4 * points):
        for c in range(n):
            _add(outer[c], moved[i, c], moved[i])
    many, kinds = 1 + shared.shape[0] * parts.shape[0], parts.shape[0]
    left, logs, share = np.empty(many), np.empty(many), np.empty(many)
    if not whitened(own, shared, parts, both, left, logs):
        return TOO_CLOSE
    largest = 0.0
    for k in range(many):
        left[k] /= dof
        largest = max(largest, left[k])
    if not largest > 0.0:
        return EXACT
    best = -math.inf
    for k in range(many):
        share[k] = -0.5 * (logs[k] + dof * math.log(max(left[k], 1e-30 * largest)))
        best = max(best, share[k])
    total = 0.0
    for k in range(many):
        # As likely beforehand: no correlation, and all candidates with one together.
        share[k] = math.exp(share[k] - best) / (1.0 if k == 0 else many - 1.0)
        total += share[k]
    # What the cells have in common by all candidates, and what each alone makes of the error of the mapped points.
    common, trace = np.zeros((n, n)), np.empty(many)
    together = 0.0
    trace[0] = 0.0
    for c in range(n):
        trace[0] += own[c] * outer[c, c]
    length = power = 0.0
    for k in range(many):
        share[k] /= total
        together += share[k] * left[k]
        part = parts[(k - 1) % kinds] if k > 0 else 0.0
        power += share[k] * left[k] * (1.0 + part)
        if k > 0:
            length += share[k] * tried[(k - 1) // (kinds * mixtures.shape[0])]
    for s in range(shared.shape[0]):
        weighed = one = 0.0
        for k in range(kinds):
            weighed += share[1 + s * kinds + k] * left[1 + s * kinds + k] * parts[k]
        for c in range(n):
            one = _added_product(one, shared[s, c], outer[c])
            _add(common[c], weighed, shared[s, c])
        for k in range(kinds):
            trace[1 + s * kinds + k] = trace[0] + parts[k] * one
    for c in range(n):
        common[c, c] += own[c] * together
    half = np.empty(n)
    for i in range(points):
        for axis in range(2):
            for along in range(2):
                half[:] = 0.0
                for c in range(n):
                    _add(half, moved[4 * i + 2 * axis + along, c], common[c])
                for other in range(2):
                    so_far = covariance[i, axis, other]
                    covariance[i, axis, other] = _added_product(so_far, half, moved[4 * i + 2 * other + along])
    # The candidates' variances over their mean, of those that are likely at all.
    middle = likely = 0.0
    for k in range(many):
        middle += share[k] * left[k] * trace[k]
        likely += share[k] if share[k] > UNLIKELY else 0.0
    if middle > 0.0:
        variances, shares, held = np.empty(many), np.empty(many), 0
        for k in range(many):
            if share[k] > UNLIKELY:
                variances[held] = max(left[k] * trace[k] / middle, 1e-12)
                shares[held] = share[k] / likely
                held += 1
        widened = interval(variances[:held], shares[:held], z, outside)
        for i in range(points):
            for axis in range(2):
                for other in range(2):
                    covariance[i, axis, other] *= widened * widened
    numbers[2], numbers[3] = length, math.sqrt(power)
    return KNOWN


@compiled
def derived(kind: int, m: FloatArray, xy: FloatArray, unit: FloatArray, mapped: FloatArray, out: FloatArray) -> None:
    """Fill the derivatives of the mapped points by the parameters of a matrix model, and where it maps them.

    Parameters
    ----------
    kind : 0 to 4, as `featreg.geometry.robust_kernels` has it
    m : (3, 3) the model
    xy : (N, 2) px
    unit : (6,) the centres of the points of the fit in both images, and the two scales, px
    mapped : (N, 2) filled, px
    out : (N, 2, P) filled, in units of the fit
    """
    for i in range(xy.shape[0]):
        x, y = xy[i, 0], xy[i, 1]
        depth = m[2, 0] * x + m[2, 1] * y + m[2, 2] if kind == 4 else 1.0
        u = (m[0, 0] * x + m[0, 1] * y + m[0, 2]) / depth
        v = (m[1, 0] * x + m[1, 1] * y + m[1, 2]) / depth
        mapped[i, 0], mapped[i, 1] = u, v
        x, y = (x - unit[0]) / unit[4], (y - unit[1]) / unit[4]
        u, v = (u - unit[2]) / unit[5], (v - unit[3]) / unit[5]
        one, other = out[i, 0], out[i, 1]
        one[:] = 0.0
        other[:] = 0.0
        if kind < 3:
            one[0] = other[1] = 1.0
            if kind > 0:
                one[2], other[2] = v, -u
            if kind > 1:
                one[3], other[3] = u, v
        else:
            per = 1.0 / depth
            one[0] = other[3] = per
            one[1] = other[4] = x * per
            one[2] = other[5] = y * per
            if kind == 4:
                one[6], one[7] = -u * x * per, -u * y * per
                other[6], other[7] = -v * x * per, -v * y * per
