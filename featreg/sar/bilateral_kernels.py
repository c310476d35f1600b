"""Compiled loops of a bilateral scale space: its weighted means, and the extrema of differences between its levels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.jit import compiled, inlined

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]

# Rows padded at a time, and pixels summed at a time: the sums stay in the first cache, the strip in the second.
STRIP = 16
RUN = 2048


@inlined
def _weight(difference: np.float32, spatial: np.float32) -> np.float32:
    """Spatial weight times (1 - d^2)^8, which is exp(-8 d^2) but for a tail that ends at d = 1; no call, no branch."""
    q = np.float32(1) - difference * difference
    q = q if q > np.float32(0) else np.float32(0)
    q *= q
    q *= q
    return spatial * (q * q)


@compiled
def _add_pair(centre: F32, before: F32, after: F32, spatial: np.float32, total: F32, weights: F32) -> None:
    for k in range(centre.shape[0]):
        d0, d1 = before[k] - centre[k], after[k] - centre[k]
        w0, w1 = _weight(d0, spatial), _weight(d1, spatial)
        total[k] += w0 * d0 + w1 * d1
        weights[k] += w0 + w1


@compiled
def _start(total: F32, weights: F32) -> None:
    for k in range(total.shape[0]):
        total[k] = np.float32(0)
        weights[k] = np.float32(1)


@compiled
def _quotient(total: F32, weights: F32, unit: np.float32, out: F32) -> None:
    for k in range(out.shape[0]):
        out[k] = unit * (total[k] / weights[k])


@compiled
def _scaled(row: F32, scale: np.float32, out: F32) -> None:
    for k in range(row.shape[0]):
        out[k] = row[k] * scale


@compiled
def _sum(a: F32, b: F32, out: F32) -> None:
    for k in range(out.shape[0]):
        out[k] = a[k] + b[k]


@compiled
def smooth(image: F32, unit: np.float32, steps: I64, spatial: F32, rows: I64, columns: I64, out: F32) -> None:
    """Fill `out` with the bilateral mean of an (H, W) image.

    `unit` is the difference from which on weights are 0. `steps` (P, 2) are the neighbours dy, dx of one half of the
    window, each of which stands for the opposite one too, and `spatial` (P,) their weights beside 1 for the pixel
    itself. `rows` (H + 2 r,) and `columns` (W + 2 r,) say which ones stand in for those outside.

    The rows of a padded strip are summed as one long run, in which a neighbour is a fixed step away; what the padding
    between the rows gives is thrown away.
    """
    height, width = image.shape
    pad = (columns.shape[0] - width) // 2
    wide = width + 2 * pad
    scale = np.float32(1) / unit
    strip, change = np.empty((STRIP + 2 * pad) * wide, np.float32), np.empty(STRIP * wide, np.float32)
    total, weights = np.empty(RUN, np.float32), np.empty(RUN, np.float32)
    for top in range(0, height, STRIP):
        count = min(STRIP, height - top)
        for k in range(count + 2 * pad):
            source, row = image[rows[top + k]], strip[k * wide : (k + 1) * wide]
            _scaled(source, scale, row[pad : pad + width])
            for x in range(pad):
                row[x] = source[columns[x]] * scale
                row[pad + width + x] = source[columns[pad + width + x]] * scale
        first, length = pad * wide + pad, count * wide - 2 * pad
        for start in range(0, length, RUN):
            n, at = min(RUN, length - start), first + start
            _start(total[:n], weights[:n])
            for p in range(steps.shape[0]):
                step = steps[p, 0] * wide + steps[p, 1]
                before, after = strip[at - step : at - step + n], strip[at + step : at + step + n]
                _add_pair(strip[at : at + n], before, after, spatial[p], total[:n], weights[:n])
            _quotient(total[:n], weights[:n], unit, change[start : start + n])
        for k in range(count):
            _sum(image[top + k], change[k * wide : k * wide + width], out[top + k])


@compiled
def _difference(finer: F32, coarser: F32, out: F32) -> None:
    for k in range(out.shape[0]):
        out[k] = coarser[k] - finer[k]


@compiled
def _range_along(row: F32, low: F32, high: F32) -> None:
    """Least and greatest of each pixel and its neighbours on the row, from the second pixel on."""
    for column in range(row.shape[0] - 2):
        k = np.uint64(column)
        a, b, c = row[k], row[k + np.uint64(1)], row[k + np.uint64(2)]
        low[k + np.uint64(1)] = min(a, min(b, c))
        high[k + np.uint64(1)] = max(a, max(b, c))


@compiled
def _least(a: F32, b: F32, c: F32, out: F32) -> None:
    for k in range(out.shape[0]):
        out[k] = min(a[k], min(b[k], c[k]))


@compiled
def _greatest(a: F32, b: F32, c: F32, out: F32) -> None:
    for k in range(out.shape[0]):
        out[k] = max(a[k], max(b[k], c[k]))


@compiled
def _mark(here: F32, low: F32, high: F32, threshold: np.float32, out: U8) -> None:
    """1 at what is above the threshold and nowhere below `high`, or beneath minus the threshold and `low`."""
    for k in range(out.shape[0]):
        top = (here[k] >= high[k]) & (here[k] > threshold)
        out[k] = np.uint8(top | ((here[k] <= low[k]) & (here[k] < -threshold)))


@compiled
def _is_first(above: F32, here: F32, x: int) -> bool:
    """Whether no neighbour before a pixel in reading order has its value."""
    value = here[x]
    return bool((value != above[x - 1]) & (value != above[x]) & (value != above[x + 1]) & (value != here[x - 1]))


@compiled
def extrema(levels: F32, threshold: np.float32, at: I64, counts: I64) -> None:
    """Gather the pixels at which a difference of neighbouring levels is an extremum among its 26 neighbours.

    `levels` (K + 3, H, W) give K + 2 differences, each the coarser level less the finer; the K inner ones are searched,
    but for the outermost rows and columns, for what exceeds the threshold on either side of 0. Of equal neighbours in
    one difference the first in reading order counts. `at` (K, room) takes flat indices in reading order, `counts` (K,)
    how many; a pixel in two can be one.
    """
    number, height, width = levels.shape[0] - 1, levels.shape[1], levels.shape[2]
    rows = np.zeros((3, 3, number, width), np.float32)  # of the last three rows: difference, least, greatest along it
    low, high = np.zeros((number, width), np.float32), np.zeros((number, width), np.float32)
    least, greatest = np.empty(width, np.float32), np.empty(width, np.float32)
    marks = np.zeros((width + 7) // 8 * 8, np.uint8)
    eights = marks.view(np.uint64)
    counts[:] = 0
    for y in range(height):
        now = rows[y % 3]
        for j in range(number):
            _difference(levels[j, y], levels[j + 1, y], now[0, j])
            _range_along(now[0, j], now[1, j], now[2, j])
        if y < 2:
            continue
        one, two = rows[(y + 1) % 3], rows[(y + 2) % 3]
        for j in range(number):
            _least(one[1, j], two[1, j], now[1, j], low[j])
            _greatest(one[2, j], two[2, j], now[2, j], high[j])
        for k in range(1, number - 1):
            _least(low[k - 1], low[k], low[k + 1], least)
            _greatest(high[k - 1], high[k], high[k + 1], greatest)
            _mark(two[0, k], least, greatest, threshold, marks[:width])
            marks[0] = marks[width - 1] = np.uint8(0)
            for e in range(eights.shape[0]):
                if eights[e] == 0:
                    continue
                for x in range(8 * e, min(8 * e + 8, width)):
                    if marks[x] != 0 and _is_first(one[0, k], two[0, k], x):
                        at[k - 1, counts[k - 1]] = (y - 1) * width + x
                        counts[k - 1] += 1
