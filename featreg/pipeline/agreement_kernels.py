"""Compiled loops over two images on one grid, made smaller; `featreg.pipeline.agreement` says what they are for."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled
from featreg.sar.speckle_kernels import logarithms
from featreg.types import BoolArray, FloatArray

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
I64 = NDArray[np.int64]

#: Side of the tiles by which a mask is looked at first, px.
TILE = 16
#: So near to the edge of an image, px, rounding decides what lies inside.
EDGE_PX = 1e-6


@compiled
def halved_logarithms(amplitude: F32, floor: np.float32, out: F32) -> None:
    """Fill out (H // 2, W // 2) with the logarithm of the mean amplitude of 2 x 2 pixels, at least that of `floor`."""
    line = np.empty(out.shape[1], np.float32)
    quarter = np.float32(0.25)
    for y in range(out.shape[0]):
        upper, lower = amplitude[2 * y], amplitude[2 * y + 1]
        for x in range(line.shape[0]):
            line[x] = quarter * ((upper[2 * x] + upper[2 * x + 1]) + (lower[2 * x] + lower[2 * x + 1]))
        logarithms(line, floor, out[y])


@compiled
def clear_tiles(mask: U8, tiles: U8) -> None:
    """Set to 0, of tiles (h, w) of `TILE` px a side, those in which a pixel of a mask (H, W) does not count."""
    height, width = mask.shape
    line = np.empty(width, np.uint8)
    for i in range(tiles.shape[0]):
        line[:] = np.uint8(1)
        for y in range(i * TILE, min((i + 1) * TILE, height)):
            row = mask[y]
            for x in range(width):
                line[x] = min(line[x], row[x])
        for x in range(width):
            if line[x] == 0:
                tiles[i, x // TILE] = 0


@compiled
def _on_row(nodes: FloatArray, apart: int, i: int, count: int, at: FloatArray) -> None:
    """Fill at (6, count): where the middles of the squares of a row are mapped, and their steps along x and y."""
    per = 1.0 / apart
    upper, lower = nodes[i // apart], nodes[i // apart + 1]
    down = (i % apart) * per
    for axis in range(2):
        for k in range((count + apart - 1) // apart):
            left, right = lower[k, axis] - upper[k, axis], lower[k + 1, axis] - upper[k + 1, axis]
            first = upper[k, axis] + left * down
            step = (upper[k + 1, axis] + right * down - first) * per
            left, bend = left * per, (right - left) * per * per
            for j in range(min(apart, count - k * apart)):
                at[axis, k * apart + j] = first + step * j
                at[2 + axis, k * apart + j] = step
                at[4 + axis, k * apart + j] = left + bend * j


@compiled
def _all_clear(tiles: U8, u: float, v: float, far_u: float, far_v: float, reach: int) -> bool:
    """Whether the tiles of the box between two points, and of so many px around it, are all clear."""
    left, right = int(min(u, far_u) + 0.5) - reach, int(max(u, far_u) + 0.5) + reach
    top, bottom = int(min(v, far_v) + 0.5) - reach, int(max(v, far_v) + 0.5) + reach
    for y in range(max(top, 0) // TILE, min(bottom // TILE + 1, tiles.shape[0])):
        for x in range(max(left, 0) // TILE, min(right // TILE + 1, tiles.shape[1])):
            if tiles[y, x] == 0:
                return False
    return True


@compiled
def _square_clear(mask: U8, u: int, v: int, reach: int) -> bool:
    """Whether all pixels of a mask count that lie up to `reach` px from a pixel along x and y, within the image."""
    for y in range(max(v - reach, 0), min(v + reach + 1, mask.shape[0])):
        for x in range(max(u - reach, 0), min(u + reach + 1, mask.shape[1])):
            if mask[y, x] == 0:
                return False
    return True


@compiled
def sampled(
    view: F32, tall: int, wide: int, scale: float, offset: float, nodes: FloatArray, apart: int, step: int,
    first_mask: U8, second_mask: U8, tiles: U8, reach: int, shape: I64, top: int, bottom: int, out: F32,
    valid: BoolArray,
) -> None:  # fmt: skip
    """Sample a view of the secondary at squares of the reference, and say which of these both images hold.

    Parameters
    ----------
    view, tall, wide : of the secondary, row by row, and its sides, 2 or more
    scale, offset : its sample at x * scale + offset shows the pixel x
    nodes : (ny, nx, 2) finite px, where a model maps the middles of every `apart`-th square along y and x, and of one
        more; between them it is taken as bilinear
    apart, step : as said, and the side of a square, px
    first_mask : (H, W) pixels of the reference that are valid, 0 or 1; of no size where all are
    second_mask : the same of the secondary
    tiles : of it, 1 where `clear_tiles` leaves it
    reach : a pixel of the secondary counts where all are valid up to so many px from it along x and y
    shape : (H, W) of the secondary
    top, bottom : the first row of squares that is filled, and that behind the last
    out : (h, w) filled with the view at the middle of each square, bilinearly, its rim going on beyond it; 0 where not
        valid
    valid : (h, w) filled: the square lies in both images, and all in it is valid
    """
    count, last_u, last_v = out.shape[1], np.float32(wide - 1), np.float32(tall - 1)
    none, width = np.float32(0), np.uint64(wide)
    low, high_u, high_v = -0.5 + EDGE_PX, shape[1] - 0.5 - EDGE_PX, shape[0] - 0.5 - EDGE_PX
    at, line = np.empty((6, count)), np.empty(first_mask.shape[1], np.uint8)
    for i in range(top, bottom):
        _on_row(nodes, apart, i, count, at)
        for j in range(count):
            reach_u, reach_v = 0.5 * (abs(at[2, j]) + abs(at[4, j])), 0.5 * (abs(at[3, j]) + abs(at[5, j]))
            inside = (at[0, j] - reach_u >= low) & (at[0, j] + reach_u <= high_u)
            valid[i, j] = inside & (at[1, j] - reach_v >= low) & (at[1, j] + reach_v <= high_v)
        if first_mask.shape[0] > 0:
            line[:] = np.uint8(1)
            for y in range(i * step, (i + 1) * step):
                for x in range(line.shape[0]):
                    line[x] = min(line[x], first_mask[y, x])
            for j in range(count):
                for x in range(j * step, (j + 1) * step):
                    valid[i, j] = valid[i, j] & (line[x] != 0)
        if second_mask.shape[0] > 0:
            for first in range(0, count, apart):
                last = min(first + apart, count) - 1
                while first <= last and not valid[i, first]:
                    first += 1
                while first <= last and not valid[i, last]:
                    last -= 1
                if first > last or _all_clear(tiles, at[0, first], at[1, first], at[0, last], at[1, last], reach):
                    continue
                for j in range(first, last + 1):
                    if valid[i, j]:
                        valid[i, j] = _square_clear(second_mask, int(at[0, j] + 0.5), int(at[1, j] + 0.5), reach)
        for j in range(count):
            across = min(max(np.float32(at[0, j] * scale + offset), none), last_u)
            down = min(max(np.float32(at[1, j] * scale + offset), none), last_v)
            # On the last column or row all of the weight lies beyond the middle.
            column, row = min(int(across), wide - 2), min(int(down), tall - 2)
            fx, fy = across - np.float32(column), down - np.float32(row)
            here = np.uint64(row) * width + np.uint64(column)
            under = here + width
            a = view[here] + (view[here + np.uint64(1)] - view[here]) * fx
            b = view[under] + (view[under + np.uint64(1)] - view[under]) * fx
            out[i, j] = a + (b - a) * fy if valid[i, j] else none


@compiled
def _column_products(a: F32, here: int, b: F32, there: int, width: int, rows: int, sums: F32) -> None:
    """Fill sums (n,) with those of the products of some rows of two maps from two places on, given row by row.

    Indices are unsigned, so that the compiler need not look for negative ones.
    """
    i, j, w = np.uint64(here), np.uint64(there), np.uint64(width)
    w2, w3, w4 = w + w, w + w + w, w + w + w + w
    sums[:] = np.float32(0)
    for _ in range(rows // 4):
        for k in range(np.uint64(sums.shape[0])):
            p, q = i + k, j + k
            sums[k] += (a[p] * b[q] + a[p + w] * b[q + w]) + (a[p + w2] * b[q + w2] + a[p + w3] * b[q + w3])
        i, j = i + w4, j + w4
    for _ in range(rows % 4):
        for k in range(np.uint64(sums.shape[0])):
            sums[k] += a[i + k] * b[j + k]
        i, j = i + w, j + w


@compiled
def _moments(view: F32, width: int, side: int, mean: F32, inverse: F32) -> None:
    """Fill, for each square of `side` samples of a map, its mean, and the inverse root of its sum of squares about it.

    The latter is 0 where the variance is rounding error of the mean square, as that of a constant.
    """
    column, square = np.zeros(width), np.zeros(width)
    count = np.float64(side * side)
    for y in range(view.shape[0] // width):
        here, gone = np.uint64(y * width), np.uint64(max(y - side, 0) * width)
        for x in range(np.uint64(width)):
            value = np.float64(view[here + x])
            column[x] += value
            square[x] += value * value
        if y >= side:
            for x in range(np.uint64(width)):
                value = np.float64(view[gone + x])
                column[x] -= value
                square[x] -= value * value
        if y >= side - 1:
            row = y - side + 1
            total, power = 0.0, 0.0
            for x in range(side - 1):
                total += column[x]
                power += square[x]
            for x in range(mean.shape[1]):
                total += column[x + side - 1]
                power += square[x + side - 1]
                mean[row, x], inverse[row, x] = total / count, power
                total -= column[x]
                power -= square[x]
            for x in range(mean.shape[1]):
                power32 = inverse[row, x]
                variance = power32 - np.float32(count) * mean[row, x] * mean[row, x]
                root = np.float32(1) / np.sqrt(max(variance, np.float32(1e-30)))
                inverse[row, x] = root if variance > np.float32(1e-5) * power32 else np.float32(0)


@compiled
def grid_correlations(a: F32, b: F32, width: int, xs: I64, ys: I64, half: int, search: int, out: FloatArray) -> None:
    """Correlation coefficients of the windows of two maps around the points of a grid, for every small shift.

    Parameters
    ----------
    a, b : maps of one size, row by row, with a mean near 0 everywhere
    width : of a row
    xs, ys : (M,), (N,) columns and rows of the points, rising, at least half + search inside
    half, search : half the window, and the largest shift, in samples
    out : (N * M, 2 * search + 1, 2 * search + 1) filled as `featreg.sar.correlation.local_correlations` returns it

    Notes
    -----
    For each shift the products of a row of windows are summed along their columns, all windows together, and then
    along the row in each: neighbours share what they have in common.
    """
    side = 2 * half + 1
    left = xs[0] - half
    many = xs[xs.shape[0] - 1] + half + 1 - left
    sums = np.empty(many, np.float32)
    shape = (a.shape[0] // width - side + 1, width - side + 1)
    mean_a, inverse_a = np.empty(shape, np.float32), np.empty(shape, np.float32)
    mean_b, inverse_b = np.empty(shape, np.float32), np.empty(shape, np.float32)
    _moments(a, width, side, mean_a, inverse_a)
    _moments(b, width, side, mean_b, inverse_b)
    count = np.float32(side * side)
    for i in range(ys.shape[0]):
        top = ys[i] - half
        for dy in range(-search, search + 1):
            for dx in range(-search, search + 1):
                here = top * width + left
                _column_products(a, here, b, here + dy * width + dx, width, side, sums)
                for j in range(xs.shape[0]):
                    x = xs[j] - half
                    p = q = np.float32(0)
                    first = np.uint64(x - left)
                    for _ in range(half):
                        p += sums[first]
                        q += sums[first + np.uint64(1)]
                        first += np.uint64(2)
                    product = (p + q) + sums[first] - count * mean_a[top, x] * mean_b[top + dy, x + dx]
                    value = product * inverse_a[top, x] * inverse_b[top + dy, x + dx]
                    out[i * xs.shape[0] + j, search + dy, search + dx] = min(max(np.float64(value), -1.0), 1.0)


@compiled
def _add_row(a: F32, b: F32, y: int, sign: float, narrow: FloatArray, wide: FloatArray, which: int) -> None:
    """Add row y of both maps, or take it off, to the sums of columns: of `narrow` where `which` is 0, else `wide`."""
    height, width = a.shape
    if which == 0:
        for x in range(width):
            p, q = np.float64(a[y, x]), np.float64(b[y, x])
            narrow[0, x] += sign * (p * p)
            narrow[1, x] += sign * (q * q)
            narrow[2, x] += sign * (p * q)
        return
    under = min(y + 1, height - 1)
    # Beyond the last row or column there is no neighbour.
    down = 1.0 if y + 1 < height else 0.0
    for x in range(width - 1):
        p, q = np.float64(a[y, x]), np.float64(b[y, x])
        wide[0, x] += sign * (p * p)
        wide[1, x] += sign * (q * q)
        wide[2, x] += sign * p * (np.float64(a[y, x + 1]) + down * np.float64(a[under, x]))
        wide[3, x] += sign * q * (np.float64(b[y, x + 1]) + down * np.float64(b[under, x]))
    x = width - 1
    p, q = np.float64(a[y, x]), np.float64(b[y, x])
    wide[0, x] += sign * (p * p)
    wide[1, x] += sign * (q * q)
    wide[2, x] += sign * p * (down * np.float64(a[under, x]))
    wide[3, x] += sign * q * (down * np.float64(b[under, x]))


@compiled
def likenesses(a: F32, b: F32, half: int, around: int, stride: int, local: F32, structure: F32) -> None:
    """Fill, for every `stride`-th sample, how alike two maps are around it and how much structure both have there.

    Parameters
    ----------
    a, b : (h, w) with a mean near 0 everywhere
    half, around : half the squares over which is summed, for the likeness and for the structure; they end at the rim
    local : filled with the correlation, sum a b / sqrt(sum a^2 sum b^2)
    structure : filled with the correlation of neighbouring samples, that of the map that has less
    """
    height, width = a.shape
    narrow, wide = np.zeros((3, width)), np.zeros((4, width))
    ends = np.zeros((7, width + 1))
    low, high, wide_low, wide_high = 0, 0, 0, 0
    # Squares whose mean square is below 1e-10 or 1e-12 hold nothing.
    least, faint = 1e-20 * (2 * half + 1) ** 4, 1e-12 * (2 * around + 1) ** 2
    for i in range(local.shape[0]):
        y = i * stride
        while high < min(y + half + 1, height):
            _add_row(a, b, high, 1.0, narrow, wide, 0)
            high += 1
        while low < y - half:
            _add_row(a, b, low, -1.0, narrow, wide, 0)
            low += 1
        while wide_high < min(y + around + 1, height):
            _add_row(a, b, wide_high, 1.0, narrow, wide, 1)
            wide_high += 1
        while wide_low < y - around:
            _add_row(a, b, wide_low, -1.0, narrow, wide, 1)
            wide_low += 1
        # Seven sums side by side: each by itself would wait for its last addition.
        s0 = s1 = s2 = s3 = s4 = s5 = s6 = 0.0
        for x in range(np.uint64(width)):
            s0 += narrow[0, x]
            s1 += narrow[1, x]
            s2 += narrow[2, x]
            s3 += wide[0, x]
            s4 += wide[1, x]
            s5 += wide[2, x]
            s6 += wide[3, x]
            y1 = x + np.uint64(1)
            ends[0, y1], ends[1, y1], ends[2, y1], ends[3, y1] = s0, s1, s2, s3
            ends[4, y1], ends[5, y1], ends[6, y1] = s4, s5, s6
        for j in range(local.shape[1]):
            x = j * stride
            first, last = max(x - half, 0), min(x + half + 1, width)
            aa, bb, ab = ends[0, last] - ends[0, first], ends[1, last] - ends[1, first], ends[2, last] - ends[2, first]
            local[i, j] = ab / math.sqrt(max(aa * bb, least))
            first, last = max(x - around, 0), min(x + around + 1, width)
            of_a = (ends[5, last] - ends[5, first]) / max(2.0 * (ends[3, last] - ends[3, first]), faint)
            of_b = (ends[6, last] - ends[6, first]) / max(2.0 * (ends[4, last] - ends[4, first]), faint)
            structure[i, j] = min(of_a, of_b)
