"""Compiled loops of the direction around which the gradients near a point gather."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled
from featreg.sar.keypoints.histogram_kernels import look_up, polar_of

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]


@compiled
def _gather_seen(gx: F32, gy: F32, at: I32, across: F32, down: F32) -> None:
    for k in range(at.shape[0]):
        place = np.uint64(max(at[k], np.int32(0)))
        across[k] = gx[place]
        down[k] = gy[place]


@compiled
def _weighed(strength: F32, share: F32, at: I32, place: F32, per_radian: np.float32, bins: np.float32) -> None:
    """Turn directions into places on the circle of bins, and weigh the strengths; those outside count as none."""
    for k in range(strength.shape[0]):
        weight = share[k] * strength[k]
        strength[k] = weight if at[k] >= np.int32(0) else np.float32(0)
        t = place[k] * per_radian
        place[k] = t - bins if t >= bins else t


@compiled
def _share_out(place: F32, strength: F32, first: I32, upper: F32) -> None:
    """The lower of the two nearest bins, and what the upper one gets; `strength` keeps what the lower gets."""
    for k in range(place.shape[0]):
        low = np.int32(place[k])
        first[k] = low
        upper[k] = (place[k] - np.float32(low)) * strength[k]
        strength[k] -= upper[k]


@compiled
def _peak(histogram: F64, smooth: F64) -> float:
    """Place of the peak of a histogram on a circle, smoothed by (1, 4, 6, 4, 1) / 16 after Lowe; 0 of an empty one.

    `histogram` has three bins more on either side, the last and the first ones again, `smooth` one. A parabola through
    the three highest values refines it.
    """
    for k in range(smooth.shape[0]):
        near = histogram[k + 1] + histogram[k + 3]
        smooth[k] = 6.0 * histogram[k + 2] + 4.0 * near + (histogram[k] + histogram[k + 4])
    best = 1
    for k in range(2, smooth.shape[0] - 1):
        if smooth[k] > smooth[best]:
            best = k
    if smooth[best] <= 0.0:
        return 0.0
    before, after = smooth[best - 1], smooth[best + 1]
    curve = before - 2.0 * smooth[best] + after
    return best - 1 + (0.5 * (before - after) / curve if curve < 0.0 else 0.0)


@compiled
def directions(
    gx: F32, gy: F32, width: int, height: int, order: I64, xy: F64, radius: F64, pattern: F32, share: F32, bins: int,
    angle: F64,
) -> None:  # fmt: skip
    """Fill `angle` (N,) with the radians around which the gradients near each point gather.

    `gx`, `gy` (H * W,) are the flat components, y down, of which only what the samples meet is read. `pattern` (2, S)
    holds the samples in units of the radius, y up, `share` (S,) their weights. A sample counts, by its length, in the
    two of `bins` that are nearest to its direction. Points are taken in the `order` (N,) given.
    """
    samples = pattern.shape[1]
    at, first = np.empty(samples, np.int32), np.empty(samples, np.int32)
    across, down = np.empty(samples, np.float32), np.empty(samples, np.float32)
    strength, place = np.empty(samples, np.float32), np.empty(samples, np.float32)
    upper = np.empty(samples, np.float32)
    histogram, smooth = np.empty(bins + 6), np.empty(bins + 2)
    # Two histograms by turns: what was just written is not asked for at once.
    even, odd = np.empty(bins + 1, np.float32), np.empty(bins + 1, np.float32)
    per_radian = np.float32(bins / (2 * np.pi))
    nothing = np.float32(0)
    for n in range(xy.shape[0]):
        i = order[n]
        x, y, reach = np.float32(xy[i, 0]), np.float32(xy[i, 1]), np.float32(radius[i])
        look_up(x, y, reach, nothing, width, height, pattern[0], pattern[1], at)
        _gather_seen(gx, gy, at, across, down)
        polar_of(across, down, strength, place)
        _weighed(strength, share, at, place, per_radian, np.float32(bins))
        _share_out(place, strength, first, upper)
        even[:], odd[:] = 0, 0
        for k in range(0, samples - 1, 2):
            one, two = np.uint64(first[k]), np.uint64(first[k + 1])
            even[one] += strength[k]
            odd[two] += strength[k + 1]
            even[one + np.uint64(1)] += upper[k]
            odd[two + np.uint64(1)] += upper[k + 1]
        if samples % 2:
            one = np.uint64(first[samples - 1])
            even[one] += strength[samples - 1]
            even[one + np.uint64(1)] += upper[samples - 1]
        # The bin behind the last is the first.
        even[0] += even[bins]
        odd[0] += odd[bins]
        for b in range(bins):
            histogram[b + 3] = even[b] + odd[b]
        for b in range(3):
            histogram[b], histogram[bins + 3 + b] = histogram[bins + b], histogram[b + 3]
        angle[i] = _peak(histogram, smooth) * (2.0 * np.pi / bins)
