"""Compiled loops of angle-weighted gradients; `featreg.sar.gradients.angle_weighted` says what they compute."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

F32 = NDArray[np.float32]


@compiled
def share_out(length: F32, direction: F32, out: F32) -> None:
    """Share the (N,) lengths of gradients between the two of the (K, N) channels whose directions lie next to theirs.

    Directions are in radians and count modulo half a turn; what `out` holds is overwritten.
    """
    count = out.shape[0]
    per_radian = np.float32(count / math.pi)
    out[:] = np.float32(0)
    for i in range(length.shape[0]):
        place = direction[i] * per_radian
        below = math.floor(place)
        above = place - np.float32(below)
        out[below % count, i] += length[i] * (np.float32(1) - above)
        out[(below + 1) % count, i] += length[i] * above


@compiled
def normalise(channels: F32, weak: np.float32) -> None:
    """Divide the (K, N) channels of each sample by their length plus `weak`, and take their mean off, in place."""
    count = channels.shape[0]
    for i in range(channels.shape[1]):
        square, total = np.float32(0), np.float32(0)
        for k in range(count):
            square += channels[k, i] * channels[k, i]
            total += channels[k, i]
        gain = np.float32(1) / (np.sqrt(square) + weak)
        mean = total / np.float32(count)
        for k in range(count):
            channels[k, i] = (channels[k, i] - mean) * gain
