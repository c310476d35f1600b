"""Compiled loops of the Harris response of a gradient field, and of the maxima of a response."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
I64 = NDArray[np.int64]


@compiled
def _products_of_row(gx: F32, gy: F32, xx: F32, xy: F32, yy: F32) -> None:
    for i in range(gx.shape[0]):
        xx[i] = gx[i] * gx[i]
        xy[i] = gx[i] * gy[i]
        yy[i] = gy[i] * gy[i]


@compiled
def _three(before: F32, middle: F32, after: F32, w0: np.float32, w1: np.float32, out: F32) -> None:
    for i in range(out.shape[0]):
        out[i] = w0 * middle[i] + w1 * (before[i] + after[i])


@compiled
def _five(
    a: F32, b: F32, middle: F32, c: F32, d: F32, w0: np.float32, w1: np.float32, w2: np.float32, out: F32
) -> None:
    for i in range(out.shape[0]):
        out[i] = w0 * middle[i] + w1 * (b[i] + c[i]) + w2 * (a[i] + d[i])


@compiled
def _two_more(before: F32, after: F32, weight: np.float32, out: F32) -> None:
    for i in range(out.shape[0]):
        out[i] += weight * (before[i] + after[i])


@compiled
def _four_more(a: F32, b: F32, c: F32, d: F32, inner: np.float32, outer: np.float32, out: F32) -> None:
    for i in range(out.shape[0]):
        out[i] += inner * (b[i] + c[i]) + outer * (a[i] + d[i])


@compiled
def smoothed_along(row: F32, taps: F32, out: F32) -> None:
    """Smooth a row, which is as much longer than `out` on both sides as there are taps beside the middle one."""
    m, n = taps.shape[0] - 1, out.shape[0]
    if m == 1:
        _three(row[:n], row[1 : 1 + n], row[2 : 2 + n], taps[0], taps[1], out)
        return
    _five(
        row[m - 2 : m - 2 + n], row[m - 1 : m - 1 + n], row[m : m + n], row[m + 1 : m + 1 + n], row[m + 2 : m + 2 + n],
        taps[0], taps[1], taps[2], out,
    )  # fmt: skip
    for k in range(3, m, 2):
        a, b, c, d = m - k - 1, m - k, m + k, m + k + 1
        _four_more(row[a : a + n], row[b : b + n], row[c : c + n], row[d : d + n], taps[k], taps[k + 1], out)
    if m % 2:
        _two_more(row[:n], row[2 * m : 2 * m + n], taps[m], out)


@compiled
def smoothed_across(rows: F32, at: I64, taps: F32, out: F32) -> None:
    """Smooth across rows (n, W), of which those `at` (2 * reach + 1,) lie around the wanted one, in order."""
    m = taps.shape[0] - 1
    if m == 1:
        _three(rows[at[0]], rows[at[1]], rows[at[2]], taps[0], taps[1], out)
        return
    _five(
        rows[at[m - 2]], rows[at[m - 1]], rows[at[m]], rows[at[m + 1]], rows[at[m + 2]], taps[0], taps[1], taps[2], out
    )
    for k in range(3, m, 2):
        a, b, c, d = rows[at[m - k - 1]], rows[at[m - k]], rows[at[m + k]], rows[at[m + k + 1]]
        _four_more(a, b, c, d, taps[k], taps[k + 1], out)
    if m % 2:
        _two_more(rows[at[0]], rows[at[2 * m]], taps[m], out)


@compiled
def _response_of_row(xx: F32, xy: F32, yy: F32, d: np.float32, out: F32) -> None:
    for i in range(out.shape[0]):
        trace = xx[i] + yy[i]
        out[i] = xx[i] * yy[i] - xy[i] * xy[i] - d * trace * trace


@compiled
def response(gx: F32, gy: F32, taps: F32, rows: I64, columns: I64, d: np.float32, out: F32) -> None:
    """Fill `out` with det - d trace^2 of the smoothed matrix of a gradient field (H, W).

    `taps` (1 + reach,) are the weights of a symmetric filter from its middle on; `rows` (H + 2 * reach,) and `columns`
    (W + 2 * reach,) name the row and the column that stands at each place from `reach` before the first on, so that the
    border is the caller's. What is smoothed along rows waits in a ring of as many rows as the filter is high: nothing
    but the gradients and the response leaves the cache.
    """
    height, width = gx.shape
    reach = taps.shape[0] - 1
    side = 2 * reach + 1
    ring = np.empty((3, side, width), np.float32)
    product, smooth = np.empty((3, width + 2 * reach), np.float32), np.empty((3, width), np.float32)
    places = np.empty(side, np.int64)
    done = 0
    for y in range(height):
        _products_of_row(
            gx[y], gy[y],
            product[0, reach : reach + width], product[1, reach : reach + width], product[2, reach : reach + width],
        )  # fmt: skip
        for n in range(3):
            for k in range(reach):
                product[n, k] = product[n, reach + columns[k]]
                product[n, reach + width + k] = product[n, reach + columns[reach + width + k]]
            smoothed_along(product[n], taps, ring[n, y % side])
        # A row is complete when the last one that it needs is there; the last ones wait for the last of all.
        ready = y - reach + 1 if y < height - 1 else height
        for row in range(done, ready):
            for k in range(side):
                places[k] = rows[row + k] % side
            for n in range(3):
                smoothed_across(ring[n], places, taps, smooth[n])
            _response_of_row(smooth[0], smooth[1], smooth[2], d, out[row])
        done = max(done, ready)


@compiled
def _peaks_of_row(above: F32, here: F32, below: F32, threshold: np.float32, peak: U8) -> None:
    for column in range(here.shape[0] - 2):
        x0 = np.uint64(column)
        x1, x2 = x0 + np.uint64(1), x0 + np.uint64(2)
        value = here[x1]
        before = max(max(above[x0], above[x1]), max(above[x2], here[x0]))
        after = max(max(below[x0], below[x1]), max(below[x2], here[x2]))
        peak[x1] = np.uint8((value > before) & (value >= after) & (value > threshold))


@compiled
def collect_peaks(response: F32, allowed: U8, threshold: np.float32, at: I64) -> int:
    """Gather the flat indices of local maxima above `threshold` at pixels with `allowed` != 0; return how many."""
    height, width = response.shape
    peak = np.zeros((width + 7) // 8 * 8, np.uint8)
    eights = peak.view(np.uint64)
    count = 0
    for y in range(1, height - 1):
        _peaks_of_row(response[y - 1], response[y], response[y + 1], threshold, peak[:width])
        for k in range(eights.shape[0]):
            if eights[k] == 0:
                continue
            for x in range(8 * k, min(8 * k + 8, width)):
                if peak[x] != 0 and allowed[y, x] != 0:
                    at[count] = y * width + x
                    count += 1
    return count
