"""Compiled loops of a bilateral scale space: its weighted means, and the extrema of differences between its levels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled, inlined

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]

# Rows padded at a time, and pixels summed at a time: the sums stay in the first cache, the strip in the second.
STRIP = 16
RUN = 2048


@inlined
def _weight(difference: np.float32) -> np.float32:
    """(1 - d^2)^8, which is exp(-8 d^2) but for a tail that ends at d = 1; no call, no branch."""
    q = np.float32(1) - difference * difference
    q = q if q > np.float32(0) else np.float32(0)
    q *= q
    q *= q
    return q * q


@compiled
def _add_four(centre: F32, a: F32, b: F32, c: F32, d: F32, spatial: np.float32, total: F32, weights: F32) -> None:
    """Add four equally distant neighbours, `b` the one opposite to `a` and `d` to `c`."""
    for k in range(centre.shape[0]):
        da, db, dc, dd = a[k] - centre[k], b[k] - centre[k], c[k] - centre[k], d[k] - centre[k]
        wa, wb, wc, wd = _weight(da), _weight(db), _weight(dc), _weight(dd)
        total[k] += spatial * ((wa * da + wb * db) + (wc * dc + wd * dd))
        weights[k] += spatial * ((wa + wb) + (wc + wd))


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

    `unit` is the difference from which on weights are 0. `steps` (Q, 2, 2) are the neighbours (dy, dx), two at a time
    that are equally distant and stand for the opposite two as well; `spatial` (Q,) are their weights, that of the pixel
    itself being 1. `rows` (H + 2 r,) and `columns` (W + 2 r,) say which ones stand in for those outside.

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
            for q in range(steps.shape[0]):
                i, j = steps[q, 0, 0] * wide + steps[q, 0, 1], steps[q, 1, 0] * wide + steps[q, 1, 1]
                _add_four(
                    strip[at : at + n],
                    strip[at - i : at - i + n], strip[at + i : at + i + n],
                    strip[at - j : at - j + n], strip[at + j : at + j + n],
                    spatial[q], total[:n], weights[:n],
                )  # fmt: skip
            _quotient(total[:n], weights[:n], unit, change[start : start + n])
        for k in range(count):
            _sum(image[top + k], change[k * wide : k * wide + width], out[top + k])


@inlined
def _lower(a: np.float32, b: np.float32) -> np.float32:
    """The less of two numbers; what Python calls that has to mind NaN, which is no single instruction."""
    return a if a < b else b


@inlined
def _higher(a: np.float32, b: np.float32) -> np.float32:
    """The greater of two numbers."""
    return a if a > b else b


@compiled
def _differences(a: F32, b: F32, c: F32, d: F32, here: F32, low: F32, high: F32) -> None:
    """From a row of four levels: the middle one of their three differences, the least and the greatest of them."""
    for k in range(here.shape[0]):
        before, now, after = b[k] - a[k], c[k] - b[k], d[k] - c[k]
        here[k] = now
        low[k] = _lower(before, _lower(now, after))
        high[k] = _higher(before, _higher(now, after))


@compiled
def _least(a: F32, b: F32, c: F32, out: F32) -> None:
    for k in range(out.shape[0]):
        out[k] = _lower(a[k], _lower(b[k], c[k]))


@compiled
def _greatest(a: F32, b: F32, c: F32, out: F32) -> None:
    for k in range(out.shape[0]):
        out[k] = _higher(a[k], _higher(b[k], c[k]))


@compiled
def _mark(here: F32, low: F32, high: F32, threshold: np.float32, out: U8) -> None:
    """1 where a value above the threshold is not below `high` around, or one below minus it not above `low`."""
    for column in range(here.shape[0] - 2):
        left = np.uint64(column)
        k, right = left + np.uint64(1), left + np.uint64(2)
        value = here[k]
        top = (value >= high[left]) & (value >= high[k]) & (value >= high[right]) & (value > threshold)
        bottom = (value <= low[left]) & (value <= low[k]) & (value <= low[right]) & (value < -threshold)
        out[k] = np.uint8(top | bottom)


@compiled
def _is_first(above: F32, here: F32, x: int) -> bool:
    """Whether no neighbour before a pixel in reading order has its value."""
    value = here[x]
    return bool((value != above[x - 1]) & (value != above[x]) & (value != above[x + 1]) & (value != here[x - 1]))


@compiled
def extrema(first: F32, finer: F32, coarser: F32, last: F32, threshold: np.float32, at: I64) -> int:
    """Gather the pixels at which a difference of neighbouring levels is an extremum among its 26 neighbours.

    Four levels (H, W) give three differences, each the coarser level less the finer; the middle one is searched, but
    for the outermost rows and columns, for what exceeds the threshold on either side of 0. Of equal neighbours in it
    the first in reading order counts. `at` takes flat indices in reading order; how many is returned.
    """
    height, width = first.shape
    # Of the last three rows, one after the other.
    here = np.empty((3, width), np.float32)
    low, high = np.empty_like(here), np.empty_like(here)
    least, greatest = np.empty(width, np.float32), np.empty(width, np.float32)
    marks = np.zeros((width + 7) // 8 * 8, np.uint8)
    eights = marks.view(np.uint64)
    count = 0
    for y in range(height):
        _differences(first[y], finer[y], coarser[y], last[y], here[y % 3], low[y % 3], high[y % 3])
        if y < 2:
            continue
        _least(low[0], low[1], low[2], least)
        _greatest(high[0], high[1], high[2], greatest)
        above, row = here[(y + 1) % 3], here[(y + 2) % 3]
        _mark(row, least, greatest, threshold, marks[:width])
        for e in range(eights.shape[0]):
            if eights[e] == 0:
                continue
            for x in range(8 * e, 8 * e + 8):
                if marks[x] != 0 and _is_first(above, row, x):
                    at[count] = (y - 1) * width + x
                    count += 1
    return count
