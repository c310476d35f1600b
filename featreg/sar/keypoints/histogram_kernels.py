"""Compiled loops of gradient histograms: samples around keypoints, shared out to cells and directions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]


@compiled
def look_up(
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
def polar_of(gx: F32, gy: F32, length: F32, direction: F32) -> None:
    """Length, and direction in radians from 0 to 2 pi, counter-clockwise as seen, to 1e-5, of gradients with y down.

    atan(q) of the smaller component over the larger one by a polynomial, without branches, so that it becomes vector
    code.
    """
    quarter, half, whole = np.float32(0.5 * np.pi), np.float32(np.pi), np.float32(2 * np.pi)
    zero = np.float32(0)
    for k in range(gx.shape[0]):
        x, y = gx[k], -gy[k]
        length[k] = np.sqrt(x * x + y * y)
        along, across = x if x > zero else -x, y if y > zero else -y
        large, small = (along, across) if along > across else (across, along)
        q = small / (large if large > np.float32(1e-30) else np.float32(1e-30))
        s = q * q
        p = np.float32(-0.11643287) + s * (np.float32(0.05265332) - s * np.float32(0.01172120))
        p = np.float32(0.99997726) + s * (np.float32(-0.33262347) + s * (np.float32(0.19354346) + s * p))
        turn = q * p
        turn = quarter - turn if across > along else turn
        turn = half - turn if x < zero else turn
        direction[k] = whole - turn if y < zero else turn


@compiled
def _split(place: F32, turn: np.float32, per_radian: np.float32, bins: np.float32) -> None:
    """Turn directions into places on the circle of bins, 0 to below `bins`."""
    for k in range(place.shape[0]):
        t = (place[k] - turn) * per_radian
        t += bins if t < 0 else np.float32(0)
        place[k] = t - bins if t >= bins else t


@compiled
def pool(
    gx: F32, gy: F32, width: int, height: int, xy: F64, radius: F64, angle: F64, pattern: F32, cell: I64, share: F32,
    out: F32,
) -> None:  # fmt: skip
    """Histograms of the directions of the gradients around each point, in cells.

    `gx`, `gy` (H * W,) are the flat components, y down, of which only what the samples meet is read. `pattern` (2, S)
    holds the samples in units of the radius, y up; a sample counts in the cells `cell` (S, 4) with the shares `share`
    (S, 4), the largest first, 0 where it has fewer. `out` is (N, bins, cells); a direction, relative to the point's
    angle, is shared by the two nearest bins, bin 0 being centred on the point's own direction.
    """
    samples, bins = pattern.shape[1], out.shape[1]
    at = np.empty(samples, np.int32)
    strength, place = np.empty(samples, np.float32), np.empty(samples, np.float32)
    across, down = np.empty(samples, np.float32), np.empty(samples, np.float32)
    per_radian = np.float32(bins / (2 * np.pi))
    for i in range(xy.shape[0]):
        turn = angle[i] % (2 * np.pi)
        c, s = np.float32(radius[i] * np.cos(turn)), np.float32(radius[i] * np.sin(turn))
        look_up(np.float32(xy[i, 0]), np.float32(xy[i, 1]), c, s, width, height, pattern[0], pattern[1], at)
        _gather(gx, at, across)
        _gather(gy, at, down)
        polar_of(across, down, strength, place)
        _split(place, np.float32(turn), per_radian, np.float32(bins))
        row = out[i]
        row[:] = 0
        for k in range(samples):
            first = int(place[k])
            upper = (place[k] - np.float32(first)) * strength[k]
            lower = strength[k] - upper
            second = first + 1 if first + 1 < bins else 0
            for n in range(4):
                if share[k, n] == 0:
                    break
                row[np.uint64(first), np.uint64(cell[k, n])] += share[k, n] * lower
                row[np.uint64(second), np.uint64(cell[k, n])] += share[k, n] * upper


@compiled
def _look_up_beside(
    x0: F32, y0: F32, c: F32, s: F32, width: int, height: int, u: np.float32, v: np.float32, at: I32, inside: F32
) -> None:
    """As `look_up`, of one sample of several points; `inside` is 0 and the index any of the field's outside of it."""
    right, bottom, half = np.float32(width - 1), np.float32(height - 1), np.float32(0.5)
    zero, one = np.float32(0), np.float32(1)
    for i in range(at.shape[0]):
        x = np.floor(x0[i] + c[i] * u - s[i] * v + half)
        y = np.floor(y0[i] - s[i] * u - c[i] * v + half)
        near_x, near_y = x if x > zero else zero, y if y > zero else zero
        near_x, near_y = near_x if near_x < right else right, near_y if near_y < bottom else bottom
        inside[i] = one if (x == near_x) & (y == near_y) else zero
        at[i] = np.int32(near_y) * np.int32(width) + np.int32(near_x)


@compiled
def _gather_both(gx: F32, gy: F32, at: I32, inside: F32, along: F32, up: F32) -> None:
    for i in range(at.shape[0]):
        place = np.uint64(at[i])
        along[i] = inside[i] * gx[place]
        up[i] = inside[i] * gy[place]


