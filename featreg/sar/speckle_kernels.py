"""Compiled loops of the views of an amplitude: invalid pixels filled, logarithm, smoothed logarithm."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled
from featreg.sar.logarithm_kernels import fast_log
from featreg.sar.smoothing_kernels import mirrored, smoothed_across, smoothed_along

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]


@compiled
def filled(amplitude: F32, valid: U8, value: np.float32, out: F32) -> None:
    """Copy flat `amplitude` to `out`, with `value` where `valid` is 0."""
    for i in range(out.shape[0]):
        here = amplitude[i]
        out[i] = here if valid[i] != 0 else value


@compiled
def logarithms(amplitude: F32, floor: np.float32, out: F32) -> None:
    """Logarithm of flat `amplitude`, at least that of `floor` > 0."""
    for i in range(out.shape[0]):
        out[i] = fast_log(amplitude[i] if amplitude[i] > floor else floor)


@compiled
def _in_steps(row: F32, gain: np.float32, offset: np.float32, out: U8) -> None:
    for x in range(out.shape[0]):
        value = gain * row[x] + offset
        value = value if value > np.float32(0) else np.float32(0)
        out[x] = np.uint8(np.int32(value if value < np.float32(255) else np.float32(255)))


@compiled
def smoothed_logarithms(
    amplitude: F32, floor: np.float32, taps: F32, gain: np.float32, offset: np.float32, top: int, bottom: int,
    smooth: F32, steps: U8,
) -> None:  # fmt: skip
    """Logarithm of `amplitude` (H, W), at least that of `floor`, smoothed by a symmetric filter along x and along y.

    Of the rows `top` to before `bottom`.

    `taps` (R + 1,), R >= 1, are those of the middle and of the pixels beside it; borders are mirrored. The rows that
    are needed at once stay in the cache. The result goes to `smooth` (H, W), or where `steps` is (H, W) there, as
    gain * value + offset in whole numbers from 0 to 255; the other has no rows.
    """
    height, width = amplitude.shape
    reach = taps.shape[0] - 1
    side = 2 * reach + 1
    ring = np.empty((side, width), np.float32)
    line, total = np.empty(width + 2 * reach, np.float32), np.empty(width, np.float32)
    places = np.empty(side, np.int64)
    for y in range(max(top - reach, 0) - reach, bottom):
        enter = y + reach
        if enter < height:
            logarithms(amplitude[enter], floor, line[reach : reach + width])
            for k in range(1, reach + 1):
                line[reach - k] = line[reach + mirrored(-k, width)]
                line[reach + width - 1 + k] = line[reach + mirrored(width - 1 + k, width)]
            smoothed_along(line, taps, ring[enter % side])
        if y < top:
            continue
        for k in range(side):
            places[k] = mirrored(y + k - reach, height) % side
        if steps.shape[0] > 0:
            smoothed_across(ring, places, taps, total)
            _in_steps(total, gain, offset, steps[y])
        else:
            smoothed_across(ring, places, taps, smooth[y])


@compiled
def smoothed_logarithms_of_tiles(
    amplitude: F32, floor: np.float32, taps: F32, gain: np.float32, offset: np.float32, wanted: U8, upper: int,
    lower: int, side: int, steps: U8,
) -> None:  # fmt: skip
    """As `smoothed_logarithms`, to `steps` (H, W), of the squares of `side` pixels whose number in `wanted` is 1.

    `wanted` (rows, columns) of squares, those at the right and lower end being what is left; made ones become 2. Of its
    rows `upper` to before `lower` are looked at.
    """
    height, width = amplitude.shape
    reach = taps.shape[0] - 1
    count = 2 * reach + 1
    ring = np.empty((count, width), np.float32)
    line, total = np.empty(width + 2 * reach, np.float32), np.empty(width, np.float32)
    places = np.empty(count, np.int64)
    for row in range(upper, lower):
        top, bottom = row * side, min((row + 1) * side, height)
        column = 0
        while column < wanted.shape[1]:
            if wanted[row, column] != 1:
                column += 1
                continue
            first = column
            while column < wanted.shape[1] and wanted[row, column] == 1:
                wanted[row, column] = 2
                column += 1
            left, right = first * side, min(column * side, width)
            start, stop = max(left - reach, 0), min(right + reach, width)
            for y in range(top - reach, bottom + reach):
                # `line` begins `reach` before the first wanted column.
                within = start - left + reach
                logarithms(amplitude[mirrored(y, height), start:stop], floor, line[within : within + stop - start])
                for k in range(1, reach + 1):
                    if left - k < 0:
                        line[reach - k] = line[reach + mirrored(left - k, width) - left]
                    if right - 1 + k >= width:
                        line[reach + right - 1 + k - left] = line[reach + mirrored(right - 1 + k, width) - left]
                at = (y - top + reach) % count
                smoothed_along(line[: right - left + 2 * reach], taps, ring[at, : right - left])
                if y < top + reach:
                    continue
                for k in range(count):
                    places[k] = (y - top + reach - 2 * reach + k) % count
                smoothed_across(ring[:, : right - left], places, taps, total[: right - left])
                _in_steps(total[: right - left], gain, offset, steps[y - reach, left:right])
