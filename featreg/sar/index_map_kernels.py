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


@compiled
def _scaled_row(row: F32, radial: F32, angular: F32, out: F32) -> None:
    for x in range(radial.shape[0]):
        factor = radial[x] * angular[x]
        out[2 * x] = row[2 * x] * factor
        out[2 * x + 1] = row[2 * x + 1] * factor


@compiled
def filtered(spectrum: F32, radial: F32, angular: F32, limits: I64, parts: tuple[F32, ...]) -> None:
    """Fill the first rows and columns of every part with the product of spectrum and filter, the rest with 0.

    `spectrum` and `parts` (H, 2 W) hold real and imaginary parts side by side; `radial` (scales, H, W), `angular`
    (H, W); `limits` (scales, 2) are the rows and columns to fill. Row by row, so that what scales share is read once.
    """
    for y in range(spectrum.shape[0]):
        for s in range(len(parts)):
            out = parts[s][y]
            columns = limits[s, 1] if y < limits[s, 0] else 0
            _scaled_row(spectrum[y, : 2 * columns], radial[s, y, :columns], angular[y, :columns], out[: 2 * columns])
            out[2 * columns :] = 0


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
    noise: np.float32, floor: np.float32, spread: np.float32, gain: np.float32, cut_off: np.float32, out: F32,
) -> None:  # fmt: skip
    """Weighted energy above the noise over the sum of amplitudes.

    The logistic weight is (1 + tanh(z / 2)) / 2 with tanh as a quotient of polynomials, to 2e-4 for |z| < 6.
    """
    one, half, tiny = np.float32(1), np.float32(0.5), np.float32(1e-12)
    for x in range(out.shape[0]):
        length = np.sqrt(even[x] * even[x] + odd[x] * odd[x]) + tiny
        energy = max(length - deviation[x] / length - noise, np.float32(0))
        width = (total[x] / (largest[x] + tiny) - one) * spread
        z = min(max(half * gain * (width - cut_off), np.float32(-3)), np.float32(3))
        q = z * z
        tanh = (
            z
            * (np.float32(945) + q * (np.float32(105) + q))
            / (np.float32(945) + q * (np.float32(420) + np.float32(15) * q))
        )
        out[x] = half * (one + tanh) * energy / (total[x] + floor)


@compiled
def _add_moments(pc: F32, cosine: np.float32, sine: np.float32, xx: F32, yy: F32, xy: F32) -> None:
    for i in range(pc.shape[0]):
        px, py = pc[i] * cosine, pc[i] * sine
        xx[i] += px * px
        yy[i] += py * py
        xy[i] += px * py


@compiled
def add_orientation(
    parts: tuple[F32, ...], top: int, left: int,
    noise: np.float32, floor: np.float32, gain: np.float32, cut_off: np.float32,
    cosine: np.float32, sine: np.float32, moments: F32, amplitude: F32,
) -> None:  # fmt: skip
    """Add one orientation to the (3, H, W) moments and write its summed (H, W) amplitude.

    `parts` are the scales' responses, even and odd parts side by side; the image begins at (`top`, `left`) of them.
    """
    scales, height, width = len(parts), amplitude.shape[0], amplitude.shape[1]
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
            _add_scale(parts[s][top + y, 2 * left : 2 * (left + width)], even, odd, total, largest)
        for s in range(scales):
            _add_deviation(parts[s][top + y, 2 * left : 2 * (left + width)], even, odd, deviation)
        _congruency(even, odd, total, largest, deviation, noise, floor, spread, gain, cut_off, pc)
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
def _add_vote(vote: I32, weight: np.int32, running: I32) -> None:
    for b in range(running.shape[0]):
        running[b] += vote[b] * weight


@compiled
def index_sums(index: U8, weight: U8, votes: I32, bins: int, sums: I32) -> None:
    """Fill the summed-area table of weighted votes, a row and a column for every second pixel.

    `votes` (steps, lanes) says how a value of the (H, W) `index` is shared out over the bins, which `weight`
    multiplies; lane number `bins` counts pixels with a weight. `sums` is ((H + 1) // 2 + 1, (W + 1) // 2 + 1, lanes);
    sums of large images wrap around.
    """
    height, width = index.shape
    sums[0] = 0
    rows = np.zeros((sums.shape[1], votes.shape[1]), np.int32)
    for y in range(0, height, 2):
        rows[:] = 0
        for line in range(y, min(y + 2, height)):
            for x in range(width):
                w = np.int32(weight[line, x])
                if w:
                    _add_vote(votes[index[line, x]], w, rows[x // 2 + 1])
                    rows[x // 2 + 1, bins] += np.int32(1)
        here = sums[y // 2 + 1]
        here[0] = 0
        for x in range(1, rows.shape[0]):
            _add_rows(rows[x - 1], rows[x])
        here[:] = rows
        _add_rows(sums[y // 2].reshape(-1), here.reshape(-1))


@compiled
def _area(a: I32, b: I32, c: I32, d: I32, out: F32) -> None:
    for k in range(out.shape[0]):
        out[k] = np.float32(np.int32(d[k] - c[k] - b[k] + a[k]))


@compiled
def pooled(sums: I32, xs: I64, ys: I64, cells: I64, turns: I64, order: I64, half: int, out: F32) -> None:
    """Fill (N, cells, lanes) sums of the votes in squares around the points' cells.

    `cells` (turns, cells, 2) are (x, y) offsets of the centres, `turns` (N,) which of them a point takes, `order`
    (N,) the order of work; a square reaches `half` pixels to each side of its centre, to the nearest even pixel, and
    is cut at the border of the image. Differences of sums that wrapped around are right.
    """
    height, width = sums.shape[0] - 1, sums.shape[1] - 1
    for i in order:
        table = cells[turns[i]]
        for c in range(table.shape[0]):
            x, y = xs[i] + table[c, 0], ys[i] + table[c, 1]
            x0, x1 = min(max((x - half + 1) // 2, 0), width), min(max((x + half + 2) // 2, 0), width)
            y0, y1 = min(max((y - half + 1) // 2, 0), height), min(max((y + half + 2) // 2, 0), height)
            _area(sums[y0, x0], sums[y0, x1], sums[y1, x0], sums[y1, x1], out[i, c])
