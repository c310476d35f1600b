"""Compiled loops over matches that are measured again: where to look, and how far off what is found may be."""

from __future__ import annotations

import numpy as np

from featreg.runtime.jit import compiled
from featreg.types import FloatArray, IntArray


@compiled
def starts(
    reference_xy: FloatArray, secondary_xy: FloatArray, rows: IntArray, forth: FloatArray, back: FloatArray,
    farthest: float, reach: int, width: int, height: int, at: IntArray, offset: IntArray, kept: IntArray,
) -> int:  # fmt: skip
    """Write the whole pixels, the whole offsets from a model and the rows of matches that can be measured; how many.

    `reference_xy`, `secondary_xy` (M, 2) px; `forth` (2, 3) is the model, an affine map, and `back` (2, 2) the inverse
    of its linear part. Those of `rows` (N,) are looked at; of each that lies within `farthest` px along x and y of the
    model and whose windows, `reach` px to each side, lie inside of a grid of `width` and `height`, `at` and `offset`
    (N, 2) and `kept` (N,) get what is said above.
    """
    count = 0
    for i in range(rows.shape[0]):
        row = rows[i]
        x, y = reference_xy[row, 0], reference_xy[row, 1]
        away = secondary_xy[row, 0] - ((forth[0, 0] * x + forth[0, 1] * y) + forth[0, 2])
        beside = secondary_xy[row, 1] - ((forth[1, 0] * x + forth[1, 1] * y) + forth[1, 2])
        along, down = back[0, 0] * away + back[0, 1] * beside, back[1, 0] * away + back[1, 1] * beside
        if not (abs(along) <= farthest and abs(down) <= farthest):
            continue
        u, v = np.int64(np.rint(x)), np.int64(np.rint(y))
        du, dv = np.int64(np.rint(along)), np.int64(np.rint(down))
        inside = u >= reach and v >= reach and u < width - reach and v < height - reach
        there = u + du >= reach and v + dv >= reach and u + du < width - reach and v + dv < height - reach
        if inside and there:
            at[count, 0], at[count, 1] = u, v
            offset[count, 0], offset[count, 1] = du, dv
            kept[count] = row
            count += 1
    return count


@compiled
def covariances(height: FloatArray, curvature: FloatArray, linear: FloatArray, out: FloatArray) -> None:
    """(1 - rho^2) A C^-1 A^T of peaks of height rho (N,) and curvature C (N, 2, 2) to `out` (N, 2, 2).

    A is `linear` (1 or N, 2, 2). Where C has no inverse what is written is not finite.
    """
    for i in range(height.shape[0]):
        a, b, c, d = curvature[i, 0, 0], curvature[i, 0, 1], curvature[i, 1, 0], curvature[i, 1, 1]
        k = i if linear.shape[0] > 1 else 0
        left = max(1 - height[i] * height[i], 1e-6)
        determinant = a * d - b * c
        if determinant == 0:
            out[i] = np.nan
            continue
        xx, xy = left * (d / determinant), left * (-b / determinant)
        yx, yy = left * (-c / determinant), left * (a / determinant)
        for row in range(2):
            p, q = linear[k, row, 0], linear[k, row, 1]
            u, v = p * xx + q * yx, p * xy + q * yy
            for column in range(2):
                out[i, row, column] = u * linear[k, column, 0] + v * linear[k, column, 1]


@compiled
def squared_lengths(residuals: FloatArray, covariance: FloatArray, out: FloatArray) -> None:
    """Squared Mahalanobis lengths of `residuals` (N, 2) under `covariance` (N, 2, 2) to `out` (N,)."""
    for i in range(out.shape[0]):
        a, b, c, d = covariance[i, 0, 0], covariance[i, 0, 1], covariance[i, 1, 0], covariance[i, 1, 1]
        x, y = residuals[i, 0], residuals[i, 1]
        determinant = a * d - b * c
        if determinant == 0:
            out[i] = np.nan
            continue
        along = x * (d / determinant) * x + x * (-b / determinant) * y
        out[i] = along + y * (-c / determinant) * x + y * (a / determinant) * y
