"""The compiled loop behind `featreg.resample`: separable interpolation at arbitrary float64 positions.

OpenCV's `remap` rounds positions to 1/32 pixel and refuses images beyond 32767 pixels; this loop does neither, takes
real and complex samples, and knows exactly which pixels an output value rests on.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from featreg.jit import compiled
from featreg.types import BoolArray, FloatArray

#: Positions this close to a pixel centre are on it: rounding in a model must not widen the support.
SNAP = 1e-6
ROOT = math.sqrt(0.5)
# sin and cos of k * pi / 4 for the lanczos taps k = -3 .. 4.
SINES = np.array([-ROOT, -1.0, -ROOT, 0.0, ROOT, 1.0, ROOT, 0.0])
COSINES = np.array([-ROOT, 0.0, ROOT, 1.0, ROOT, 0.0, -ROOT, -1.0])


@compiled
def _weights(taps: int, fraction: float, weights: FloatArray) -> None:
    """Fill the weights of `taps` pixels around a position `fraction` (in (0, 1)) past the left middle one."""
    f = fraction
    if taps == 2:
        weights[0], weights[1] = 1.0 - f, f
    elif taps == 4:  # Keys (1981) with a = -1/2: exact for parabolas
        weights[0] = f * (f * (1.0 - 0.5 * f) - 0.5)
        weights[1] = f * f * (1.5 * f - 2.5) + 1.0
        weights[2] = f * (f * (2.0 - 1.5 * f) + 0.5)
        weights[3] = f * f * (0.5 * f - 0.5)
    else:  # sinc(d) sinc(d / 4) up to a common factor, which the normalisation removes
        sine, cosine = math.sin(0.25 * math.pi * f), math.cos(0.25 * math.pi * f)
        total, sign = 0.0, -1.0
        for k in range(8):
            d = k - 3 - f
            weights[k] = sign * (SINES[k] * cosine - COSINES[k] * sine) / (d * d)
            total += weights[k]
            sign = -sign
        for k in range(8):
            weights[k] /= total


@compiled
def _support(position: float, taps: int, weights: FloatArray) -> tuple[int, int]:
    """Return the first pixel and the number of pixels a position rests on, and fill their weights."""
    nearest = math.floor(position + 0.5)
    if taps == 1 or abs(position - nearest) < SNAP:
        weights[0] = 1.0
        return nearest, 1
    left = math.floor(position)
    _weights(taps, position - left, weights)
    return left - taps // 2 + 1, taps


@compiled
def interpolate(
    pixels: NDArray[np.float32] | NDArray[np.complex64],
    mask: BoolArray,
    all_valid: bool,
    xy: FloatArray,
    taps: int,
    zero: float | complex,
    values: NDArray[np.float32] | NDArray[np.complex64],
    valid: BoolArray,
) -> None:
    """Fill `values` and `valid` (N,) with the samples of `pixels` (H, W) at `xy` (N, 2).

    `all_valid` says that `mask` (H, W) need not be looked at; `taps` is 1 (nearest), 2 (bilinear), 4 (cubic) or 8
    (lanczos); `zero` is a float64 or complex128 zero, in which the sums are made. A value whose support touches an
    invalid pixel or leaves the image is 0 and invalid.
    """
    height, width = pixels.shape
    wx, wy = np.empty(8), np.empty(8)
    for i in range(xy.shape[0]):
        values[i] = zero
        valid[i] = False
        x, y = xy[i, 0], xy[i, 1]
        if not (-1.0 < x < width and -1.0 < y < height):  # NaN comes here too
            continue
        x0, nx = _support(x, taps, wx)
        y0, ny = _support(y, taps, wy)
        if x0 < 0 or y0 < 0 or x0 + nx > width or y0 + ny > height:
            continue
        if not (all_valid or mask[y0 : y0 + ny, x0 : x0 + nx].all()):
            continue
        total = zero
        for row in range(ny):
            line = zero
            for col in range(nx):
                line += wx[col] * pixels[y0 + row, x0 + col]
            total += wy[row] * line
        values[i] = total
        valid[i] = True
