"""Compiled loops of back-projection and of its adjoint; `featreg.focusing.backprojection` says what they compute.

Each step is a small function of contiguous rows, because only such loops are turned into vector instructions. The
carrier's cosine and sine are polynomials: calls of the mathematical library would take most of the time.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

# Taylor series of sin(pi t) and cos(pi t) in t^2, good to 1e-9 for |t| <= 1/2.
S0, S1, S2, S3, S4, S5, S6 = (
    np.float32((-1) ** k * math.pi ** (2 * k + 1) / math.factorial(2 * k + 1)) for k in range(7)
)
C0, C1, C2, C3, C4, C5, C6, C7 = (np.float32((-1) ** k * math.pi ** (2 * k) / math.factorial(2 * k)) for k in range(8))
ONE, TWO, HALF = np.float32(1), np.float32(2), np.float32(0.5)


@compiled
def _ranges(x: float, dx: float, y: float, dy: float, square: float, r0: float, ranges: F64) -> None:
    """Ranges less r0 of the points (x + k dx, y + k dy) from an antenna at the origin, `square` = height squared."""
    for k in range(ranges.shape[0]):
        px, py = x + k * dx, y + k * dy
        ranges[k] = math.sqrt(px * px + py * py + square) - r0


@compiled
def _split(ranges: F64, per_metre: float, middle: float, last: float, waves: float, index: F64, turns: F32) -> None:
    """Position in the range profile, held within it, and the carrier's phase in turns, within half a turn of 0."""
    for k in range(ranges.shape[0]):
        index[k] = min(max(ranges[k] * per_metre + middle, 0.0), last)
        cycles = ranges[k] * waves
        turns[k] = np.float32(cycles - np.floor(cycles + 0.5))


@compiled
def _rotate(turns: F32, cosine: F32, sine: F32) -> None:
    """cos and sin of 2 pi turns, from those of half the angle."""
    for k in range(turns.shape[0]):
        t = turns[k]
        z = t * t
        s = t * (S0 + z * (S1 + z * (S2 + z * (S3 + z * (S4 + z * (S5 + z * S6))))))
        c = C0 + z * (C1 + z * (C2 + z * (C3 + z * (C4 + z * (C5 + z * (C6 + z * C7))))))
        sine[k] = TWO * s * c
        cosine[k] = ONE - TWO * s * s


@compiled
def _gather(real: F32, imag: F32, index: F64, cosine: F32, sine: F32, out_real: F32, out_imag: F32) -> None:
    """Add the linearly interpolated profile times the carrier."""
    for k in range(index.shape[0]):
        j = np.uint32(index[k])
        f = np.float32(index[k] - j)
        re = real[j] + f * (real[j + np.uint32(1)] - real[j])
        im = imag[j] + f * (imag[j + np.uint32(1)] - imag[j])
        out_real[k] += re * cosine[k] - im * sine[k]
        out_imag[k] += re * sine[k] + im * cosine[k]


@compiled
def back_project_rows(
    real: F32,
    imag: F32,
    antennas: F64,
    r0: F64,
    starts: F64,
    step: F64,
    height: float,
    per_metre: float,
    middle: float,
    waves: float,
    out_real: F32,
    out_imag: F32,
) -> None:
    """Add pulses to some rows of an image.

    Parameters
    ----------
    real, imag : (P, K) float32 range profiles; the last sample is there to interpolate towards
    antennas : (P, 3) float64 m, r0 : (P,) float64 m
    starts : (H, 2) float64 m, ground x, y of the first pixel of each row; step : (2,) float64 m, to the next pixel
    height : z of the ground, m
    per_metre, middle : profile sample of a range d (less r0): ``d * per_metre + middle``
    waves : carrier cycles per metre of range, 2 f / c
    out_real, out_imag : (H, W) float32, added to
    """
    rows, width = out_real.shape
    ranges, index = np.empty(width), np.empty(width)
    turns, cosine, sine = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    last = real.shape[1] - 1.001
    for p in range(r0.shape[0]):
        square = (height - antennas[p, 2]) ** 2
        for i in range(rows):
            x, y = starts[i, 0] - antennas[p, 0], starts[i, 1] - antennas[p, 1]
            _ranges(x, step[0], y, step[1], square, r0[p], ranges)
            _split(ranges, per_metre, middle, last, waves, index, turns)
            _rotate(turns, cosine, sine)
            _gather(real[p], imag[p], index, cosine, sine, out_real[i], out_imag[i])


@compiled
def _distances(x: F64, y: F64, z: F64, antenna: F64, r0: float, ranges: F64) -> None:
    for k in range(ranges.shape[0]):
        dx, dy, dz = x[k] - antenna[0], y[k] - antenna[1], z[k] - antenna[2]
        ranges[k] = math.sqrt(dx * dx + dy * dy + dz * dz) - r0


@compiled
def _scatter(real: F32, imag: F32, index: F64, cosine: F32, sine: F32, out_real: F32, out_imag: F32) -> None:
    for k in range(index.shape[0]):
        j = np.uint32(index[k])
        f = np.float32(index[k] - j)
        re = real[k] * cosine[k] + imag[k] * sine[k]
        im = imag[k] * cosine[k] - real[k] * sine[k]
        out_real[j] += (ONE - f) * re
        out_imag[j] += (ONE - f) * im
        out_real[j + np.uint32(1)] += f * re
        out_imag[j + np.uint32(1)] += f * im


@compiled
def project_points(
    x: F64,
    y: F64,
    z: F64,
    real: F32,
    imag: F32,
    aspect: F64,
    rate: F64,
    azimuth: F64,
    antennas: F64,
    r0: F64,
    per_metre: float,
    middle: float,
    waves: float,
    out_real: F32,
    out_imag: F32,
) -> None:
    """Add the echoes of N scatterers to range profiles, the adjoint of `back_project_rows`.

    Parameters
    ----------
    x, y, z : (N,) float64 m; real, imag : (N,) float32 amplitude
    aspect : (N,) float64 degrees of the middle of the lobe in which a scatterer is seen
    rate : (N,) float64 per square degree: the amplitude falls as exp(-rate * d ** 2); 0 = seen from everywhere
    azimuth : (P,) float64 degrees; antennas : (P, 3), r0 : (P,) m
    per_metre, middle, waves : as in `back_project_rows`
    out_real, out_imag : (P, K) float32 profiles, added to
    """
    n = x.shape[0]
    ranges, index = np.empty(n), np.empty(n)
    turns, cosine, sine = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32)
    seen_real, seen_imag = real.copy(), imag.copy()
    last = out_real.shape[1] - 1.001
    varying = rate.max() > 0.0
    for p in range(r0.shape[0]):
        if varying:
            for k in range(n):
                d = azimuth[p] - aspect[k]
                d -= 360.0 * np.floor(d / 360.0 + 0.5)
                lobe = np.float32(math.exp(-rate[k] * d * d))
                seen_real[k], seen_imag[k] = lobe * real[k], lobe * imag[k]
        _distances(x, y, z, antennas[p], r0[p], ranges)
        _split(ranges, per_metre, middle, last, waves, index, turns)
        _rotate(turns, cosine, sine)
        _scatter(seen_real, seen_imag, index, cosine, sine, out_real[p], out_imag[p])
