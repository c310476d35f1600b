"""Compiled search for the model with the best consensus; `featreg.geometry.robust` prepares its input.

Points are four vectors (x, y, u, v): reference and secondary coordinates, both with a common centre removed. A model is
the nine elements of its matrix, row by row. Kinds: 0 translation, 1 rigid, 2 similarity, 3 affine, 4 homography.
"""

from __future__ import annotations

import math

import numpy as np

from featreg.runtime.jit import compiled
from featreg.types import FloatArray, IntArray

#: Cost of one outlier. Costs are whole numbers: their sum has no order to keep, so the loop becomes vector code.
OUTLIER = 1024


@compiled
def truncated_cost(
    p: FloatArray, projective: bool, x: FloatArray, y: FloatArray, u: FloatArray, v: FloatArray, per_t2: float
) -> int:
    """Return the truncated quadratic cost sum min(r^2 / t^2, 1), in units of 1 / OUTLIER, rounded down per point."""
    total = np.int64(0)
    if projective:
        for i in range(x.shape[0]):
            w = 1.0 / (p[6] * x[i] + p[7] * y[i] + p[8])
            dx = (p[0] * x[i] + p[1] * y[i] + p[2]) * w - u[i]
            dy = (p[3] * x[i] + p[4] * y[i] + p[5]) * w - v[i]
            d = (dx * dx + dy * dy) * per_t2
            total += np.int32((d if d < 1.0 else 1.0) * OUTLIER)
        return int(total)
    a, b, c, d0, e, f = p[0], p[1], p[2], p[3], p[4], p[5]
    for i in range(x.shape[0]):
        dx = a * x[i] + b * y[i] + c - u[i]
        dy = d0 * x[i] + e * y[i] + f - v[i]
        d = (dx * dx + dy * dy) * per_t2
        total += np.int32((d if d < 1.0 else 1.0) * OUTLIER)
    return int(total)


@compiled
def mark_inliers(
    p: FloatArray, x: FloatArray, y: FloatArray, u: FloatArray, v: FloatArray, per_t2: float, inlier: FloatArray
) -> None:
    """Write 1 where the residual is below the threshold, else 0."""
    for i in range(x.shape[0]):
        w = 1.0 / (p[6] * x[i] + p[7] * y[i] + p[8])
        dx = (p[0] * x[i] + p[1] * y[i] + p[2]) * w - u[i]
        dy = (p[3] * x[i] + p[4] * y[i] + p[5]) * w - v[i]
        inlier[i] = 1.0 if (dx * dx + dy * dy) * per_t2 < 1.0 else 0.0


@compiled
def least_squares(
    kind: int, x: FloatArray, y: FloatArray, u: FloatArray, v: FloatArray, weight: FloatArray, p: FloatArray
) -> bool:
    """Write the weighted least-squares model of kinds 0 to 3 into `p`; False where the points do not determine it."""
    n = sx = sy = su = sv = 0.0
    for i in range(x.shape[0]):
        w = weight[i]
        n += w
        sx += w * x[i]
        sy += w * y[i]
        su += w * u[i]
        sv += w * v[i]
    if n <= 0.0:
        return False
    mx, my, mu, mv = sx / n, sy / n, su / n, sv / n
    p[:] = 0.0
    p[0] = p[4] = p[8] = 1.0
    if kind > 0:
        xx = xy = yy = xu = xv = yu = yv = uu = 0.0
        for i in range(x.shape[0]):
            w = weight[i]
            if w > 0.0:
                dx, dy, du, dv = x[i] - mx, y[i] - my, u[i] - mu, v[i] - mv
                xx += w * dx * dx
                xy += w * dx * dy
                yy += w * dy * dy
                xu += w * dx * du
                xv += w * dx * dv
                yu += w * dy * du
                yv += w * dy * dv
                uu += w * (du * du + dv * dv)
        if kind == 3:
            det = xx * yy - xy * xy
            if det <= 1e-12 * (xx + yy) * (xx + yy):
                return False
            p[0] = (xu * yy - yu * xy) / det
            p[1] = (yu * xx - xu * xy) / det
            p[3] = (xv * yy - yv * xy) / det
            p[4] = (yv * xx - xv * xy) / det
        else:
            re, im = xu + yv, xv - yu
            size = math.hypot(re, im) if kind == 1 else xx + yy
            if size * size <= 1e-18 * (xx + yy) * max(uu, xx + yy):
                return False
            p[0] = p[4] = re / size
            p[3] = im / size
            p[1] = -p[3]
    p[2] = mu - (p[0] * mx + p[1] * my)
    p[5] = mv - (p[3] * mx + p[4] * my)
    return True


