"""The compiled loop that paints outlines: unlike OpenCV's `fillPoly` it does not round their corners to whole rows."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.jit import compiled
from featreg.types import FloatArray, IntArray


@compiled
def paint_outlines(canvas: NDArray[np.float32], corners: FloatArray, ends: IntArray, colours: FloatArray) -> None:
    """Paint closed outlines one over the other.

    Parameters
    ----------
    canvas : (H, W, C) float32, painted in place; a sample is inside where its centre is (even-odd rule)
    corners : (N, 2) float64 corners of all outlines one after the other, in samples
    ends : (P,) int64 row in `corners` where each outline ends
    colours : (P, C) float64 values of each outline
    """
    height, width, channels = canvas.shape
    crossings = np.empty(len(corners))
    first = 0
    for outline in range(len(ends)):
        last = ends[outline]
        low, high = corners[first, 1], corners[first, 1]
        for i in range(first, last):
            low, high = min(low, corners[i, 1]), max(high, corners[i, 1])
        for row in range(max(0, math.ceil(low)), min(height - 1, math.floor(high)) + 1):
            count = 0
            previous = last - 1
            for i in range(first, last):
                y0, y1 = corners[previous, 1], corners[i, 1]
                if (y0 <= row) != (y1 <= row):
                    x = corners[previous, 0] + (row - y0) * (corners[i, 0] - corners[previous, 0]) / (y1 - y0)
                    place = count
                    while place > 0 and crossings[place - 1] > x:
                        crossings[place] = crossings[place - 1]
                        place -= 1
                    crossings[place] = x
                    count += 1
                previous = i
            for pair in range(0, count - 1, 2):
                start, stop = max(0, math.ceil(crossings[pair])), min(width, math.ceil(crossings[pair + 1]))
                for column in range(start, stop):
                    for channel in range(channels):
                        canvas[row, column, channel] = colours[outline, channel]
        first = last
