"""Compiled loops of the Harris response of a gradient field, and of the maxima of a response."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled
from featreg.sar.gradients.strip_kernels import strip, weights_beside
from featreg.sar.keypoints.binary_kernels import lowest_byte
from featreg.sar.smoothing_kernels import smoothed_across, smoothed_along

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
def _response_of_row(xx: F32, xy: F32, yy: F32, d: np.float32, out: F32) -> None:
    for i in range(out.shape[0]):
        trace = xx[i] + yy[i]
        out[i] = xx[i] * yy[i] - xy[i] * xy[i] - d * trace * trace


@compiled
def _next_row(
    gx: F32, gy: F32, y: int, taps: F32, rows: I64, columns: I64, d: np.float32, done: int, bottom: int, ring: F32,
    product: F32, smooth: F32, places: I64, out: F32,
) -> int:  # fmt: skip
    """Take in row `y` of a gradient field, and write the rows of the response before `bottom` that wait for no other.

    `done` is how many were written before; how many there are now is returned.
    """
    height, width = out.shape
    reach = taps.shape[0] - 1
    side = 2 * reach + 1
    _products_of_row(
        gx, gy,
        product[0, reach : reach + width], product[1, reach : reach + width], product[2, reach : reach + width],
    )  # fmt: skip
    for n in range(3):
        for k in range(reach):
            product[n, k] = product[n, reach + columns[k]]
            product[n, reach + width + k] = product[n, reach + columns[reach + width + k]]
        smoothed_along(product[n], taps, ring[n, y % side])
    # A row is complete when the last one that it needs is there; the last ones wait for the last of all.
    ready = min(y - reach + 1 if y < height - 1 else height, bottom)
    for row in range(done, ready):
        for k in range(side):
            places[k] = rows[row + k] % side
        for n in range(3):
            smoothed_across(ring[n], places, taps, smooth[n])
        _response_of_row(smooth[0], smooth[1], smooth[2], d, out[row])
    return int(max(done, ready))


@compiled
def response(
    gx: F32, gy: F32, taps: F32, rows: I64, columns: I64, d: np.float32, top: int, bottom: int, out: F32
) -> None:
    """Fill `out` with det - d trace^2 of the smoothed matrix of a gradient field (H, W), `top` to before `bottom`.

    `taps` (1 + reach,) are the weights of a symmetric filter from its middle on; `rows` (H + 2 * reach,) and `columns`
    (W + 2 * reach,) name the row and the column that stands at each place from `reach` before the first on, so that the
    border is the caller's. What is smoothed along rows waits in a ring of as many rows as the filter is high: nothing
    but the gradients and the response leaves the cache.
    """
    width, reach = gx.shape[1], taps.shape[0] - 1
    ring = np.empty((3, 2 * reach + 1, width), np.float32)
    product, smooth = np.empty((3, width + 2 * reach), np.float32), np.empty((3, width), np.float32)
    places = np.empty(2 * reach + 1, np.int64)
    done = top
    for y in range(max(top - reach, 0), min(bottom + reach, gx.shape[0])):
        done = _next_row(gx[y], gy[y], y, taps, rows, columns, d, done, bottom, ring, product, smooth, places, out)


@compiled
def response_of_ratios(
    image: F32, offset: np.float32, decay: np.float32, tiny: np.float32, share_x: F32, share_y: F32, strip_rows: int,
    halo: int, taps: F32, rows: I64, columns: I64, d: np.float32, out: F32,
) -> None:  # fmt: skip
    """As `response`, of the ratio gradients of an image plus an offset, 0 across its border, of which no map is made.

    What comes before `taps` is as in `featreg.sar.gradients.strip_kernels.strip`.
    """
    height, width = image.shape
    reach = taps.shape[0] - 1
    up, beside = np.zeros((2, strip_rows + halo + 1, width), np.float32), weights_beside(share_x, decay)
    gx, gy = np.empty((strip_rows, width), np.float32), np.empty((strip_rows, width), np.float32)
    ring = np.empty((3, 2 * reach + 1, width), np.float32)
    product, smooth = np.empty((3, width + 2 * reach), np.float32), np.empty((3, width), np.float32)
    places = np.empty(2 * reach + 1, np.int64)
    done = 0
    for top in range(0, height, strip_rows):
        strip(image, top, strip_rows, halo, offset, decay, tiny, beside, share_y, up, gx, gy)
        for y in range(top, min(top + strip_rows, height)):
            across, down = gx[y - top], gy[y - top]
            across[0], across[width - 1] = np.float32(0), np.float32(0)
            if y == 0 or y == height - 1:
                down[:] = np.float32(0)
            done = _next_row(across, down, y, taps, rows, columns, d, done, height, ring, product, smooth, places, out)


@compiled
def _peaks_of_row(above: F32, here: F32, below: F32, threshold: np.float32, peak: U8) -> None:
    for column in range(here.shape[0] - 2):
        x0 = np.uint64(column)
        x1, x2 = x0 + np.uint64(1), x0 + np.uint64(2)
        value = here[x1]
        # Comparisons become vectors; the greatest of floats would have to mind NaN.
        first = (value > above[x0]) & (value > above[x1]) & (value > above[x2]) & (value > here[x0])
        last = (value >= below[x0]) & (value >= below[x1]) & (value >= below[x2]) & (value >= here[x2])
        peak[x1] = np.uint8(first & last & (value > threshold))


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
            left = eights[k]
            while left != 0:
                byte = lowest_byte(left)
                left &= left - np.uint64(1)
                x = 8 * k + np.int64(byte)
                at[count] = y * width + x
                count += 1 if allowed[y, x] != 0 else 0
    return count
