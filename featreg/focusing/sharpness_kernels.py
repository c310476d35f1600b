"""Kernels of the image criteria: weights of the fixed-point steps and entropy sums, one row at a time.

Rows are range cells in azimuth; a complex64 row is passed as float32 pairs, because that is what vectorises.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]

LN2 = np.float32(np.log(2.0))
#: Bits of sqrt(1/2): subtracted, they leave the exponent of x = 2^e m with m in [sqrt(1/2), sqrt(2)).
HALF = np.int32(0x3F3504F3)
THIRD, FIFTH, SEVENTH, NINTH = np.float32(1 / 3), np.float32(1 / 5), np.float32(1 / 7), np.float32(1 / 9)


@compiled
def _powers(row: F32, scale: np.float32, power: F32) -> None:
    for i in range(power.size):
        power[i] = (row[2 * i] * row[2 * i] + row[2 * i + 1] * row[2 * i + 1]) * scale


@compiled
def _logarithms(bits: I32, mantissa: I32, value: F32, exponent: F32, out: F32) -> None:
    """ln by the series of 2 artanh((m - 1) / (m + 1)), to the rounding of float32; of 0 it is about -87."""
    for i in range(bits.size):
        power_of_two = (bits[i] - HALF) >> 23
        mantissa[i] = bits[i] - (power_of_two << 23)
        exponent[i] = np.float32(power_of_two)
    for i in range(bits.size):
        s = (value[i] - np.float32(1)) / (value[i] + np.float32(1))
        q = s * s
        series = np.float32(1) + q * (THIRD + q * (FIFTH + q * (SEVENTH + q * NINTH)))
        out[i] = exponent[i] * LN2 + np.float32(2) * s * series


@compiled
def _scale_pairs(row: F32, weight: F32) -> None:
    for i in range(weight.size):
        row[2 * i] *= weight[i]
        row[2 * i + 1] *= weight[i]


@compiled
def entropy_sums(rows: F32, scale: np.float32, sums: F64) -> None:
    """sums[k] = sum of p ln p of row k, p = scale |g|^2; `rows` is (K, 2 N), the pairs of K rows."""
    n = rows.shape[1] // 2
    power, log, exponent, value = (np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32),
                                   np.empty(n, np.float32))  # fmt: skip
    for k in range(rows.shape[0]):
        _powers(rows[k], scale, power)
        _logarithms(power.view(np.int32), value.view(np.int32), value, exponent, log)
        total = 0.0
        for i in range(n):
            total += power[i] * log[i]
        sums[k] = total


@compiled
def weigh(rows: F32, scale: np.float32, contrast: bool, offset: np.float32, least: np.float32, sums: F64) -> None:
    """Multiply every sample by its weight, in place, and return the entropy sums of the rows as `entropy_sums` does.

    The weight is p where `contrast`, else max(ln p + offset, least).
    """
    n = rows.shape[1] // 2
    power, log, exponent, value = (np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32),
                                   np.empty(n, np.float32))  # fmt: skip
    for k in range(rows.shape[0]):
        _powers(rows[k], scale, power)
        _logarithms(power.view(np.int32), value.view(np.int32), value, exponent, log)
        total = 0.0
        for i in range(n):
            total += power[i] * log[i]
        sums[k] = total
        if contrast:
            _scale_pairs(rows[k], power)
        else:
            for i in range(n):
                log[i] = max(log[i] + offset, least)
            _scale_pairs(rows[k], log)


@compiled
def correlate(spectrum: NDArray[np.complex64], other: NDArray[np.complex64], total: NDArray[np.complex128]) -> None:
    """Add the sum over the rows of spectrum * conj(other) to `total`."""
    part = np.zeros(total.size, np.complex64)
    for k in range(spectrum.shape[0]):
        for m in range(part.size):
            part[m] += spectrum[k, m] * np.conj(other[k, m])
    for m in range(part.size):
        total[m] += part[m]