@compiled
def _lengths(gx: F32, gy: F32, cosine: F32, sine: F32, length: F32) -> None:
    """Turn gradients (y down) into lengths and unit vectors (y up) counted from an angle; none where there is none."""
    for i in range(length.shape[0]):
        length[i] = np.sqrt(gx[i] * gx[i] + gy[i] * gy[i])
        inverse = np.float32(1) / (length[i] if length[i] > np.float32(1e-30) else np.float32(1e-30))
        along, up = gx[i] * inverse, -gy[i] * inverse
        gx[i] = cosine[i] * along + sine[i] * up
        gy[i] = cosine[i] * up - sine[i] * along


@compiled
def _first_harmonic(along: F32, up: F32, length: F32, out_c: F32, out_s: F32) -> None:
    for i in range(along.shape[0]):
        out_c[i], out_s[i] = length[i] * along[i], length[i] * up[i]


@compiled
def _next_harmonic(along: F32, up: F32, before_c: F32, before_s: F32, out_c: F32, out_s: F32) -> None:
    for i in range(along.shape[0]):
        out_c[i] = before_c[i] * along[i] - before_s[i] * up[i]
        out_s[i] = before_c[i] * up[i] + before_s[i] * along[i]


@compiled
def _add(values: F32, share: np.float32, out: F32) -> None:
    for i in range(out.shape[0]):
        out[i] += share * values[i]


@compiled
def _add_to_four(
    values: F32, a: np.float32, b: np.float32, c: np.float32, d: np.float32, one: F32, two: F32, three: F32, four: F32
) -> None:
    for i in range(values.shape[0]):
        value = values[i]
        one[i] += a * value
        two[i] += b * value
        three[i] += c * value
        four[i] += d * value


@compiled
def harmonics(
    gx: F32, gy: F32, width: int, height: int, order: I64, xy: F64, radius: F64, angle: F64, pattern: F32, cell: I64,
    share: F32, out: F32,
) -> None:  # fmt: skip
    """Sum the gradients around each point, and the harmonics of their directions, in cells.

    `gx`, `gy` (H * W,) are the flat components, y down. `pattern` (2, S) holds the samples in units of the radius,
    y up, and turns by the point's angle; a sample counts in the cells `cell` (S, 4) with the shares `share` (S, 4), 0
    where it has fewer. `out` is (N, 1 + 2 K, cells): the sum of the lengths m, and of m cos(k t), m sin(k t) for k = 1
    to K, t being the direction counter-clockwise from the point's own. Points are taken in the `order` (N,) given, 64
    at a time, which lie side by side in the processor's lanes: what is near in it should be near in the image.
    """
    count, rows, cells = out.shape
    lanes = 64
    x0, y0 = np.empty(lanes, np.float32), np.empty(lanes, np.float32)
    cosine, sine = np.empty(lanes, np.float32), np.empty(lanes, np.float32)
    c, s = np.empty(lanes, np.float32), np.empty(lanes, np.float32)
    along, up = np.empty(lanes, np.float32), np.empty(lanes, np.float32)
    at, inside = np.empty(lanes, np.int32), np.empty(lanes, np.float32)
    found = np.empty(rows * lanes, np.float32)
    sums = np.empty((cells, rows * lanes), np.float32)
    for start in range(0, count, lanes):
        for i in range(lanes):
            # The last lanes repeat the last point.
            point = order[min(start + i, count - 1)]
            turn = angle[point] % (2 * np.pi)
            x0[i], y0[i] = np.float32(xy[point, 0]), np.float32(xy[point, 1])
            cosine[i], sine[i] = np.float32(np.cos(turn)), np.float32(np.sin(turn))
            c[i], s[i] = np.float32(radius[point]) * cosine[i], np.float32(radius[point]) * sine[i]
        sums[:] = 0
        for k in range(pattern.shape[1]):
            _look_up_beside(x0, y0, c, s, width, height, pattern[0, k], pattern[1, k], at, inside)
            _gather_both(gx, gy, at, inside, along, up)
            _lengths(along, up, cosine, sine, found[:lanes])
            if rows > 1:
                _first_harmonic(along, up, found[:lanes], found[lanes : 2 * lanes], found[2 * lanes : 3 * lanes])
            for row in range(3, rows, 2):
                first = row * lanes
                _next_harmonic(
                    along, up, found[first - 2 * lanes : first - lanes], found[first - lanes : first],
                    found[first : first + lanes], found[first + lanes : first + 2 * lanes],
                )  # fmt: skip
            if share[k, 3] > 0:
                # Most samples lie between four cells: what is added is read once for all.
                _add_to_four(
                    found, share[k, 0], share[k, 1], share[k, 2], share[k, 3],
                    sums[cell[k, 0]], sums[cell[k, 1]], sums[cell[k, 2]], sums[cell[k, 3]],
                )  # fmt: skip
                continue
            for n in range(4):
                if share[k, n] > 0:
                    _add(found, share[k, n], sums[cell[k, n]])
        for i in range(min(lanes, count - start)):
            point = order[start + i]
            for row in range(rows):
                for n in range(cells):
                    out[point, row, n] = sums[n, row * lanes + i]
