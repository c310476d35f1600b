"""Compiled centring and scaling of the points of a fit; `featreg.geometry.base` says what it is for."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled

F64 = NDArray[np.float64]


@compiled
def normalised(
    reference: F64, secondary: F64, weights: F64, farthest: float, here: F64, there: F64, scaled: F64, centres: F64
) -> int:
    """Write the points of positive weight, centred and scaled, and their weights; return how many there are.

    Parameters
    ----------
    reference, secondary : (M, 2) px
    weights : (M,)
    farthest : coordinates beyond this are none, px
    here, there, scaled : (M, 2), (M, 2) and (M,) to be filled from the first row on: points of weighted mean 0 and mean
        square length 1 (of which all coincide: 0), weights of mean 1
    centres : (6,) filled with the two centres and the two scales, px

    Returns
    -------
    -1 where a coordinate or a weight is not finite, or a weight is negative
    """
    count, heaviest = 0, 0.0
    for i in range(weights.shape[0]):
        near = abs(reference[i, 0]) < farthest and abs(reference[i, 1]) < farthest
        near = near and abs(secondary[i, 0]) < farthest and abs(secondary[i, 1]) < farthest
        if not (near and weights[i] >= 0.0 and weights[i] < math.inf):
            return -1
        if weights[i] > 0.0:
            here[count, 0], here[count, 1] = reference[i, 0], reference[i, 1]
            there[count, 0], there[count, 1] = secondary[i, 0], secondary[i, 1]
            scaled[count] = weights[i]
            heaviest = max(heaviest, weights[i])
            count += 1
    if count == 0:
        return 0
    # Two divisions: the mean of weights near the end of float64's range must not overflow.
    total = 0.0
    for i in range(count):
        scaled[i] /= heaviest
        total += scaled[i]
    mean = total / count
    x = y = u = v = 0.0
    for i in range(count):
        w = scaled[i] / mean
        scaled[i] = w
        x += w * here[i, 0]
        y += w * here[i, 1]
        u += w * there[i, 0]
        v += w * there[i, 1]
    x, y, u, v = x / count, y / count, u / count, v / count
    one = two = 0.0
    for i in range(count):
        here[i, 0] -= x
        here[i, 1] -= y
        there[i, 0] -= u
        there[i, 1] -= v
        one += scaled[i] * (here[i, 0] * here[i, 0] + here[i, 1] * here[i, 1])
        two += scaled[i] * (there[i, 0] * there[i, 0] + there[i, 1] * there[i, 1])
    first, second = math.sqrt(one / count), math.sqrt(two / count)
    centres[0], centres[1], centres[2], centres[3], centres[4], centres[5] = x, y, u, v, first, second
    per_first = 1.0 / first if first > 0.0 else 1.0
    per_second = 1.0 / second if second > 0.0 else 1.0
    for i in range(count):
        here[i, 0] *= per_first
        here[i, 1] *= per_first
        there[i, 0] *= per_second
        there[i, 1] *= per_second
    return count
