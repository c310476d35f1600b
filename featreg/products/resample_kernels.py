"""The compiled loop behind `featreg.products.resample`: separable interpolation at arbitrary float64 positions.

OpenCV's `remap` rounds positions to 1/32 pixel and refuses images beyond 32767 pixels; this loop does neither, takes
real and complex samples, and knows exactly which pixels an output value rests on.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled, inlined
from featreg.types import BoolArray, FloatArray

Float32 = NDArray[np.float32]

#: Positions this close to a pixel centre are on it: rounding in a model must not widen the support.
SNAP = 1e-6
#: Steps of the table of weights, between which they are interpolated: exact to 4e-7.
PHASES = 1024


def weight_table(taps: int) -> Float32:
    """Return ((PHASES + 2) * taps,) float32 weights of `taps` pixels for positions k / PHASES past the left middle one.

    `taps` is 2 (bilinear), 4 (cubic: Keys 1981 with a = -1/2, exact for parabolas) or 8 (Lanczos, normalised).
    """
    f = np.arange(PHASES + 2)[:, None] / PHASES
    distance = np.abs(np.arange(taps) - (taps // 2 - 1) - f)
    if taps == 2:
        weights = np.maximum(1.0 - distance, 0.0)
    elif taps == 4:
        near, far = (
            (1.5 * distance - 2.5) * distance**2 + 1.0,
            ((2.5 - 0.5 * distance) * distance - 4.0) * distance + 2.0,
        )
        weights = np.where(distance <= 1, near, np.where(distance <= 2, far, 0.0))
    else:
        weights = np.where(distance <= 4, np.sinc(distance) * np.sinc(distance / 4.0), 0.0)
    return np.ascontiguousarray(weights / weights.sum(axis=1, keepdims=True), np.float32).ravel()


@inlined
def _weights(table: Float32, fraction: float, weights: Float32) -> None:
    position = fraction * PHASES
    phase = int(position)
    part = np.float32(position - phase)
    taps = weights.size
    for k in range(taps):
        here = np.uint64(phase * taps + k)
        weights[k] = table[here] + part * (table[here + np.uint64(taps)] - table[here])


@inlined
def _blend2(flat: Float32, base: Any, stride: Any, w: Float32, line: Float32) -> None:
    w0, w1 = w[0], w[1]
    for k in range(line.size):
        t = base + np.uint64(k)
        line[k] = w0 * flat[t] + w1 * flat[t + stride]


@inlined
def _blend4(flat: Float32, base: Any, stride: Any, w: Float32, line: Float32) -> None:
    w0, w1, w2, w3 = w[0], w[1], w[2], w[3]
    b1, b2, b3 = base + stride, base + stride + stride, base + stride + stride + stride
    for k in range(line.size):
        t = np.uint64(k)
        line[k] = (w0 * flat[base + t] + w1 * flat[b1 + t]) + (w2 * flat[b2 + t] + w3 * flat[b3 + t])


@inlined
def _blend8(flat: Float32, base: Any, stride: Any, w: Float32, line: Float32) -> None:
    w0, w1, w2, w3, w4, w5, w6, w7 = w[0], w[1], w[2], w[3], w[4], w[5], w[6], w[7]
    two, four = stride + stride, stride + stride + stride + stride
    b1, b2, b3, b4 = base + stride, base + two, base + two + stride, base + four
    b5, b6, b7 = b4 + stride, b4 + two, b4 + two + stride
    for k in range(line.size):
        t = np.uint64(k)
        line[k] = ((w0 * flat[base + t] + w1 * flat[b1 + t]) + (w2 * flat[b2 + t] + w3 * flat[b3 + t])) + (
            (w4 * flat[b4 + t] + w5 * flat[b5 + t]) + (w6 * flat[b6 + t] + w7 * flat[b7 + t])
        )


@inlined
def _blend(flat: Float32, base: Any, stride: Any, weights: Float32, line: Float32) -> None:
    """Fill `line` with the weighted sum of rows of `flat`, `stride` apart, the first starting at `base`."""
    if weights.size == 8:
        _blend8(flat, base, stride, weights, line)
    elif weights.size == 4:
        _blend4(flat, base, stride, weights, line)
    else:
        _blend2(flat, base, stride, weights, line)


@compiled
def _support(position: float, table: Float32, taps: int, weights: Float32) -> tuple[int, int]:
    """Return the first pixel and the number of pixels a position rests on, and fill their weights."""
    nearest = math.floor(position + 0.5)
    if abs(position - nearest) < SNAP:
        weights[0] = 1.0
        return nearest, 1
    left = math.floor(position)
    _weights(table, position - left, weights)
    return left - taps // 2 + 1, taps


@compiled
def _careful(
    flat: Float32,
    mask: BoolArray,
    x: float,
    y: float,
    table: Float32,
    taps: int,
    channels: int,
    wx: Float32,
    wy: Float32,
    out: Float32,
) -> bool:
    """Fill `out` (channels,) with the sample at (x, y); False where the support is not all data."""
    height, width = mask.shape
    x0, nx = _support(x, table, taps, wx)
    y0, ny = _support(y, table, taps, wy)
    if x0 < 0 or y0 < 0 or x0 + nx > width or y0 + ny > height:
        return False
    for row in range(y0, y0 + ny):
        for col in range(x0, x0 + nx):
            if not mask[row, col]:
                return False
    for channel in range(channels):
        total = np.float32(0.0)
        for row in range(ny):
            line = np.float32(0.0)
            for col in range(nx):
                line += wx[col] * flat[((y0 + row) * width + x0 + col) * channels + channel]
            total += wy[row] * line
        out[channel] = total
    return True


@compiled
def _line_of(nodes: FloatArray, step: int, row: int, line: FloatArray) -> None:
    """Fill `line` with the nodes of the lattice, interpolated to one row of pixels."""
    above = row // step
    part = (row - above * step) / step
    for j in range(line.size):
        # A node beyond the tile may be NaN and must not be touched where its weight is 0.
        line[j] = nodes[above, j] if part == 0.0 else nodes[above, j] * (1.0 - part) + nodes[above + 1, j] * part


@compiled
def interpolate(
    flat: Float32,
    mask: BoolArray,
    inner: BoolArray,
    nodes_x: FloatArray,
    nodes_y: FloatArray,
    step: int,
    table: Float32,
    taps: int,
    channels: int,
    values: Float32,
    valid: BoolArray,
) -> None:
    """Fill `values` (h, w, channels) and `valid` (h, w) with samples of an image.

    Parameters
    ----------
    flat : (H * W * channels,) float32 samples; complex ones have two channels
    mask : (H, W) bool, True = data
    inner : (H, W) bool, True where all pixels within the support of a position just right of and below it are data
    nodes_x, nodes_y : positions at every `step`-th pixel of the tile, between which they are interpolated linearly
    table : of `weight_table`
    taps : 1 (nearest), 2 (bilinear), 4 (cubic) or 8 (lanczos)

    Notes
    -----
    A value whose support touches an invalid pixel or leaves the image is 0 and invalid. Sums are made in float32, at
    most 8 x 8 terms in a fixed order.
    """
    height, width = mask.shape
    wx, wy = np.empty(taps, np.float32), np.empty(taps, np.float32)
    line, one = np.empty(taps * channels, np.float32), np.empty(channels, np.float32)
    line_x, line_y = np.empty(nodes_x.shape[1]), np.empty(nodes_x.shape[1])
    stride, reach = np.uint64(width * channels), taps // 2 - 1
    start_x, start_y, slope_x, slope_y = 0.0, 0.0, 0.0, 0.0
    for i in range(values.shape[0]):
        _line_of(nodes_x, step, i, line_x)
        _line_of(nodes_y, step, i, line_y)
        node, past = -1, step - 1
        for j in range(values.shape[1]):
            past += 1
            if past == step:
                node, past = node + 1, 0
                x, y = line_x[node], line_y[node]
                if step > 1:
                    start_x, start_y = x, y
                    slope_x, slope_y = (line_x[node + 1] - x) / step, (line_y[node + 1] - y) / step
            else:
                x, y = start_x + past * slope_x, start_y + past * slope_y
            for channel in range(channels):
                values[i, j, channel] = 0.0
            valid[i, j] = False
            if not (-1.0 < x < width and -1.0 < y < height):  # NaN comes here too
                continue
            if taps == 1:
                left, top = math.floor(x + 0.5), math.floor(y + 0.5)
                if 0 <= left < width and 0 <= top < height and mask[top, left]:
                    for channel in range(channels):
                        values[i, j, channel] = flat[(top * width + left) * channels + channel]
                    valid[i, j] = True
                continue
            left, top = math.floor(x), math.floor(y)
            fx, fy = x - left, y - top
            quick = SNAP < fx < 1.0 - SNAP and SNAP < fy < 1.0 - SNAP and left >= 0 and top >= 0
            if quick and inner[top, left]:
                _weights(table, fx, wx)
                _weights(table, fy, wy)
                _blend(flat, np.uint64(((top - reach) * width + left - reach) * channels), stride, wy, line)
                for channel in range(channels):
                    total = np.float32(0.0)
                    for k in range(taps):
                        total += wx[k] * line[k * channels + channel]
                    values[i, j, channel] = total
                valid[i, j] = True
            elif _careful(flat, mask, x, y, table, taps, channels, wx, wy, one):
                for channel in range(channels):
                    values[i, j, channel] = one[channel]
                valid[i, j] = True