@compiled
def homography_of_four(x: FloatArray, y: FloatArray, u: FloatArray, v: FloatArray, p: FloatArray) -> bool:
    """Write the homography through four points into `p`, last element 1; False where there is none.

    Gaussian elimination with row pivots, coordinates first divided by their size.
    """
    rs = ss = 0.0
    for i in range(4):
        rs = max(rs, abs(x[i]), abs(y[i]))
        ss = max(ss, abs(u[i]), abs(v[i]))
    if rs == 0.0 or ss == 0.0:
        return False
    m = np.zeros((8, 9))
    for i in range(4):
        a, b, c, d = x[i] / rs, y[i] / rs, u[i] / ss, v[i] / ss
        m[2 * i, 0] = m[2 * i + 1, 3] = a
        m[2 * i, 1] = m[2 * i + 1, 4] = b
        m[2 * i, 2] = m[2 * i + 1, 5] = 1.0
        m[2 * i, 6], m[2 * i, 7], m[2 * i, 8] = -a * c, -b * c, c
        m[2 * i + 1, 6], m[2 * i + 1, 7], m[2 * i + 1, 8] = -a * d, -b * d, d
    for k in range(8):
        pivot = k
        for i in range(k + 1, 8):
            if abs(m[i, k]) > abs(m[pivot, k]):
                pivot = i
        if abs(m[pivot, k]) < 1e-12:
            return False
        for j in range(k, 9):
            m[k, j], m[pivot, j] = m[pivot, j], m[k, j]
        for i in range(k + 1, 8):
            factor = m[i, k] / m[k, k]
            for j in range(k, 9):
                m[i, j] -= factor * m[k, j]
    for k in range(7, -1, -1):
        value = m[k, 8]
        for j in range(k + 1, 8):
            value -= m[k, j] * p[j]
        p[k] = value / m[k, k]
    p[0], p[1], p[2] = p[0] * ss / rs, p[1] * ss / rs, p[2] * ss
    p[3], p[4], p[5] = p[3] * ss / rs, p[4] * ss / rs, p[5] * ss
    p[6], p[7], p[8] = p[6] / rs, p[7] / rs, 1.0
    # A camera sees its points in front of it: the four depths share one sign.
    depth = 1.0
    for i in range(4):
        depth = min(depth, p[6] * x[i] + p[7] * y[i] + 1.0)
    return depth > 0.0


@compiled
def copy_model(model: FloatArray, out: FloatArray) -> None:
    """Write the nine elements of a model; a slice would bring along the words for a shape that does not fit."""
    for i in range(9):
        out[i] = model[i]


@compiled
def well_placed(x: FloatArray, y: FloatArray, count: int, apart: float) -> bool:
    """Whether `count` points are `apart` from each other and every three of them at least as far from one line."""
    for i in range(count):
        for j in range(i + 1, count):
            a = (x[i] - x[j]) ** 2 + (y[i] - y[j]) ** 2
            if a < apart * apart:
                return False
            for k in range(j + 1, count):
                b = (x[i] - x[k]) ** 2 + (y[i] - y[k]) ** 2
                c = (x[j] - x[k]) ** 2 + (y[j] - y[k]) ** 2
                area = (x[j] - x[i]) * (y[k] - y[i]) - (x[k] - x[i]) * (y[j] - y[i])
                if area * area < apart * apart * max(a, b, c):
                    return False
    return True


@compiled
def search(
    kind: int,
    points: FloatArray,
    samples: IntArray,
    candidates: IntArray,
    threshold: float,
    apart: FloatArray,
    confidence: float,
    best: FloatArray,
    found: IntArray,
) -> None:
    """Write the model of lowest truncated cost into `best`.

    Parameters
    ----------
    kind : 0 to 4, see the module
    points : (4, M) rows x, y, u, v
    samples : (K, m) rows of the points of each hypothesis; they stand among `candidates`
    candidates : (C,) rows from which the samples were drawn; their share of inliers decides when to stop
    threshold : largest residual of an inlier, px
    apart : (2,) smallest distances within a sample, in the reference and in the secondary, px
    confidence : probability with which a sample of inliers only has been seen when the search stops
    best : (9,) the model; left alone where its cost is that of no inlier, OUTLIER * M
    found : (2,) filled with the cost and the number of hypotheses looked at
    """
    x, y, u, v = points[0], points[1], points[2], points[3]
    m = samples.shape[1]
    per_t2 = 1.0 / (threshold * threshold)
    sx, sy, su, sv, ones = np.empty(m), np.empty(m), np.empty(m), np.empty(m), np.ones(m)
    trial, polished, inlier = np.empty(9), np.empty(9), np.empty(x.shape[0])
    lowest = OUTLIER * x.shape[0]
    enough, looked = float(samples.shape[0]), 0
    for k in range(samples.shape[0]):
        if looked >= enough:
            break
        looked += 1
        for i in range(m):
            row = samples[k, i]
            sx[i], sy[i], su[i], sv[i] = x[row], y[row], u[row], v[row]
        if not (well_placed(sx, sy, m, apart[0]) and well_placed(su, sv, m, apart[1])):
            continue
        # Two inliers of a rigid model keep their distance to within two thresholds.
        if kind == 1 and (
            abs(math.hypot(sx[0] - sx[1], sy[0] - sy[1]) - math.hypot(su[0] - su[1], sv[0] - sv[1])) > 2.0 * threshold
        ):
            continue
        if kind == 4:
            if not homography_of_four(sx, sy, su, sv, trial):
                continue
        elif not least_squares(kind, sx, sy, su, sv, ones, trial):
            continue
        cost = truncated_cost(trial, kind == 4, x, y, u, v, per_t2)
        if cost >= lowest:
            continue
        lowest = cost
        copy_model(trial, best)
        mark_inliers(best, x, y, u, v, per_t2, inlier)
        if kind < 4:
            for _ in range(4):
                if not least_squares(kind, x, y, u, v, inlier, polished):
                    break
                cost = truncated_cost(polished, False, x, y, u, v, per_t2)
                if cost >= lowest:
                    break
                lowest = cost
                copy_model(polished, best)
                mark_inliers(best, x, y, u, v, per_t2, inlier)
        agreeing = 0.0
        for i in range(candidates.shape[0]):
            agreeing += inlier[candidates[i]]
        clean = (agreeing / candidates.shape[0]) ** m
        if clean >= 1.0:
            break
        if clean > 0.0:
            enough = math.log(1.0 - confidence) / math.log1p(-clean)
    found[0], found[1] = lowest, looked
