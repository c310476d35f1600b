"""Compiled loops of the spectra of squares of two maps; `featreg.sar.correlation_filter` says what they are for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]

#: Squares of less energy hold nothing.
LEAST_ENERGY = 1e-6


@compiled
def _total(values: F32) -> np.float32:
    """Sum of values whose number is a multiple of eight."""
    a = b = c = d = e = f = g = h = np.float32(0)
    for k in range(0, values.shape[0], 8):
        a, b, c, d = a + values[k], b + values[k + 1], c + values[k + 2], d + values[k + 3]
        e, f, g, h = e + values[k + 4], f + values[k + 5], g + values[k + 6], h + values[k + 7]
    return np.float32(((a + b) + (c + d)) + ((e + f) + (g + h)))


@compiled
def _enter(row: F32, mean: np.float32, weight: np.float32, window: F32, out: F32, squares: F32) -> None:
    """Write a row less a mean under a window, and add to the sums of squares of its columns."""
    for x in range(out.shape[0]):
        value = (row[x] - mean) * (weight * window[x])
        out[x] = value
        squares[x] += value * value


@compiled
def _add(row: F32, sums: F32) -> None:
    for x in range(sums.shape[0]):
        sums[x] += row[x]


@compiled
def unit_squares(view: F32, corners: I64, window: F32, out: F32) -> None:
    """Fill `out` (S, N, S) with squares of a map, by x, square and y: less their mean, windowed, of unit energy.

    `corners` (N, 2) are the upper left (x, y), `window` (S,) the weights along each axis, S a multiple of eight. A
    square without energy becomes 0.
    """
    side = window.shape[0]
    sums, square = np.empty(side, np.float32), np.empty((side, side), np.float32)
    for i in range(corners.shape[0]):
        left, top = corners[i, 0], corners[i, 1]
        sums[:] = 0
        for y in range(side):
            _add(view[top + y, left : left + side], sums)
        mean = np.float32(_total(sums) / np.float32(side * side))
        sums[:] = 0
        for y in range(side):
            _enter(view[top + y, left : left + side], mean, window[y], window, square[y], sums)
        energy = np.sqrt(_total(sums))
        factor = np.float32(1) / energy if energy > np.float32(LEAST_ENERGY) else np.float32(0)
        for x in range(side):
            for y in range(side):
                out[x, i, y] = square[y, x] * factor


@compiled
def _products(
    a_rc: F32, a_rs: F32, a_ic: F32, a_is: F32, b_rc: F32, b_rs: F32, b_ic: F32, b_is: F32, sums: F32
) -> None:
    """Add to `sums` (3, S) the cross-product and both powers of two rows of spectra, given in four parts each."""
    cross, power, other = sums[0], sums[1], sums[2]
    for y in range(cross.shape[0]):
        here_re, here_im = a_rc[y] - a_is[y], a_rs[y] + a_ic[y]
        there_re, there_im = b_rc[y] - b_is[y], b_rs[y] + b_ic[y]
        cross[y] += here_re * there_re + here_im * there_im
        power[y] += here_re * here_re + here_im * here_im
        other[y] += there_re * there_re + there_im * there_im


@compiled
def summed_spectra(first: F32, second: F32, out: F32) -> None:
    """Fill `out` (3, F, S) with the cross-spectrum and both power spectra, by x and y, summed over squares.

    `first` and `second` (2, F, N, 2 * S) are the products of squares with the real and the imaginary waves of each
    frequency along x and, side by side, with those along y.
    """
    side = out.shape[2]
    sums = np.empty((3, side), np.float32)
    for k in range(out.shape[1]):
        sums[:] = 0
        for i in range(first.shape[2]):
            a, b, c, d = first[0, k, i], first[1, k, i], second[0, k, i], second[1, k, i]
            _products(a[:side], a[side:], b[:side], b[side:], c[:side], c[side:], d[:side], d[side:], sums)
        for y in range(side):
            out[0, k, y], out[1, k, y], out[2, k, y] = sums[0, y], sums[1, y], sums[2, y]
