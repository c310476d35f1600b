"""Compiled loops of phase congruency and of the maximum index map; `featreg.sar.phase_congruency` has the formulas."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.jit import compiled

U8 = NDArray[np.uint8]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
C64 = NDArray[np.complex64]


@compiled
def _scaled_row(row: C64, radial: F32, angular: F32, out: C64) -> None:
    for x in range(out.shape[0]):
        out[x] = row[x] * (radial[x] * angular[x])


@compiled
def filtered(spectrum: C64, radial: F32, angular: F32, out: C64) -> None:
    """Fill `out` with the product of its first rows and columns of the three."""
    columns = out.shape[1]
    for y in range(out.shape[0]):
        _scaled_row(spectrum[y, :columns], radial[y, :columns], angular[y, :columns], out[y])


@compiled
def _add_scale(row: F32, even: F32, odd: F32, total: F32, largest: F32) -> None:
    for x in range(even.shape[0]):
        e, o = row[2 * x], row[2 * x + 1]
        amplitude = np.sqrt(e * e + o * o)
        even[x] += e
        odd[x] += o
        total[x] += amplitude
        largest[x] = max(largest[x], amplitude)


@compiled
def _add_deviation(row: F32, even: F32, odd: F32, deviation: F32) -> None:
    for x in range(even.shape[0]):
        deviation[x] += abs(row[2 * x] * odd[x] - row[2 * x + 1] * even[x])


@compiled
def _congruency(
    even: F32, odd: F32, total: F32, largest: F32, deviation: F32,
    noise: np.float32, eps: np.float32, spread: np.float32, gain: np.float32, cut_off: np.float32, out: F32,
) -> None:  # fmt: skip
    """Weighted energy above the noise over the sum of amplitudes.

    The logistic weight is (1 + tanh(z / 2)) / 2 with tanh as a quotient of polynomials, to 2e-4 for |z| < 6.
    """
    one, half = np.float32(1), np.float32(0.5)
    for x in range(out.shape[0]):
        length = np.sqrt(even[x] * even[x] + odd[x] * odd[x]) + eps
        energy = max(length - deviation[x] / length - noise, np.float32(0))
        width = (total[x] / (largest[x] + eps) - one) * spread
        z = min(max(half * gain * (width - cut_off), np.float32(-3)), np.float32(3))
        q = z * z
        tanh = (
            z
            * (np.float32(945) + q * (np.float32(105) + q))
            / (np.float32(945) + q * (np.float32(420) + np.float32(15) * q))
        )
        out[x] = half * (one + tanh) * energy / (total[x] + eps)


@compiled
def _add_moments(pc: F32, cosine: np.float32, sine: np.float32, xx: F32, yy: F32, xy: F32) -> None:
    for i in range(pc.shape[0]):
        px, py = pc[i] * cosine, pc[i] * sine
        xx[i] += px * px
        yy[i] += py * py
        xy[i] += px * py


@compiled
def add_orientation(
    parts: F32, noise: np.float32, eps: np.float32, gain: np.float32, cut_off: np.float32,
    cosine: np.float32, sine: np.float32, moments: F32, amplitude: F32,
) -> None:  # fmt: skip
    """Add one orientation to the (3, H, W) moments and write its summed (H, W) amplitude.

    `parts` (scales, H, 2 W) holds even and odd responses side by side.
    """
    scales, height, width = parts.shape[0], parts.shape[1], parts.shape[2] // 2
    spread = np.float32(1.0 / max(scales - 1, 1))
    even, odd = np.empty(width, np.float32), np.empty(width, np.float32)
    largest, deviation = np.empty(width, np.float32), np.empty(width, np.float32)
    pc = np.empty(width, np.float32)
    for y in range(height):
        even[:] = 0
        odd[:] = 0
        largest[:] = 0
        deviation[:] = 0
        total = amplitude[y]
        total[:] = 0
        for s in range(scales):
            _add_scale(parts[s, y], even, odd, total, largest)
        for s in range(scales):
            _add_deviation(parts[s, y], even, odd, deviation)
        _congruency(even, odd, total, largest, deviation, noise, eps, spread, gain, cut_off, pc)
        _add_moments(pc, cosine, sine, moments[0, y], moments[1, y], moments[2, y])


@compiled
def _principal(xx: F32, yy: F32, xy: F32, norm: np.float32, largest: F32, smallest: F32) -> None:
    half = np.float32(0.5)
    for x in range(xx.shape[0]):
        trace, apart = xx[x] + yy[x], xx[x] - yy[x]
        root = np.sqrt(apart * apart + np.float32(4) * xy[x] * xy[x])
        largest[x] = norm * half * (trace + root)
        smallest[x] = max(norm * half * (trace - root), np.float32(0))


@compiled
def principal_moments(moments: F32, norm: np.float32, largest: F32, smallest: F32) -> None:
    """Fill the (H, W) principal moments of the (3, H, W) sums of xx, yy and xy, times `norm`."""
    for y in range(largest.shape[0]):
        _principal(moments[0, y], moments[1, y], moments[2, y], norm, largest[y], smallest[y])


@compiled
def _best(candidate: F32, number: np.float32, best: F32, index: F32) -> None:
    for x in range(best.shape[0]):
        better = candidate[x] > best[x]
        index[x] = number if better else index[x]
        best[x] = candidate[x] if better else best[x]


@compiled
def _neighbours(before: F32, here: F32, after: F32, number: np.float32, index: F32, left: F32, right: F32) -> None:
    for x in range(index.shape[0]):
        chosen = index[x] == number
        left[x] = before[x] if chosen else left[x]
        right[x] = after[x] if chosen else right[x]


@compiled
def _vertex(best: F32, left: F32, right: F32, index: F32, per_index: np.float32, steps: np.float32, out: U8) -> None:
    for x in range(best.shape[0]):
        bend = np.float32(2) * best[x] - left[x] - right[x]
        offset = np.float32(0.5) * (right[x] - left[x]) / max(bend, np.float32(1e-30))
        offset = min(max(offset, np.float32(-0.5)), np.float32(0.5))
        value = (index[x] + offset) * per_index + np.float32(0.5)
        value = value + steps if value < np.float32(0) else value
        value = value - steps if value >= steps else value
        out[x] = np.uint8(np.int32(value))


@compiled
def dominant_index(amplitudes: F32, steps: int, out: U8) -> None:
    """Fill the (H, W) index of the largest of the (orientations, H, W) amplitudes, to a fraction, in `steps` a turn.

    The fraction is the vertex of the parabola through the largest amplitude and its two cyclic neighbours.
    """
    count, height, width = amplitudes.shape
    best, index = np.empty(width, np.float32), np.empty(width, np.float32)
    left, right = np.empty(width, np.float32), np.empty(width, np.float32)
    for y in range(height):
        best[:] = -1
        index[:] = 0
        for o in range(count):
            _best(amplitudes[o, y], np.float32(o), best, index)
        for o in range(count):
            _neighbours(
                amplitudes[(o + count - 1) % count, y], amplitudes[o, y], amplitudes[(o + 1) % count, y],
                np.float32(o), index, left, right,
            )  # fmt: skip
        _vertex(best, left, right, index, np.float32(steps / count), np.float32(steps), out[y])


@compiled
def _add_rows(above: I32, here: I32) -> None:
    for x in range(here.shape[0]):
        here[x] += above[x]


@compiled
def index_sums(index: U8, weight: U8, votes: I32, sums: I32) -> None:
    """Fill the (H + 1, W + 1, bins) summed-area table of the votes of every valid pixel.

    `votes` (steps, bins) says how a value of the (H, W) `index` is shared out over the bins; the last bin counts
    valid pixels.
    """
    height, width = index.shape
    bins = votes.shape[1]
    sums[0] = 0
    running = np.zeros(bins, np.int32)
    for y in range(height):
        running[:] = 0
        sums[y + 1, 0] = 0
        for x in range(width):
            w = np.int32(weight[y, x])
            if w:
                vote = votes[index[y, x]]
                for b in range(bins - 1):
                    running[b] += vote[b] * w
                running[bins - 1] += vote[bins - 1]
            for b in range(bins):
                sums[y + 1, x + 1, b] = running[b]
        _add_rows(sums[y].reshape(-1), sums[y + 1].reshape(-1))


@compiled
def pooled(sums: I32, xs: I64, ys: I64, cells: I64, turns: I64, half: int, out: F32) -> None:
    """Fill (N, cells, bins) sums of the votes in squares around the points' cells.

    `cells` (turns, cells, 2) are (x, y) offsets of the centres, `turns` (N,) which of them a point takes; a square
    reaches `half` pixels to each side of its centre and is cut at the border of the image.
    """
    height, width, bins = sums.shape[0] - 1, sums.shape[1] - 1, sums.shape[2]
    for i in range(xs.shape[0]):
        table = cells[turns[i]]
        for c in range(table.shape[0]):
            x, y = xs[i] + table[c, 0], ys[i] + table[c, 1]
            x0, x1 = min(max(x - half, 0), width), min(max(x + half + 1, 0), width)
            y0, y1 = min(max(y - half, 0), height), min(max(y + half + 1, 0), height)
            a, b, d, e = sums[y0, x0], sums[y0, x1], sums[y1, x0], sums[y1, x1]
            row = out[i, c]
            for k in range(bins):
                row[k] = np.float32(e[k] - d[k] - b[k] + a[k])
