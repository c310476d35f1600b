"""Compiled loops of the ratio gradients of odd Gabor filters; `featreg.sar.gabor` says what they compute."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.jit import compiled
from featreg.sar.ratio_kernels import fast_log

F32 = NDArray[np.float32]
C64 = NDArray[np.complex64]


@compiled
def _add_row(means: F32, small: np.float32, x: np.float32, y: np.float32, gx: F32, gy: F32) -> None:
    tiny = np.float32(1e-12) * small
    for k in range(gx.shape[0]):
        mean, half = means[2 * k] + small, means[2 * k + 1]
        ratio = fast_log(max(mean + half, tiny) / max(mean - half, tiny))
        gx[k] += x * ratio
        gy[k] -= y * ratio


@compiled
def add_ratios(means: C64, small: np.float32, x: np.float32, y: np.float32, gx: F32, gy: F32) -> None:
    """Add log((m + d) / (m - d)) times (x, -y) of means m + i d (H, W), where m is raised by `small`."""
    for row in range(gx.shape[0]):
        _add_row(means[row].view(np.float32), small, x, y, gx[row], gy[row])


@compiled
def add_weighted_ratios(
    means: C64, weights: C64, small: np.float32, limit: np.float32, x: np.float32, y: np.float32, gx: F32, gy: F32
) -> None:
    """As `add_ratios`, less the log ratio of the weights on the two sides; nothing where that exceeds `limit`."""
    for row in range(gx.shape[0]):
        for k in range(gx.shape[1]):
            mean, half = means[row, k].real, means[row, k].imag
            weight, lean = weights[row, k].real, weights[row, k].imag
            tiny = np.float32(1e-6)
            after, before = max(weight + lean, tiny), max(weight - lean, tiny)
            balance = fast_log(after / before)
            if abs(balance) > limit:
                continue
            plus, minus = max(mean + half, np.float32(0)), max(mean - half, np.float32(0))
            ratio = fast_log((plus + small * after) / (minus + small * before)) - balance
            gx[row, k] += x * ratio
            gy[row, k] -= y * ratio
