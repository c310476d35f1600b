"""Compiled loops of the scale pyramid: an image and its mask, of zeros and ones, made smaller in one pass."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]
U8 = NDArray[np.uint8]


@compiled
def _between_rows(upper: F32, lower: F32, share: np.float32, line: F32) -> None:
    for x in range(line.shape[0]):
        line[x] = upper[x] + share * (lower[x] - upper[x])


@compiled
def _between_columns(line: F32, left: I32, share: F32, out: F32) -> None:
    for x in range(out.shape[0]):
        k = np.uint64(left[x])
        out[x] = line[k] + share[x] * (line[k + np.uint64(1)] - line[k])


@compiled
def _both_rows(upper: U8, lower: U8, line: U8) -> None:
    for x in range(line.shape[0]):
        line[x] = upper[x] & lower[x]


@compiled
def _all_ones(line: U8, first: int, last: int) -> bool:
    left = np.uint8(1)
    for x in range(first, last):
        left &= line[np.uint64(x)]
    return bool(left != 0)


@compiled
def _both_columns(line: U8, left: I32, out: U8) -> None:
    """Where both of two neighbouring columns are 1; quick for a row of ones between zeros, which most rows are."""
    first, last = 0, line.shape[0]
    while first < last and line[first] == 0:
        first += 1
    while last > first and line[last - 1] == 0:
        last -= 1
    if _all_ones(line, first, last):
        begin, end = 0, out.shape[0]
        while begin < end and left[begin] < first:
            begin += 1
        while end > begin and left[end - 1] + 1 >= last:
            end -= 1
        out[:begin] = 0
        out[begin:end] = 1
        out[end:] = 0
        return
    for x in range(out.shape[0]):
        k = np.uint64(left[x])
        out[x] = line[k] & line[k + np.uint64(1)]


@compiled
def _cleared(valid: U8, out: F32) -> None:
    for x in range(out.shape[0]):
        out[x] = out[x] if valid[x] != 0 else np.float32(0)


@compiled
def interpolated(pixels: F32, valid: U8, left: I32, along: F32, top: I32, down: F32, out: F32, out_valid: U8) -> None:
    """Interpolate an image (H, W) linearly between four pixels for each of `out` (h, w).

    `left` (w,) and `top` (h,) are the first of two neighbouring columns and rows, `along` and `down` the share of the
    second. Where `valid` (H, W) has rows, a pixel of which one of the four is 0 there becomes 0, in `out_valid` (h, w)
    too; without, `out_valid` is left alone.
    """
    width = pixels.shape[1]
    line, good = np.empty(width, np.float32), np.empty(width, np.uint8)
    for y in range(out.shape[0]):
        row = top[y]
        _between_rows(pixels[row], pixels[row + 1], down[y], line)
        _between_columns(line, left, along, out[y])
        if valid.shape[0] > 0:
            _both_rows(valid[row], valid[row + 1], good)
            _both_columns(good, left, out_valid[y])
            _cleared(out_valid[y], out[y])
