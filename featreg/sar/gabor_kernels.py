"""Compiled loops of the ratio gradients of odd Gabor filters; `featreg.sar.gabor` says what they compute."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.jit import compiled
from featreg.sar.ratio_kernels import fast_log

F32 = NDArray[np.float32]
C64 = NDArray[np.complex64]


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
def add_ratios(means: C64, small: np.float32, x: np.float32, y: np.float32, gx: F32, gy: F32) -> None:
    """Add log((m + d) / (m - d)) times (x, -y) of means m + i d (H, W), where m is raised by `small`."""
    after, before = np.empty(gx.shape[1], np.float32), np.empty(gx.shape[1], np.float32)
    for row in range(gx.shape[0]):
        _sides(means[row].view(np.float32), small, after, before)
        _log_ratio(after, before)
        _add(after, x, gx[row])
        _add(after, -y, gy[row])
