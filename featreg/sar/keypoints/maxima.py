"""Local maxima of a response map, and where they lie between the pixels and between the scales."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.threads import in_parts
from featreg.types import BoolArray, FloatArray, IntArray

F32 = NDArray[np.float32]

#: Maps of more pixels are looked at in so many bands of so many rows first; the floor that they give lets through so
#: many times the maxima that are wanted.
LARGE, BANDS, BAND, MARGIN = 1 << 20, 24, 8, 2.0


def local_maxima(response: F32, allowed: BoolArray, threshold: float, n_features: int) -> IntArray:
    """Return the (N, 2) pixels (x, y) of the local maxima of a map, the highest first, equal ones in reading order.

    Parameters
    ----------
    response : (H, W) float32
    allowed : (H, W) bool, where a maximum may lie; the outermost rows and columns never count
    threshold : a maximum must exceed it
    n_features : how many to return at most

    Notes
    -----
    A pixel counts where it is the highest of its 3 x 3 neighbourhood; of equal ones the first in reading order does.
    """
    flat = np.zeros(0, np.int64)
    floor = _floor(response, allowed, threshold, n_features)
    if floor > threshold:
        flat = _peaks(response, allowed, floor)
    if len(flat) < n_features:
        flat = _peaks(response, allowed, threshold)
    value = -response.ravel()[flat]
    if len(flat) > n_features:
        near = value <= np.partition(value, n_features - 1)[n_features - 1]
        flat, value = flat[near], value[near]
    flat = flat[np.argsort(value, kind="stable")][:n_features]
    y, x = np.divmod(flat, response.shape[1])
    return np.column_stack([x, y]).astype(np.int64)


def _peaks(response: F32, allowed: BoolArray, threshold: float) -> IntArray:
    """The flat indices, in reading order, of all local maxima above a threshold."""
    from featreg.sar.keypoints import harris_kernels

    height, width = response.shape
    found: dict[int, IntArray] = {}

    def part(first: int, stop: int) -> None:
        # The rows beside those that are looked at; beyond the border there are none.
        rows = slice(max(first - 1, 0), min(stop + 1, height))
        room = np.empty((rows.stop - rows.start) * width // 4 + 1, np.int64)
        count = harris_kernels.collect_peaks(response[rows], allowed[rows].view(np.uint8), np.float32(threshold), room)
        found[first] = room[:count] + rows.start * width

    in_parts(part, height, width, 2)
    return np.concatenate([found[first] for first in sorted(found)])


def _floor(response: F32, allowed: BoolArray, threshold: float, n_features: int) -> float:
    """A value that the `n_features` highest maxima of a large map exceed by what bands of its rows say.

    The threshold where they say nothing. Of a map of millions of pixels nearly all maxima are too low to be wanted.
    """
    height = len(response)
    starts = np.linspace(0, height - BAND, BANDS).astype(int) if response.size > LARGE and height > BAND else ()
    values = [np.zeros(0, np.float32)]
    for y in starts:
        band = response[y : y + BAND]
        values.append(band.ravel()[_peaks(band, allowed[y : y + BAND], threshold)])
    seen = np.concatenate(values)
    rank = math.ceil(MARGIN * n_features * len(starts) * (BAND - 2) / height)
    return float(np.partition(seen, len(seen) - rank)[len(seen) - rank]) if 0 < rank < len(seen) else threshold


def quadratic_peak(response: F32, at: IntArray) -> FloatArray:
    """Return (N, 2) float64 positions of the maxima at (N, 2) inner pixels: those of quadratic surfaces.

    The surface has the central differences of the 3 x 3 neighbourhood (Brown and Lowe, BMVC 2002). Where it has no
    maximum, or one more than a pixel away, the pixel itself stays.
    """
    width = response.shape[1]
    return at + quadratic_steps(response.ravel()[around(at[:, 1] * width + at[:, 0], width)])


def around(flat: IntArray, width: int) -> IntArray:
    """Return the (N, 9) flat indices, in reading order, of the 3 x 3 pixels around inner ones (N,) of a map."""
    return np.asarray(flat[:, None] + np.array([dy * width + dx for dy in (-1, 0, 1) for dx in (-1, 0, 1)]))


def quadratic_steps(values: F32) -> FloatArray:
    """Return the (N, 2) steps (x, y) of `quadratic_peak` from the middle of 3 x 3 values (N, 9) in reading order."""
    from featreg.sar.keypoints import peak_kernels

    steps = np.empty((len(values), 2))
    peak_kernels.quadratic_steps(values, steps)
    return steps


def parabola_peak(before: FloatArray, here: FloatArray, after: FloatArray) -> FloatArray:
    """Return the (N,) place, from -0.5 to 0.5, of the peak of the parabola through values at -1, 0 and 1.

    0 where `here` is not the highest of the three.
    """
    curve = before + after - 2 * here
    inside = (here >= before) & (here >= after) & (curve < 0)
    return np.asarray(np.where(inside, 0.5 * (before - after) / np.where(inside, curve, 1), 0.0))


def interpolated(response: F32, xy: FloatArray) -> FloatArray:
    """Return the (N,) float64 bilinear values of a map at (N, 2) points; points outside take the border's value."""
    height, width = response.shape
    x, y = np.clip(xy[:, 0], 0, width - 1), np.clip(xy[:, 1], 0, height - 1)
    left, top = np.minimum(x.astype(np.int64), width - 2), np.minimum(y.astype(np.int64), height - 2)
    u, v = x - left, y - top
    upper = response[top, left] * (1 - u) + response[top, left + 1] * u
    lower = response[top + 1, left] * (1 - u) + response[top + 1, left + 1] * u
    return np.asarray(upper * (1 - v) + lower * v, np.float64)
