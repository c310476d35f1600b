"""Compiled loops of the ratio gradients of odd Gabor filters; `featreg.sar.gradients.gabor` says what they compute."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled
from featreg.sar.logarithm_kernels import fast_log

F32 = NDArray[np.float32]
C64 = NDArray[np.complex64]


@compiled
def _nothing(out: F32) -> None:
    for k in range(out.shape[0]):
        out[k] = np.float32(0)


@compiled
def _as_real(row: F32, out: F32) -> None:
    for k in range(row.shape[0]):
        out[2 * k] = row[k]
        out[2 * k + 1] = np.float32(0)


@compiled
def embedded(amplitude: F32, top: int, left: int, out: C64) -> None:
    """Fill `out` with a real image whose first pixel comes to (`top`, `left`), and 0 around it."""
    height, width = amplitude.shape
    for y in range(out.shape[0]):
        row = out[y].view(np.float32)
        if top <= y < top + height:
            _nothing(row[: 2 * left])
            _as_real(amplitude[y - top], row[2 * left : 2 * (left + width)])
            _nothing(row[2 * (left + width) :])
        else:
            _nothing(row)


@compiled
def _sides(means: F32, small: np.float32, after: F32, before: F32) -> None:
    tiny = np.float32(1e-6) * small
    for k in range(after.shape[0]):
        mean, half = means[2 * k] + small, means[2 * k + 1]
        plus, minus = mean + half, mean - half
        after[k] = plus if plus > tiny else tiny
        before[k] = minus if minus > tiny else tiny


@compiled
def _log_ratio(after: F32, before: F32) -> None:
    for k in range(after.shape[0]):
        after[k] = fast_log(after[k] / before[k])


@compiled
def _add(ratio: F32, factor: np.float32, out: F32) -> None:
    for k in range(out.shape[0]):
        out[k] += factor * ratio[k]


@compiled
def add_ratios(
    means: C64, first: int, top: int, left: int, height: int, width: int, small: np.float32, x: np.float32,
    y: np.float32, gx: F32, gy: F32,
) -> None:  # fmt: skip
    """Add log((m + d) / (m - d)) times (x, -y) of means m + i d, where m is raised by `small`.

    They go to `height` rows and `width` columns from (`top`, `left`) of `gx` and `gy` on, and begin at row and column
    `first` of `means`.
    Whole arrays, whose rows the compiler knows to be contiguous.
    """
    after, before = np.empty(width, np.float32), np.empty(width, np.float32)
    for row in range(height):
        _sides(means[first + row, first : first + width].view(np.float32), small, after, before)
        _log_ratio(after, before)
        _add(after, x, gx[top + row, left : left + width])
        _add(after, -y, gy[top + row, left : left + width])


@compiled
def _filter(spectrum: C64, transfer: F32, out: C64) -> None:
    for k in range(out.shape[0]):
        out[k] = spectrum[k] * transfer[k]


@compiled
def _add_filtered(spectrum: C64, transfer: F32, out: C64) -> None:
    for k in range(out.shape[0]):
        out[k] += spectrum[k] * transfer[k]


@compiled
def filter_folded(spectrum: C64, transfer: F32, out: C64) -> None:
    """Multiply a spectrum (H, W) by a real transfer function and fold it to (H / n, W / n).

    The inverse transform of that, as of the whole without division by the size, is every n-th sample of both axes.
    """
    height, width = out.shape
    for row in range(height):
        for below in range(row, spectrum.shape[0], height):
            for left in range(0, spectrum.shape[1], width):
                part, factor = spectrum[below, left : left + width], transfer[below, left : left + width]
                if below == row and left == 0:
                    _filter(part, factor, out[row])
                else:
                    _add_filtered(part, factor, out[row])


@compiled
def _average(first: F32, second: F32, out: F32) -> None:
    for k in range(out.shape[0]):
        out[k] = np.float32(0.5) * (first[k] + second[k])


@compiled
def _spread(samples: F32, out: F32) -> None:
    for k in range(out.shape[0] // 2):
        out[2 * k] = samples[k]
        out[2 * k + 1] = np.float32(0.5) * (samples[k] + samples[k + 1])
    if out.shape[0] % 2:
        out[-1] = samples[out.shape[0] // 2]


@compiled
def interpolate(samples: F32, out: F32) -> None:
    """Fill (H, W) from its even rows and columns, (H // 2 + 1, W // 2 + 1), linearly."""
    between = np.empty(samples.shape[1], np.float32)
    for row in range(out.shape[0]):
        if row % 2:
            _average(samples[row // 2], samples[row // 2 + 1], between)
            _spread(between, out[row])
        else:
            _spread(samples[row // 2], out[row])
