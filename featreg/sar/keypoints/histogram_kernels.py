"""Compiled loops of gradient histograms: samples around keypoints, and the peak of an orientation histogram."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]


@compiled
def _look_up(
    x0: np.float32, y0: np.float32, c: np.float32, s: np.float32, width: int, height: int, u: F32, v: F32, at: I32
) -> None:
    """Flat indices of the pixels nearest to the turned pattern (u, v); -1 outside the field."""
    right, bottom, half = np.float32(width - 1), np.float32(height - 1), np.float32(0.5)
    for k in range(u.shape[0]):
        x = np.floor(x0 + c * u[k] - s * v[k] + half)
        y = np.floor(y0 - s * u[k] - c * v[k] + half)
        inside = (x >= 0) & (y >= 0) & (x <= right) & (y <= bottom)
        at[k] = np.int32(y) * np.int32(width) + np.int32(x) if inside else np.int32(-1)


@compiled
def _gather(field: F32, at: I32, values: F32) -> None:
    for k in range(at.shape[0]):
        values[k] = field[np.uint64(at[k])] if at[k] >= 0 else np.float32(0)


@compiled
def _split(place: F32, turn: np.float32, per_radian: np.float32, bins: np.float32) -> None:
    """Turn directions into places on the circle of bins, 0 to below `bins`."""
    for k in range(place.shape[0]):
        t = (place[k] - turn) * per_radian
        t += bins if t < 0 else np.float32(0)
        place[k] = t - bins if t >= bins else t


@compiled
def pool(
    magnitude: F32, direction: F32, width: int, height: int, xy: F64, radius: F64, angle: F64, pattern: F32,
    piece: I64, out: F32,
) -> None:  # fmt: skip
    """Add the gradients around each point to the histograms of the pieces of a pattern.

    `magnitude`, `direction` (H * W,) are the flat fields, directions in radians counter-clockwise as seen, in
    [0, 2 pi]. `pattern` (2, S) holds the samples in units of the radius, y up; sample k belongs to piece `piece[k]`.
    `out` is (N, bins, pieces); a direction, relative to the point's angle, is shared by the two nearest bins, bin 0
    being centred on the point's own direction.
    """
    samples = pattern.shape[1]
    bins = out.shape[1]
    at = np.empty(samples, np.int32)
    strength, place = np.empty(samples, np.float32), np.empty(samples, np.float32)
    per_radian = np.float32(bins / (2 * np.pi))
    for i in range(xy.shape[0]):
        turn = angle[i] % (2 * np.pi)
        c, s = np.float32(radius[i] * np.cos(turn)), np.float32(radius[i] * np.sin(turn))
        _look_up(np.float32(xy[i, 0]), np.float32(xy[i, 1]), c, s, width, height, pattern[0], pattern[1], at)
        _gather(magnitude, at, strength)
        _gather(direction, at, place)
        _split(place, np.float32(turn), per_radian, np.float32(bins))
        row = out[i]
        for k in range(samples):
            first = int(place[k])
            upper = (place[k] - np.float32(first)) * strength[k]
            second = first + 1 if first + 1 < bins else 0
            row[np.uint64(first), np.uint64(piece[k])] += strength[k] - upper
            row[np.uint64(second), np.uint64(piece[k])] += upper


@compiled
def _lengths(gx: F32, gy: F32, cosine: np.float32, sine: np.float32, length: F32) -> None:
    """Turn gradients (y down) into lengths and unit vectors (y up) counted from an angle; none where there is none."""
    for k in range(length.shape[0]):
        length[k] = np.sqrt(gx[k] * gx[k] + gy[k] * gy[k])
        inverse = np.float32(1) / max(length[k], np.float32(1e-30))
        along, up = gx[k] * inverse, -gy[k] * inverse
        gx[k] = cosine * along + sine * up
        gy[k] = cosine * up - sine * along


@compiled
def _next_harmonic(along: F32, up: F32, before_c: F32, before_s: F32, out_c: F32, out_s: F32) -> None:
    for k in range(along.shape[0]):
        out_c[k] = before_c[k] * along[k] - before_s[k] * up[k]
        out_s[k] = before_c[k] * up[k] + before_s[k] * along[k]


@compiled
def sample_harmonics(
    gx: F32, gy: F32, width: int, height: int, xy: F64, radius: F64, angle: F64, pattern: F32, out: F32
) -> None:
    """Read the gradients around each point, and the harmonics of their directions.

    `gx`, `gy` (H * W,) are the flat components, y down. `pattern` (2, S) holds the samples in units of the radius,
    y up, and turns by the point's angle. `out` is (N, 1 + 2 K, S): the length m of each gradient, and m cos(k t),
    m sin(k t) for k = 1 to K, t being its direction counter-clockwise from the point's own.
    """
    samples = pattern.shape[1]
    at, none = np.empty(samples, np.int32), np.zeros(samples, np.float32)
    along, up = np.empty(samples, np.float32), np.empty(samples, np.float32)
    for i in range(xy.shape[0]):
        turn = angle[i] % (2 * np.pi)
        cosine, sine = np.float32(np.cos(turn)), np.float32(np.sin(turn))
        c, s = np.float32(radius[i]) * cosine, np.float32(radius[i]) * sine
        _look_up(np.float32(xy[i, 0]), np.float32(xy[i, 1]), c, s, width, height, pattern[0], pattern[1], at)
        _gather(gx, at, along)
        _gather(gy, at, up)
        _lengths(along, up, cosine, sine, out[i, 0])
        if out.shape[1] > 1:
            _next_harmonic(along, up, out[i, 0], none, out[i, 1], out[i, 2])
        for row in range(3, out.shape[1], 2):
            _next_harmonic(along, up, out[i, row - 2], out[i, row - 1], out[i, row], out[i, row + 1])


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
