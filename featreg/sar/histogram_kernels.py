"""Compiled loops of gradient histograms: pooling around keypoints, and the peak of an orientation histogram."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.jit import compiled

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


@compiled
def _sample(
    magnitude: F32, direction: F32, width: int, height: int, x0: np.float32, y0: np.float32, c: np.float32,
    s: np.float32, u: F32, v: F32, turn: np.float32, per_radian: np.float32, strength: F32, place: F32,
) -> None:  # fmt: skip
    """Read the flat fields at the turned pattern (u, v): strengths (0 outside the field) and places on the circle.

    One gather and no branch per sample, so that the loop becomes vector code.
    """
    right, bottom = np.int32(width - 1), np.int32(height - 1)
    half = np.float32(0.5)
    for k in range(u.shape[0]):
        x = np.int32(np.floor(x0 + c * u[k] - s * v[k] + half))
        y = np.int32(np.floor(y0 - s * u[k] - c * v[k] + half))
        inside = (x >= 0) & (y >= 0) & (x <= right) & (y <= bottom)
        at = np.uint64(min(max(y, 0), bottom)) * np.uint64(width) + np.uint64(min(max(x, 0), right))
        strength[k] = magnitude[at] if inside else np.float32(0)
        place[k] = (direction[at] - turn) * per_radian


@compiled
def pool(
    magnitude: F32, direction: F32, width: int, height: int, xy: F64, radius: F64, angle: F64, pattern: F32,
    cells: I64, shares: F32, bins: int, out: F32,
) -> None:  # fmt: skip
    """Add the gradients around each point to the histograms of its cells.

    `magnitude`, `direction` (H * W,) are the flat fields, directions in radians counter-clockwise as seen, in
    [0, 2 pi). `pattern` (2, S) holds the samples in units of the radius, y up; sample k belongs to the cells
    `cells[k]` with the weights `shares[k]`, both (S, C). `out` is (N, cells * bins); a direction, relative to the
    point's angle, is shared by the two nearest bins, bin 0 being centred on the point's own direction.
    """
    samples, many = cells.shape
    strength, place = np.empty(samples, np.float32), np.empty(samples, np.float32)
    per_radian = np.float32(bins / (2 * np.pi))
    for i in range(xy.shape[0]):
        turn = angle[i] % (2 * np.pi)
        c, s = np.float32(radius[i] * np.cos(turn)), np.float32(radius[i] * np.sin(turn))
        x0, y0 = np.float32(xy[i, 0]), np.float32(xy[i, 1])
        _sample(
            magnitude, direction, width, height, x0, y0, c, s, pattern[0], pattern[1], np.float32(turn), per_radian,
            strength, place,
        )  # fmt: skip
        row = out[i]
        for k in range(samples):
            low = np.floor(place[k])
            upper = (place[k] - low) * strength[k]
            lower = strength[k] - upper
            first = int(low)
            if first < 0:
                first += bins
            if first >= bins:
                first -= bins
            second = first + 1 if first + 1 < bins else 0
            for j in range(many):
                share = shares[k, j]
                base = cells[k, j] * bins
                row[base + first] += share * lower
                row[base + second] += share * upper


@compiled
def peak_direction(histograms: F32, angle: F64) -> None:
    """Angle of the peak of each smoothed circular histogram, by a parabola through its three highest values.

    Smoothed by (1, 4, 6, 4, 1) / 16, after Lowe; an empty histogram gives 0.
    """
    bins = histograms.shape[1]
    smooth = np.empty(bins)
    for i in range(histograms.shape[0]):
        row = histograms[i]
        best = 0
        for b in range(bins):
            near = row[(b + 1) % bins] + row[(b + bins - 1) % bins]
            far = row[(b + 2) % bins] + row[(b + bins - 2) % bins]
            smooth[b] = 6.0 * row[b] + 4.0 * near + far
            if smooth[b] > smooth[best]:
                best = b
        if smooth[best] <= 0.0:
            angle[i] = 0.0
            continue
        before, after = smooth[(best + bins - 1) % bins], smooth[(best + 1) % bins]
        curve = before - 2.0 * smooth[best] + after
        offset = 0.5 * (before - after) / curve if curve < 0.0 else 0.0
        angle[i] = (best + offset) * 2.0 * np.pi / bins
