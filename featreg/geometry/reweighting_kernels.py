"""Compiled rounds of iteratively reweighted least squares; `featreg.geometry.robust` says what they compute.

Kinds and the nine elements of a model are those of `featreg.geometry.robust_kernels`.
"""

from __future__ import annotations

import math

import numpy as np

from featreg.geometry.cholesky_kernels import factor_in_place, solve_in_place
from featreg.geometry.robust_kernels import least_squares
from featreg.runtime.jit import compiled
from featreg.types import FloatArray

#: Most Gauss-Newton steps of a homography, and the relative fall of its cost below which it is found.
STEPS, GAIN = 10, 1e-12


@compiled
def middle_of(values: FloatArray, count: int) -> float:
    """Return the median of the first `count` values, which are put in another order (Hoare's selection)."""
    k = count // 2
    low, high = 0, count - 1
    while low < high:
        pivot = values[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while pivot < values[j]:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if k <= j:
            high = j
        elif k >= i:
            low = i
        else:
            break
    upper = values[k]
    if count % 2 == 1:
        return math.sqrt(upper)
    lower = values[0]
    for i in range(1, k):
        lower = max(lower, values[i])
    return 0.5 * (math.sqrt(lower) + math.sqrt(upper))


@compiled
def reprojection_cost(
    h: FloatArray, x: FloatArray, y: FloatArray, u: FloatArray, v: FloatArray, weight: FloatArray
) -> float:
    """Return the weighted sum of squared reprojection errors of a homography whose last element is 1."""
    cost = 0.0
    for i in range(x.shape[0]):
        w = 1.0 / (h[6] * x[i] + h[7] * y[i] + 1.0)
        a = (h[0] * x[i] + h[1] * y[i] + h[2]) * w - u[i]
        b = (h[3] * x[i] + h[4] * y[i] + h[5]) * w - v[i]
        cost += weight[i] * (a * a + b * b)
    return cost


@compiled
def reprojection_minimum(
    h: FloatArray, x: FloatArray, y: FloatArray, u: FloatArray, v: FloatArray, weight: FloatArray
) -> bool:
    """Move a homography, last element 1, to the least weighted reprojection error by Gauss-Newton steps.

    Coordinates are of the order of 1. A step that does not lower the cost ends the search; False where a step cannot
    be made.
    """
    normal, step, trial = np.empty((8, 8)), np.empty(8), h.copy()
    row = np.empty((2, 8))
    cost = reprojection_cost(h, x, y, u, v, weight)
    for _ in range(STEPS):
        if not math.isfinite(cost):
            return False
        if cost < 1e-28 * x.shape[0]:
            return True
        normal[:], step[:] = 0.0, 0.0
        row[:] = 0.0
        for i in range(x.shape[0]):
            if weight[i] <= 0.0:
                continue
            w = 1.0 / (h[6] * x[i] + h[7] * y[i] + 1.0)
            a = (h[0] * x[i] + h[1] * y[i] + h[2]) * w
            b = (h[3] * x[i] + h[4] * y[i] + h[5]) * w
            row[0, 0] = row[1, 3] = x[i] * w
            row[0, 1] = row[1, 4] = y[i] * w
            row[0, 2] = row[1, 5] = w
            row[0, 6], row[0, 7] = -x[i] * w * a, -y[i] * w * a
            row[1, 6], row[1, 7] = -x[i] * w * b, -y[i] * w * b
            da, db = (u[i] - a) * weight[i], (v[i] - b) * weight[i]
            for j in range(8):
                step[j] += row[0, j] * da + row[1, j] * db
                for k in range(j + 1):
                    normal[j, k] += weight[i] * (row[0, j] * row[0, k] + row[1, j] * row[1, k])
        if not factor_in_place(normal, 1e-14):
            return False
        solve_in_place(normal, step)
        for j in range(8):
            trial[j] = h[j] + step[j]
        new = reprojection_cost(trial, x, y, u, v, weight)
        if not new < cost:
            return True
        gain, cost = cost - new, new
        for j in range(8):
            h[j] = trial[j]
        if gain < GAIN * cost:
            return True
    return True


@compiled
def weighted_fit(
    kind: int, x: FloatArray, y: FloatArray, u: FloatArray, v: FloatArray, weight: FloatArray, p: FloatArray
) -> bool:
    """Write the weighted least-squares model into `p`; a homography starts from `p` where `p[8]` is 1, else affine."""
    if kind < 4:
        return bool(least_squares(kind, x, y, u, v, weight, p))
    if p[8] != 1.0 and not least_squares(3, x, y, u, v, weight, p):
        return False
    if not reprojection_minimum(p, x, y, u, v, weight):
        return False
    nearest = 1.0
    for i in range(x.shape[0]):
        if weight[i] > 0.0:
            nearest = min(nearest, p[6] * x[i] + p[7] * y[i] + 1.0)
    return nearest > 0.0


@compiled
def reweighted(
    kind: int,
    minimum: int,
    reference: FloatArray,
    secondary: FloatArray,
    prior: FloatArray,
    tuning: float,
    least_scale: float,
    iterations: int,
    final: FloatArray,
) -> int:
    """Write the weights of the last round into `final` and return 1; 0 where a fit fails, or an input is unfit.

    Parameters
    ----------
    kind : 0 to 4
    minimum : points that the model needs
    reference, secondary : (M, 2) px
    prior : (M,) weights
    tuning : Tukey's constant over the median length of an error of unit standard deviation
    least_scale : smallest median of the residuals, px
    iterations : most rounds
    final : (M,) prior weight times biweight
    """
    m = reference.shape[0]
    x, y, u, v = np.empty(m), np.empty(m), np.empty(m), np.empty(m)
    used, total, largest = 0, 0.0, 0.0
    for i in range(m):
        if not (prior[i] >= 0.0 and prior[i] < 1e300):
            return 0
        if prior[i] > 0.0:
            used += 1
            total += prior[i]
            largest = max(largest, prior[i])
    if used < minimum or not total < 1e300:
        return 0
    # Centred and of the order of 1: for the homography's steps.
    cx = cy = cu = cv = size = 0.0
    for i in range(m):
        cx += reference[i, 0] / m
        cy += reference[i, 1] / m
        cu += secondary[i, 0] / m
        cv += secondary[i, 1] / m
    for i in range(m):
        x[i], y[i] = reference[i, 0] - cx, reference[i, 1] - cy
        u[i], v[i] = secondary[i, 0] - cu, secondary[i, 1] - cv
        size = max(size, abs(x[i]), abs(y[i]), abs(u[i]), abs(v[i]))
    if not (size > 0.0 and size < 1e12):
        return 0
    for i in range(m):
        x[i] /= size
        y[i] /= size
        u[i] /= size
        v[i] /= size
    mean = total / used
    p, squares, some = np.zeros(9), np.empty(m), np.empty(m)
    for i in range(m):
        final[i] = prior[i]
    for _ in range(iterations):
        if not weighted_fit(kind, x, y, u, v, final, p):
            return 0
        used = 0
        for i in range(m):
            w = 1.0 / (p[6] * x[i] + p[7] * y[i] + p[8])
            a = (p[0] * x[i] + p[1] * y[i] + p[2]) * w - u[i]
            b = (p[3] * x[i] + p[4] * y[i] + p[5]) * w - v[i]
            squares[i] = (a * a + b * b) * (prior[i] / mean)
            if prior[i] > 0.0:
                some[used] = squares[i]
                used += 1
        scale = max(middle_of(some, used), least_scale / size) * tuning
        per = 1.0 / (scale * scale)
        changed, left = 0.0, 0
        for i in range(m):
            t = max(1.0 - squares[i] * per, 0.0)
            now = prior[i] * (t * t)
            changed = max(changed, abs(now - final[i]))
            final[i] = now
            left += now > 0.0
        if left < minimum:
            return 0
        if changed <= 1e-9 * largest:
            break
    return 1
