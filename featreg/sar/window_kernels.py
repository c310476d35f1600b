"""Compiled loops over windows around points, where the image around them all would be more than is needed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled
from featreg.sar.affine_kernels import looked_up
from featreg.sar.smoothing_kernels import mirrored, smoothed_across, smoothed_along
from featreg.sar.speckle_kernels import logarithms

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]


@compiled
def _copied(row: F32, out: F32) -> None:
    for x in range(out.shape[0]):
        out[x] = row[x]


@compiled
def log_windows(amplitude: F32, floor: np.float32, corners: I64, side: int, out: F32) -> None:
    """Fill `out`, squares of `side` px one after the other, with the logarithm of the amplitude (H, W).

    They begin at corners (N, 2). Amplitudes are `floor` at least; beyond its rim the image is mirrored.
    """
    height, width = amplitude.shape
    # Logarithms of a whole window at once have no rest of a few pixels for each row.
    size = side * side
    copied = np.empty(size, np.float32)
    for i in range(corners.shape[0]):
        left, top = corners[i, 0], corners[i, 1]
        inside = left >= 0 and left + side <= width
        for r in range(side):
            y, row = mirrored(top + r, height), copied[r * side : (r + 1) * side]
            if inside:
                _copied(amplitude[y, left : left + side], row)
            else:
                for c in range(side):
                    row[c] = amplitude[y, mirrored(left + c, width)]
        logarithms(copied, floor, out[i * size : (i + 1) * size])


@compiled
def _added(row: F32, out: F32) -> None:
    for x in range(out.shape[0]):
        out[x] += row[x]


@compiled
def smoothed_windows(windows: F32, across: F32, down: F32, out: F32) -> None:
    """Fill `out` with windows (N, h, w) under a sum of separable symmetric filters; the rims are used up.

    `across` and `down` (T, 1 + reach) are the taps from the middle on, `out` is (N, h - 2 * reach, w - 2 * reach).
    """
    terms, reach = across.shape[0], across.shape[1] - 1
    n, rows, columns = out.shape
    part, row = np.empty((rows + 2 * reach, columns), np.float32), np.empty(columns, np.float32)
    at = np.empty(2 * reach + 1, np.int64)
    for i in range(n):
        for t in range(terms):
            for y in range(rows + 2 * reach):
                smoothed_along(windows[i, y], across[t], part[y])
            for y in range(rows):
                for k in range(2 * reach + 1):
                    at[k] = y + k
                if t == 0:
                    smoothed_across(part, at, down[t], out[i, y])
                else:
                    smoothed_across(part, at, down[t], row)
                    _added(row, out[i, y])


@compiled
def _places(
    base_x: np.float32, base_y: np.float32, shift_x: F32, shift_y: F32, low_x: np.float32, low_y: np.float32,
    high_x: np.float32, high_y: np.float32, width: np.int32, at: I32, right: F32, below: F32,
) -> None:  # fmt: skip
    """Where a row of a window lies in a box, into which it is brought: the pixel before, and the rest along x and y."""
    zero = np.float32(0)
    for c in range(at.shape[0]):
        x = min(max(max(base_x + shift_x[c], low_x), zero), high_x)
        y = min(max(max(base_y + shift_y[c], low_y), zero), high_y)
        left, top = np.int32(x), np.int32(y)
        right[c], below[c] = x - np.float32(left), y - np.float32(top)
        at[c] = np.int32(top * width + left)


@compiled
def sampled_windows(
    boxes: F32, box_width: int, starts: I64, height: int, width: int, affine: F64, corners: I64, rows: int,
    columns: int, out: F32,
) -> None:  # fmt: skip
    """Fill `out` (N, h, w) with an image at the places to which affine maps (N, 2, 3) take windows of a grid.

    Parameters
    ----------
    boxes, box_width, starts : (N, H * W) the parts of the image that are needed, row by row, the length of their rows,
        and the (x, y) at which they begin in the image; they reach at least one pixel beyond what is asked for
    height, width : of the image, beyond whose rim its last pixels go on
    corners : (N, 2) where the windows begin on a grid of `rows` x `columns`, beyond whose rim it is mirrored
    """
    n, high, wide = out.shape
    box_height = boxes.shape[1] // box_width
    # Whole vectors of places; those behind the last are not looked up.
    padded = (wide + 15) // 16 * 16
    shift_x, shift_y = np.zeros(padded, np.float32), np.zeros(padded, np.float32)
    right, below = np.empty(padded, np.float32), np.empty(padded, np.float32)
    at = np.empty(padded, np.int32)
    for i in range(n):
        map_to = affine[i]
        left, top = corners[i, 0], corners[i, 1]
        for c in range(wide):
            x = np.float64(mirrored(left + c, columns) - left)
            shift_x[c], shift_y[c] = np.float32(map_to[0, 0] * x), np.float32(map_to[1, 0] * x)
        # Places are brought into the image first and into the box after that; both as seen from the box.
        x0, y0 = np.float64(starts[i, 0]), np.float64(starts[i, 1])
        low_x, high_x = np.float32(max(-x0, 0.0)), np.float32(max(min(width - 1 - x0, box_width - 1.001), 0.0))
        low_y, high_y = np.float32(max(-y0, 0.0)), np.float32(max(min(height - 1 - y0, box_height - 1.001), 0.0))
        for r in range(high):
            y = np.float64(mirrored(top + r, rows))
            base_x = np.float32(map_to[0, 0] * left + map_to[0, 1] * y + map_to[0, 2] - x0)
            base_y = np.float32(map_to[1, 0] * left + map_to[1, 1] * y + map_to[1, 2] - y0)
            _places(
                base_x, base_y, shift_x, shift_y, low_x, low_y, high_x, high_y, np.int32(box_width), at, right, below
            )
            looked_up(boxes[i], 0, box_width, at[:wide], right, below, out[i, r])


@compiled
def _sampled_whole(
    valid: NDArray[np.uint8], m: F64, left: float, top: float, step: float, parts: int, rows: int, columns: int
) -> bool:
    """Whether an image is valid at the places to which `m` (2, 3) takes samples of a window, inside the grid."""
    height, width = valid.shape
    for row in range(parts + 1):
        y = min(max(top + row * step, 0.0), rows - 1.0)
        for column in range(parts + 1):
            x = min(max(left + column * step, 0.0), columns - 1.0)
            u = np.floor(m[0, 0] * x + m[0, 1] * y + m[0, 2] + 0.5)
            v = np.floor(m[1, 0] * x + m[1, 1] * y + m[1, 2] + 0.5)
            if not (u >= 0.0 and v >= 0.0 and u < width and v < height):
                return False
            if valid[np.int64(v), np.int64(u)] == 0:
                return False
    return True


@compiled
def whole_windows(
    valid: NDArray[np.uint8], sums: NDArray[np.int32], affine: F64, middles: I64, reach: int, parts: int, rows: int,
    columns: int, out: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Mark the windows of a grid of `rows` x `columns` that lie where an image is valid.

    Parameters
    ----------
    valid : (H, W) 1 where the image is valid; whatever is not is at least as large as samples lie apart
    sums : (H + 1, W + 1) of `valid` above and to the left: a box that is valid all over needs no samples
    affine : (1, 2, 3), or (N, 2, 3) one for each window, from the grid to the image
    middles, reach : (N, 2) whole pixels (x, y), and how far the windows reach around them, px; beyond the grid no more
    parts : of a window's side, at whose ends is looked
    out : (N,)
    """
    height, width = valid.shape
    for i in range(middles.shape[0]):
        m = affine[i if affine.shape[0] > 1 else 0]
        x, y = np.float64(middles[i, 0]), np.float64(middles[i, 1])
        u, v = m[0, 0] * x + m[0, 1] * y + m[0, 2], m[1, 0] * x + m[1, 1] * y + m[1, 2]
        if not (u > -1e9 and u < 1e9 and v > -1e9 and v < 1e9):
            out[i] = False
            continue
        along, down = reach * (abs(m[0, 0]) + abs(m[0, 1])), reach * (abs(m[1, 0]) + abs(m[1, 1]))
        left, right = np.int64(np.floor(u - along)), np.int64(np.ceil(u + along)) + 1
        top, bottom = np.int64(np.floor(v - down)), np.int64(np.ceil(v + down)) + 1
        good = False
        if left >= 0 and top >= 0 and right <= width and bottom <= height:
            inside = sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left]
            good = inside == (right - left) * (bottom - top)
        out[i] = good or _sampled_whole(valid, m, x - reach, y - reach, 2.0 * reach / parts, parts, rows, columns)
