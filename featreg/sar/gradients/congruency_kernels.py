"""Compiled loops of phase congruency; `featreg.sar.gradients.phase_congruency` has the formulas.

What the orientations share row by row lies in one-dimensional arrays with unsigned indices, which is what keeps the
loops free of checks, so that many pixels are computed at once.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

U8 = NDArray[np.uint8]
F32 = NDArray[np.float32]


@compiled
def filtered(spectrum: F32, transfer: F32, out: F32) -> None:
    """Fill `out` with the product of a spectrum and a real transfer function.

    `spectrum` and `out` (2 N,) hold real and imaginary parts side by side, `transfer` is (N,).
    """
    for x in range(transfer.shape[0]):
        out[2 * x] = spectrum[2 * x] * transfer[x]
        out[2 * x + 1] = spectrum[2 * x + 1] * transfer[x]


@compiled
def _congruency(
    parts: tuple[F32, ...], start: int, noise: np.float32, floor: np.float32, gain: np.float32, cut_off: np.float32,
    amplitude: F32, out: F32,
) -> None:  # fmt: skip
    """Weighted energy above the noise over the sum of amplitudes, along a row that begins at `start` of the parts.

    The logistic weight is (1 + tanh(z / 2)) / 2 with tanh as a quotient of polynomials, to 2e-4 for |z| < 6.
    """
    zero, one, half, three = np.float32(0), np.float32(1), np.float32(0.5), np.float32(3)
    tiny, next_to = np.float32(1e-12), np.uint64(1)
    spread = np.float32(1.0 / max(len(parts) - 1, 1))
    for column in range(out.shape[0]):
        x = np.uint64(start) + np.uint64(2 * column)
        even, odd, total, largest, deviation = zero, zero, zero, zero, zero
        for part in parts:
            e, o = part[x], part[x + next_to]
            a = np.sqrt(e * e + o * o)
            even, odd, total, largest = even + e, odd + o, total + a, max(largest, a)
        for part in parts:
            deviation += abs(part[x] * odd - part[x + next_to] * even)
        length, largest = np.sqrt(even * even + odd * odd) + tiny, largest + tiny
        # One division for both quotients.
        inverse = one / (length * largest)
        energy = max(length - deviation * (inverse * largest) - noise, zero)
        width = (total * (inverse * length) - one) * spread
        z = min(max(half * gain * (width - cut_off), -three), three)
        q = z * z
        numerator = z * (np.float32(945) + q * (np.float32(105) + q))
        denominator = np.float32(945) + q * (np.float32(420) + np.float32(15) * q)
        amplitude[column] = total
        out[column] = half * (denominator + numerator) * energy / (denominator * (total + floor))


@compiled
def _add_moments(pc: F32, cosine: np.float32, sine: np.float32, xx: F32, yy: F32, xy: F32) -> None:
    for i in range(pc.shape[0]):
        px, py = pc[i] * cosine, pc[i] * sine
        xx[i] += px * px
        yy[i] += py * py
        xy[i] += px * py


@compiled
def add_orientation(
    parts: tuple[F32, ...], width: int, top: int, left: int,
    noise: np.float32, floor: np.float32, gain: np.float32, cut_off: np.float32,
    cosine: np.float32, sine: np.float32, moments: F32, amplitude: F32,
) -> None:  # fmt: skip
    """Add one orientation to the (3, h, w) moments and write its summed (h, w) amplitude.

    `parts` are the flat arrays of the scales' responses, even and odd parts side by side, `width` pixels to a row; the
    moments begin at (`top`, `left`) of them.
    """
    pc = np.empty(amplitude.shape[1], np.float32)
    for y in range(amplitude.shape[0]):
        start = 2 * ((top + y) * width + left)
        _congruency(parts, start, noise, floor, gain, cut_off, amplitude[y], pc)
        _add_moments(pc, cosine, sine, moments[0, y], moments[1, y], moments[2, y])


@compiled
def add_orientation_of_two(
    parts: F32, width: int, top: int, left: int,
    noise: np.float32, floor: np.float32, gain: np.float32, cut_off: np.float32,
    cosine: np.float32, sine: np.float32, moments: F32, amplitude: F32,
) -> None:  # fmt: skip
    """`add_orientation` of two scales, the rows of an array: such calls can be prepared, those with tuples cannot."""
    both = parts[0], parts[1]
    add_orientation(both, width, top, left, noise, floor, gain, cut_off, cosine, sine, moments, amplitude)


@compiled
def add_orientation_of_four(
    parts: F32, width: int, top: int, left: int,
    noise: np.float32, floor: np.float32, gain: np.float32, cut_off: np.float32,
    cosine: np.float32, sine: np.float32, moments: F32, amplitude: F32,
) -> None:  # fmt: skip
    """`add_orientation` of four scales, the rows of an array."""
    four = parts[0], parts[1], parts[2], parts[3]
    add_orientation(four, width, top, left, noise, floor, gain, cut_off, cosine, sine, moments, amplitude)


@compiled
def _principal(xx: F32, yy: F32, xy: F32, norm: np.float32, largest: F32, smallest: F32) -> None:
    half = np.float32(0.5)
    for x in range(xx.shape[0]):
        trace, apart = xx[x] + yy[x], xx[x] - yy[x]
        root = np.sqrt(apart * apart + np.float32(4) * xy[x] * xy[x])
        largest[x] = norm * half * (trace + root)
        smallest[x] = max(norm * half * (trace - root), np.float32(0))


@compiled
def principal_moments(moments: F32, norm: np.float32, top: int, left: int, largest: F32, smallest: F32) -> None:
    """Write the principal moments of the (3, h, w) sums of xx, yy and xy, times `norm`, at (`top`, `left`) of maps."""
    right = left + moments.shape[2]
    for y in range(moments.shape[1]):
        _principal(
            moments[0, y], moments[1, y], moments[2, y], norm,
            largest[top + y, left:right], smallest[top + y, left:right],
        )  # fmt: skip


@compiled
def _index_row(amplitudes: tuple[F32, ...], start: int, per_index: np.float32, steps: np.float32, out: U8) -> None:
    half, zero, count = np.float32(0.5), np.float32(0), len(amplitudes)
    for column in range(out.shape[0]):
        x = np.uint64(start) + np.uint64(column)
        best, index, before, after = amplitudes[0][x], zero, amplitudes[count - 1][x], amplitudes[1][x]
        for o in range(1, count):
            here = amplitudes[o][x]
            following = amplitudes[o + 1][x] if o + 1 < count else amplitudes[0][x]
            better = here > best
            index = np.float32(o) if better else index
            before = amplitudes[o - 1][x] if better else before
            after = following if better else after
            best = max(best, here)
        bend = np.float32(2) * best - before - after
        offset = half * (after - before) / max(bend, np.float32(1e-30))
        offset = min(max(offset, -half), half)
        value = (index + offset) * per_index + half
        value = value + steps if value < zero else value
        value = value - steps if value >= steps else value
        out[column] = np.uint8(np.int32(value))


@compiled
def dominant_index(amplitudes: tuple[F32, ...], width: int, steps: int, top: int, left: int, index: U8) -> None:
    """Write the index of the largest amplitude, to a fraction, in `steps` a turn, at (`top`, `left`) of a map.

    `amplitudes` are the orientations' flat arrays, `width` pixels to a row. The fraction is the vertex of the parabola
    through the largest amplitude and its two cyclic neighbours.
    """
    per_index = np.float32(steps / len(amplitudes))
    for y in range(amplitudes[0].shape[0] // width):
        _index_row(amplitudes, y * width, per_index, np.float32(steps), index[top + y, left : left + width])


@compiled
def dominant_index_of_four(amplitudes: F32, width: int, steps: int, top: int, left: int, index: U8) -> None:
    """`dominant_index` of four orientations, the rows of an array."""
    four = amplitudes[0], amplitudes[1], amplitudes[2], amplitudes[3]
    dominant_index(four, width, steps, top, left, index)


@compiled
def dominant_index_of_six(amplitudes: F32, width: int, steps: int, top: int, left: int, index: U8) -> None:
    """`dominant_index` of six orientations, the rows of an array."""
    six = amplitudes[0], amplitudes[1], amplitudes[2], amplitudes[3], amplitudes[4], amplitudes[5]
    dominant_index(six, width, steps, top, left, index)
