"""Compiled loops of orientation correlation; `search` and `windows` say what they compute."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

F32 = NDArray[np.float32]
C64 = NDArray[np.complex64]
I64 = NDArray[np.int64]


@compiled
def cross_spectra(real: C64, imaginary: C64, there: C64, quarter: bool, sign: np.float32, out: C64) -> None:
    """Fill `out` (n, n) with the spectrum whose inverse is correlation + i correlation after half a turn.

    Parameters
    ----------
    real, imaginary : (n, n) spectra of the two components of the first field
    there : (n, n) spectrum of the second field, as one complex map
    quarter : whether the second field is turned by a quarter first
    sign : factor on both correlations
    """
    n = out.shape[0]
    half = np.float32(0.5) * sign
    for row in range(n):
        for col in range(n):
            r, c = (col, (n - row) % n) if quarter else (row, col)
            f = there[r, c]
            g = there[(n - r) % n, (n - c) % n]
            # The spectra of the two real components of the second field, twice.
            br_re, br_im = f.real + g.real, f.imag - g.imag
            bi_re, bi_im = f.imag + g.imag, g.real - f.real
            a, b = real[row, col], imaginary[row, col]
            # One product with the conjugate, one without: half a turn mirrors a map, which conjugates its spectrum.
            direct_re = a.real * br_re + a.imag * br_im + b.real * bi_re + b.imag * bi_im
            direct_im = a.imag * br_re - a.real * br_im + b.imag * bi_re - b.real * bi_im
            turned_re = a.real * br_re - a.imag * br_im + b.real * bi_re - b.imag * bi_im
            turned_im = a.imag * br_re + a.real * br_im + b.imag * bi_re + b.real * bi_im
            out[row, col] = np.complex64(complex(half * (direct_re - turned_im), half * (direct_im + turned_re)))


@compiled
def highest(found: F32, energy: F32, least: np.float32, best: NDArray[np.float64]) -> None:
    """Fill best[k] = (score, row, column) of the highest of two packed correlations over their noise.

    found : (n, n, 2) the correlations; energy : (n // 2, n // 2, 2) those of the squared fields, on half the grid
    least : least energy at which a shift counts
    """
    n = found.shape[0]
    m = energy.shape[0]
    weight = np.empty((m, 2), np.float32)
    best[:, 0] = -1.0
    best[:, 1:] = 0.0
    for row in range(n):
        if row % 2 == 0:
            for col in range(m):
                for k in range(2):
                    e = energy[row // 2, col, k]
                    weight[col, k] = np.float32(0) if e < least else np.float32(1) / np.sqrt(np.float32(0.5) * e)
        for k in range(2):
            for col in range(n):
                value = found[row, col, k] * weight[col // 2, k]
                if value > best[k, 0]:
                    best[k, 0], best[k, 1], best[k, 2] = value, row, col


@compiled
def _added(values: F32, start: int, total: F32) -> None:
    here = np.uint64(start)
    for k in range(np.uint64(total.shape[0])):
        total[k] += values[here + k]


@compiled
def stacked(surfaces: F32, moves: I64, out: NDArray[np.float64]) -> None:
    """Fill out[h] = (sum, dy, dx) of the highest sum of the surfaces (N, K, K), each moved by moves[h, i] = (x, y)."""
    count, side = surfaces.shape[0], surfaces.shape[1]
    most = 0
    for h in range(moves.shape[0]):
        for i in range(count):
            most = max(most, abs(moves[h, i, 0]), abs(moves[h, i, 1]))
    # A surface that moves farther than it is wide adds nothing.
    most = min(most, side)
    # In a frame of zeros a moved surface is one run of values; what lies between its rows is not looked at.
    wide = side + 2 * most
    framed = np.zeros(count * wide * wide, np.float32)
    for i in range(count):
        for y in range(side):
            start = (i * wide + most + y) * wide + most
            for x in range(side):
                framed[start + x] = surfaces[i, y, x]
    total = np.empty((side - 1) * wide + side, np.float32)
    for h in range(moves.shape[0]):
        total[:] = 0
        for i in range(count):
            mx, my = moves[h, i, 0], moves[h, i, 1]
            if abs(mx) < side and abs(my) < side:
                _added(framed, (i * wide + most + my) * wide + most + mx, total)
        best = total[0]
        at_y, at_x = 0, 0
        for y in range(side):
            for x in range(side):
                if total[y * wide + x] > best:
                    best, at_y, at_x = total[y * wide + x], y, x
        out[h, 0], out[h, 1], out[h, 2] = best, at_y - side // 2, at_x - side // 2


@compiled
def _raised(values: F32, start: int, highest: F32) -> None:
    here = np.uint64(start)
    for k in range(np.uint64(highest.shape[0])):
        highest[k] = max(highest[k], values[here + k])


@compiled
def shares_as_high(values: F32, side: int, around: I64, margin: int, at: I64, out: NDArray[np.float64]) -> None:
    """Fill out[i] with the share of the places of the i-th surface that are as high as one of them.

    Parameters
    ----------
    values : the surfaces (N, side, side), one after the other
    around : (D, 2) displacements (x, y) of at most `margin`; a place is as high as the highest value at these from it
    margin : a place lies at least so far inside
    at : (N, 2) the place (x, y) with which all are compared, counted from the first one
    """
    inner = side - 2 * margin
    highest = np.empty((inner - 1) * side + inner, np.float32)
    for i in range(at.shape[0]):
        first = (i * side + margin) * side + margin
        highest[:] = -np.inf
        for d in range(around.shape[0]):
            _raised(values, first + around[d, 1] * side + around[d, 0], highest)
        least, count = highest[at[i, 1] * side + at[i, 0]], 0
        for y in range(inner):
            for x in range(inner):
                if highest[y * side + x] >= least:
                    count += 1
        out[i] = count / (inner * inner)
