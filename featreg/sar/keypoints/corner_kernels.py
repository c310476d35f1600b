"""Compiled loops of corner detection: the FAST segment test, intensity centroids, sub-pixel positions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled, inlined
from featreg.sar.keypoints.binary_kernels import lowest_byte

U8 = NDArray[np.uint8]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
#: Rows whose scores are kept at a time.
BAND = 16
#: Points whose centroids are computed side by side, and rows of so many numbers, as the compiler is to know them.
LANES = 64
ROW, ROW2, ROW3 = np.uint64(LANES), np.uint64(2 * LANES), np.uint64(3 * LANES)
ROW4, ROW5, ROW6 = np.uint64(4 * LANES), np.uint64(5 * LANES), np.uint64(6 * LANES)


@compiled
def _segment_scores(r0: U8, r1: U8, r2: U8, r3: U8, r4: U8, r5: U8, r6: U8, threshold: np.uint8, score: U8) -> None:
    """FAST-9/16 scores of one row, given the seven rows around it: 64 pixels at once, without a branch.

    Eight contiguous points p[k]..p[k+7], k odd, are shared by the two arcs of nine that add p[k-1] or p[k+8]; the
    smallest of the better arc is min(eight, max of the two). The largest over all arcs, less the centre, is the score
    of a brighter ring; with min and max exchanged, that of a darker one. The indices are unsigned, since a negative
    one would mean "from the end", which keeps the compiler from vectorising.
    """
    for column in range(r3.shape[0] - 6):
        x0 = np.uint64(column)
        x1, x2, x3 = x0 + np.uint64(1), x0 + np.uint64(2), x0 + np.uint64(3)
        x4, x5, x6 = x0 + np.uint64(4), x0 + np.uint64(5), x0 + np.uint64(6)
        p0, p1, p2, p3 = r0[x3], r0[x4], r1[x5], r2[x6]
        p4, p5, p6, p7 = r3[x6], r4[x6], r5[x5], r6[x4]
        p8, p9, p10, p11 = r6[x3], r6[x2], r5[x1], r4[x0]
        p12, p13, p14, p15 = r3[x0], r2[x0], r1[x1], r0[x2]
        a1, a3, a5, a7 = min(p1, p2), min(p3, p4), min(p5, p6), min(p7, p8)
        a9, a11, a13, a15 = min(p9, p10), min(p11, p12), min(p13, p14), min(p15, p0)
        aa1, aa3, aa5, aa7 = min(a1, a3), min(a3, a5), min(a5, a7), min(a7, a9)
        aa9, aa11, aa13, aa15 = min(a9, a11), min(a11, a13), min(a13, a15), min(a15, a1)
        a1 = min(aa1, aa5, max(p0, p9))
        a3 = min(aa3, aa7, max(p2, p11))
        a5 = min(aa5, aa9, max(p4, p13))
        a7 = min(aa7, aa11, max(p6, p15))
        a9 = min(aa9, aa13, max(p8, p1))
        a11 = min(aa11, aa15, max(p10, p3))
        a13 = min(aa13, aa1, max(p12, p5))
        a15 = min(aa15, aa3, max(p14, p7))
        bright = max(a1, a3, a5, a7, a9, a11, a13, a15)
        b1, b3, b5, b7 = max(p1, p2), max(p3, p4), max(p5, p6), max(p7, p8)
        b9, b11, b13, b15 = max(p9, p10), max(p11, p12), max(p13, p14), max(p15, p0)
        bb1, bb3, bb5, bb7 = max(b1, b3), max(b3, b5), max(b5, b7), max(b7, b9)
        bb9, bb11, bb13, bb15 = max(b9, b11), max(b11, b13), max(b13, b15), max(b15, b1)
        b1 = max(bb1, bb5, min(p0, p9))
        b3 = max(bb3, bb7, min(p2, p11))
        b5 = max(bb5, bb9, min(p4, p13))
        b7 = max(bb7, bb11, min(p6, p15))
        b9 = max(bb9, bb13, min(p8, p1))
        b11 = max(bb11, bb15, min(p10, p3))
        b13 = max(bb13, bb1, min(p12, p5))
        b15 = max(bb15, bb3, min(p14, p7))
        dark = min(b1, b3, b5, b7, b9, b11, b13, b15)
        centre = r3[x3]
        above = np.uint8(bright - centre) if bright > centre else np.uint8(0)
        below = np.uint8(centre - dark) if centre > dark else np.uint8(0)
        best = max(above, below)
        score[x3] = best if best > threshold else np.uint8(0)


@compiled
def fast_scores(image: U8, threshold: int, first: int, score: U8) -> None:
    """Write the FAST-9/16 scores of the rows of an image from `first` on, as many as `score` has.

    The score is the smallest difference along the best arc of nine points of the circle of radius 3, one more than
    OpenCV's response; it is 0 unless above `threshold`, and closer than 3 to the border. The first and last three
    columns of `score` are left alone.
    """
    t = np.uint8(threshold)
    for k in range(score.shape[0]):
        y = first + k
        if y < 3 or y >= image.shape[0] - 3:
            score[k] = 0
            continue
        a, b, c, d = image[y - 3], image[y - 2], image[y - 1], image[y]
        e, f, g = image[y + 1], image[y + 2], image[y + 3]
        _segment_scores(a, b, c, d, e, f, g, t, score[k])


@compiled
def _peaks_of_row(above: U8, here: U8, below: U8, allowed: U8, least: np.uint8, peaks: U8) -> None:
    """Keep a score that is the largest of its 3 x 3 neighbourhood (ties: the first in reading order), else 0."""
    for column in range(here.shape[0] - 2):
        x0 = np.uint64(column)
        x1, x2 = x0 + np.uint64(1), x0 + np.uint64(2)
        s = here[x1]
        before = max(above[x0], above[x1], above[x2], here[x0])
        after = max(below[x0], below[x1], below[x2], here[x2])
        peaks[x1] = s if (s > before) & (s >= after) & (s >= least) & (allowed[x1] != 0) else np.uint8(0)


@compiled
def collect_corners(
    image: U8, threshold: int, allowed: U8, start: int, stop: int, wanted: int, at: I64, values: U8
) -> int:
    """Gather the local maxima of the FAST scores where `allowed`, in reading order; return how many.

    Those of the rows `start` to before `stop`.

    `at` gets flat indices, `values` the scores. A maximum is left out where as many as are wanted stand before it that
    are as high. The scores of a few rows at a time are looked at while they are in the cache, and pixels skipped eight
    at a time where nothing stands.
    """
    height, width = image.shape
    top, bottom = start, stop
    while top < bottom and not allowed[top].any():
        top += 1
    while bottom > top and not allowed[bottom - 1].any():
        bottom -= 1
    score = np.zeros((BAND + 2, width), np.uint8)
    peaks = np.zeros((width + 7) // 8 * 8, np.uint8)
    eights = peaks.view(np.uint64)
    found = np.zeros(256, np.int64)
    # So many maxima are higher than `least` - 1.
    count, least, above = 0, 1, 0
    for first in range(max(top, 3), min(bottom, height - 3), BAND):
        rows = min(BAND, min(bottom, height - 3) - first)
        fast_scores(image, threshold, first - 1, score[: rows + 2])
        for k in range(rows):
            y = first + k
            _peaks_of_row(score[k], score[k + 1], score[k + 2], allowed[y], np.uint8(least), peaks[:width])
            for eight in range(eights.shape[0]):
                left = eights[eight]
                while left != 0 and count < at.shape[0]:
                    byte = lowest_byte(left)
                    left &= ~(np.uint64(0xFF) << (np.uint64(8) * byte))
                    x = 8 * eight + np.int64(byte)
                    at[count] = y * width + x
                    values[count] = peaks[x]
                    found[peaks[x]] += 1
                    above += 1
                    count += 1
            while above >= wanted and least < 255:
                above -= found[least]
                least += 1
    return count


@compiled
def in_order(at: I64, values: U8, width: int, xy: I64, score: U8) -> None:
    """Write the highest corners, of equal ones the first, to `xy` (N, 2) and `score` (N,)."""
    place = np.zeros(257, np.int64)
    for i in range(at.shape[0]):
        place[values[i]] += 1
    before = 0
    for s in range(255, -1, -1):
        place[s], before = before, before + place[s]
    for i in range(at.shape[0]):
        to = place[values[i]]
        place[values[i]] += 1
        if to < score.shape[0]:
            y = at[i] // width
            xy[to, 0], xy[to, 1] = at[i] - y * width, y
            score[to] = values[i]


@compiled
def intensity_centroid(image: F32 | U8, xs: I64, ys: I64, radius: int, stride: int, angle: F64) -> None:
    """Angle from each point to the intensity centroid of the disc around it, counter-clockwise as seen (y up).

    Beyond its border the image goes on as its last pixels.
    """
    ends = np.zeros(2 * (radius // stride) + 1, np.int64)
    _fill_disc(radius, stride, ends)
    for i in range(xs.shape[0]):
        angle[i] = _centroid_angle(image, xs[i], ys[i], radius, stride, ends)


@compiled
def _fill_disc(radius: int, stride: int, ends: I64) -> None:
    """How many steps along x each row of the disc has, from the middle to one end."""
    steps = radius // stride
    for k in range(ends.shape[0]):
        dy = stride * (k - steps)
        while (stride * (ends[k] + 1)) ** 2 + dy * dy <= radius * radius:
            ends[k] += 1


@inlined
def _centroid_angle(image: F32 | U8, x0: int, y0: int, radius: int, stride: int, ends: I64) -> float:
    height, width = image.shape
    steps = radius // stride
    # Of whole numbers the sums are whole numbers.
    mx = my = 0 * image[0, 0]
    inside = x0 >= radius and y0 >= radius and x0 < width - radius and y0 < height - radius
    for k in range(ends.shape[0]):
        dy, end = stride * (k - steps), ends[k]
        row = image[min(max(y0 + dy, 0), height - 1)]
        total = 0 * image[0, 0]
        for step in range(-end, end + 1):
            x = x0 + stride * step
            if not inside:
                x = min(max(x, 0), width - 1)
            v = row[np.uint64(x)]
            mx += step * v
            total += 1 * v
        my += dy * total
    return float(np.arctan2(-float(my), float(stride * mx)))


@compiled
def centroids_of_level(
    level: U8, xy: F64, image_width: int, image_height: int, numbers: I64, number: int, radius: int, stride: int,
    angle: F64,
) -> None:  # fmt: skip
    """As `intensity_centroid`, of those of the points (N, 2) whose `numbers` (N,) is `number`.

    They are in pixels of an image of `image_width` and `image_height`, of which `level` (H, W) is a smaller one.
    """
    ends = np.zeros(2 * (radius // stride) + 1, np.int64)
    _fill_disc(radius, stride, ends)
    across, down = level.shape[1] / image_width, level.shape[0] / image_height
    for i in range(xy.shape[0]):
        if numbers[i] == number:
            x, y = int(np.rint((xy[i, 0] + 0.5) * across - 0.5)), int(np.rint((xy[i, 1] + 0.5) * down - 0.5))
            angle[i] = _centroid_angle(level, x, y, radius, stride, ends)


@compiled
def _add_moments(values: F32, weights: F32, row: int, sums: F32) -> None:
    """Add one row of the 7 x 7 neighbourhoods of `LANES` points to their sums: weight, and moments along x and y.

    `values` (7 * LANES,) are the columns of that row; `weights` (14 * LANES,) those along x, then those along y.
    """
    down = np.uint64((7 + row) * LANES)
    for lane in range(np.uint64(LANES)):
        k = np.uint64(lane)
        v0, v1 = values[k] * weights[k], values[k + ROW] * weights[k + ROW]
        v2, v3 = values[k + ROW2] * weights[k + ROW2], values[k + ROW3] * weights[k + ROW3]
        v4, v5 = values[k + ROW4] * weights[k + ROW4], values[k + ROW5] * weights[k + ROW5]
        v6 = values[k + ROW6] * weights[k + ROW6]
        share = weights[k + down]
        along = (((v0 + v1) + (v2 + v3)) + ((v4 + v5) + v6)) * share
        sums[k] += along
        sums[k + ROW] += ((np.float32(3) * (v6 - v0) + np.float32(2) * (v5 - v1)) + (v4 - v2)) * share
        sums[k + ROW2] += along * np.float32(row - 3)


@compiled
def _bell_weights(
    away: F32, slope: np.float32, b0: np.float32, b1: np.float32, b2: np.float32, b3: np.float32, weights: F32
) -> None:
    """exp(f (k - d)^2) of `LANES` offsets d, up to a common factor, for k = -3 ... 3, one row of `weights` each.

    With f = -slope / 2 these are exp(f k^2) exp(slope d)^k; `b0` to `b3` are exp(f k^2) of k from 0 on. The exponential
    is the eighth power of a polynomial, right to 1e-4 where slope d is below 5.6, and to the rounding where it is 1.
    """
    for lane in range(np.uint64(LANES)):
        k = np.uint64(lane)
        t = slope * away[k] * np.float32(0.125)
        high = np.float32(1 / 6) + t * (np.float32(1 / 24) + t * (np.float32(1 / 120) + t * np.float32(1 / 720)))
        right = np.float32(1) + t * (np.float32(1) + t * (np.float32(0.5) + t * high))
        right = right * right
        right = right * right
        right = right * right
        left = np.float32(1) / right
        right2, left2 = right * right, left * left
        weights[k], weights[k + ROW], weights[k + ROW2] = left2 * left * b3, left2 * b2, left * b1
        weights[k + ROW3] = b0
        weights[k + ROW4], weights[k + ROW5], weights[k + ROW6] = right * b1, right2 * b2, right2 * right * b3


@compiled
def _take_patch(edge: U8, x0: int, y0: int, dark: bool, lane: int, patch: F32) -> None:
    """The 7 x 7 pixels from (x0, y0) on, less the least of them, or the greatest less them, as one lane of `patch`."""
    low, high = np.int64(255), np.int64(0)
    for r in range(7):
        for c in range(7):
            v = np.int64(edge[y0 + r, x0 + c])
            low, high = min(low, v), max(high, v)
    for r in range(7):
        for c in range(7):
            v = np.int64(edge[y0 + r, x0 + c])
            patch[(7 * r + c) * LANES + lane] = high - v if dark else v - low


@compiled
def edge_centroid(edge: U8, xy: F64, sigma: float, iterations: int, reach: float, moved: F64, good: U8) -> None:
    """Mean shift of each point to the Gaussian-weighted 7 x 7 centroid of the edge strength around it.

    A point darker than its surround (the still centre of a bright scatterer) goes to the centroid of the darkness.
    `good` is 0 where the point would leave the circle of radius `reach` around its start, and it stays there. `LANES`
    points go on together, so that their sums are vectors.
    """
    height, width = edge.shape
    slope = np.float32(1.0 / (sigma * sigma))
    b0, b1 = np.float32(1), np.float32(np.exp(-0.5 / sigma**2))
    b2, b3 = np.float32(np.exp(-2.0 / sigma**2)), np.float32(np.exp(-4.5 / sigma**2))
    patch, weights = np.zeros(49 * LANES, np.float32), np.zeros(14 * LANES, np.float32)
    away_x, away_y = np.zeros(LANES, np.float32), np.zeros(LANES, np.float32)
    sums = np.zeros(3 * LANES, np.float32)
    qx, qy = np.zeros(LANES), np.zeros(LANES)
    held_x, held_y = np.zeros(LANES, np.int64), np.zeros(LANES, np.int64)
    dark, going = np.zeros(LANES, np.bool_), np.zeros(LANES, np.bool_)
    for start in range(0, xy.shape[0], LANES):
        lanes = min(LANES, xy.shape[0] - start)
        for lane in range(lanes):
            i = start + lane
            qx[lane], qy[lane] = xy[i, 0], xy[i, 1]
            cx, cy = int(np.rint(qx[lane])), int(np.rint(qy[lane]))
            held_x[lane], held_y[lane] = -1, -1
            good[i], going[lane] = 1, True
            if cx < 3 or cy < 3 or cx >= width - 3 or cy >= height - 3:
                continue
            ring = np.int64(0)
            for k in range(-3, 4):
                ring += np.int64(edge[cy - 3, cx + k]) + np.int64(edge[cy + 3, cx + k])
                if -3 < k < 3:
                    ring += np.int64(edge[cy + k, cx - 3]) + np.int64(edge[cy + k, cx + 3])
            dark[lane] = float(edge[cy, cx]) < ring / 24.0
        left = lanes
        for _ in range(iterations):
            for lane in range(lanes):
                if not going[lane]:
                    continue
                cx, cy = int(np.rint(qx[lane])), int(np.rint(qy[lane]))
                if cx < 3 or cy < 3 or cx >= width - 3 or cy >= height - 3:
                    good[start + lane], going[lane] = 0, False
                    left -= 1
                    continue
                if cx != held_x[lane] or cy != held_y[lane]:
                    held_x[lane], held_y[lane] = cx, cy
                    _take_patch(edge, cx - 3, cy - 3, dark[lane], lane, patch)
                away_x[lane], away_y[lane] = qx[lane] - cx, qy[lane] - cy
            if left == 0:
                break
            _bell_weights(away_x, slope, b0, b1, b2, b3, weights[: 7 * LANES])
            _bell_weights(away_y, slope, b0, b1, b2, b3, weights[7 * LANES :])
            sums[:] = 0.0
            for row in range(7):
                _add_moments(patch[7 * row * LANES :], weights, row, sums)
            for lane in range(lanes):
                if not going[lane]:
                    continue
                i, total = start + lane, sums[lane]
                nx, ny = qx[lane], qy[lane]
                if total > 0.0:
                    nx, ny = held_x[lane] + sums[LANES + lane] / total, held_y[lane] + sums[2 * LANES + lane] / total
                if total <= 0.0 or (nx - xy[i, 0]) ** 2 + (ny - xy[i, 1]) ** 2 > reach * reach:
                    good[i], going[lane] = 0, False
                    left -= 1
                    continue
                step = abs(nx - qx[lane]) + abs(ny - qy[lane])
                qx[lane], qy[lane] = nx, ny
                if step < 1e-2:
                    going[lane] = False
                    left -= 1
        for lane in range(lanes):
            i = start + lane
            moved[i, 0] = qx[lane] if good[i] else xy[i, 0]
            moved[i, 1] = qy[lane] if good[i] else xy[i, 1]


@compiled
def corner_intersection(
    gx: F32, gy: F32, xy: F64, sigma: float, iterations: int, reach: float, moved: F64, good: U8
) -> None:
    """Eq. 6 and 7: the point to which the gradients of the 7 x 7 neighbourhood are perpendicular, iterated.

    `good` is 0 where the equations are singular or the corner runs farther than `reach`; the point then stays.
    """
    height, width = gx.shape
    fall = -0.5 / (sigma * sigma)
    for i in range(xy.shape[0]):
        x0, y0 = xy[i, 0], xy[i, 1]
        qx, qy = x0, y0
        good[i] = 1
        for _ in range(iterations):
            cx, cy = int(np.rint(qx)), int(np.rint(qy))
            if cx < 3 or cy < 3 or cx >= width - 3 or cy >= height - 3:
                good[i] = 0
                break
            a, b, c, u, v = 0.0, 0.0, 0.0, 0.0, 0.0
            for r in range(-3, 4):
                for s in range(-3, 4):
                    dx, dy = cx + s - qx, cy + r - qy
                    w = np.exp(fall * (dx * dx + dy * dy))
                    g, h = float(gx[cy + r, cx + s]), float(gy[cy + r, cx + s])
                    a += w * g * g
                    b += w * g * h
                    c += w * h * h
                    u += w * (g * g * dx + g * h * dy)
                    v += w * (g * h * dx + h * h * dy)
            determinant = a * c - b * b
            if determinant <= 1e-6 * (a + c) * (a + c) or determinant <= 0.0:
                good[i] = 0
                break
            qx += (c * u - b * v) / determinant
            qy += (a * v - b * u) / determinant
            if (qx - x0) ** 2 + (qy - y0) ** 2 > reach * reach:
                good[i] = 0
                break
        moved[i, 0] = qx if good[i] else x0
        moved[i, 1] = qy if good[i] else y0
