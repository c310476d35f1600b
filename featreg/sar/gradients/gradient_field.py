"""Gradient fields of a SAR image, computed once and shared: ROEWA ratio gradients at any scale.

Fields of large scale are computed on a halved image; `octave` finds it, `from_base` maps points to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from featreg.sar.gradients.ratio import ratio_gradients, roewa
from featreg.sar.pyramid import pyramid, whole_squares
from featreg.sar.speckle import filled_amplitude
from featreg.types import BoolArray, FloatArray, Image

F32 = NDArray[np.float32]

# Pixels nearer than so many alpha to nodata, which counts as the mean, get no ratio gradient.
BLIND = 3.0
# A scale is computed on the coarsest halving of the image on which its alpha is at least so many pixels.
COARSEST_GRID = 1.25


@dataclass(frozen=True, eq=False)
class GradientField:
    """A gradient field.

    `x`, `y` (H, W) float32, the components along x and (downwards) y, towards growing values.
    """

    x: F32
    y: F32


def octave(image: Image, alpha: float, finest: float = COARSEST_GRID) -> tuple[Image, float]:
    """Return the image, halved as often as leaves `alpha` at least `finest` (inf: not at all), and what alpha is there.

    What is smoothed over many pixels says as much on a coarser grid, at a quarter of the cost each time.
    """
    halvings = max(0, math.floor(math.log2(alpha / finest) + 1e-6)) if finest < math.inf else 0
    chain = pyramid(image, halvings + 1, 2.0)
    level = chain[-1]
    return level, alpha / 2 ** (len(chain) - 1)


def from_base(xy: FloatArray, level: Image, base: Image) -> FloatArray:
    """Map (N, 2) points of the base image to a level of it; the inverse of `to_base`."""
    scale = np.array([level.shape[1] / base.shape[1], level.shape[0] / base.shape[0]])
    return np.asarray((xy + 0.5) * scale - 0.5)


def clear_of_nodata(image: Image, distance: float) -> BoolArray:
    """Return the (H, W) bool map of pixels with no invalid one in a square of `distance` pixels; borders are free."""
    return whole_squares(image.mask, math.ceil(distance), outside=True)


def filled_gradients(level: Image, alpha: float, floor: float) -> tuple[F32, F32]:
    """Return ROEWA gradients (H, W) with invalid pixels at the mean amplitude: false within some alpha of them.

    Half the cost of `ratio_gradients`, where that has to weigh its means; equal to it where every pixel is valid.
    """
    if level.all_valid:
        return ratio_gradients(level, alpha, floor)
    return level.derive(_filled_gradients, alpha=float(alpha), floor=float(floor))


def _filled_gradients(level: Image, alpha: float, floor: float) -> tuple[F32, F32]:
    return roewa(filled_amplitude(level), alpha, None, floor)


def ratio_field(level: Image, alpha: float, floor: float) -> GradientField:
    """Return the ROEWA gradient of an image, computed once; 0 within 3 alpha of nodata."""
    return level.derive(_ratio_field, alpha=float(alpha), floor=float(floor))


def _ratio_field(level: Image, alpha: float, floor: float) -> GradientField:
    gx, gy = filled_gradients(level, alpha, floor)
    if level.all_valid:
        return GradientField(gx, gy)
    clear = clear_of_nodata(level, BLIND * alpha)
    return GradientField(gx * clear, gy * clear)
