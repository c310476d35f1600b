"""Compiled loops of the Harris response of a gradient field."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.jit import compiled

F32 = NDArray[np.float32]


@compiled
def _products_of_row(gx: F32, gy: F32, xx: F32, xy: F32, yy: F32) -> None:
    for i in range(gx.shape[0]):
        xx[i] = gx[i] * gx[i]
        xy[i] = gx[i] * gy[i]
        yy[i] = gy[i] * gy[i]


@compiled
def products(gx: F32, gy: F32, maps: F32) -> None:
    """Fill maps (3, H, W) with gx^2, gx gy and gy^2."""
    for y in range(gx.shape[0]):
        _products_of_row(gx[y], gy[y], maps[0, y], maps[1, y], maps[2, y])


@compiled
def _response_of_row(xx: F32, xy: F32, yy: F32, d: np.float32) -> None:
    for i in range(xx.shape[0]):
        trace = xx[i] + yy[i]
        xx[i] = xx[i] * yy[i] - xy[i] * xy[i] - d * trace * trace


@compiled
def response(maps: F32, d: np.float32) -> None:
    """Overwrite maps[0] with det - d trace^2 of the matrices whose elements xx, xy, yy are maps (3, H, W)."""
    for y in range(maps.shape[1]):
        _response_of_row(maps[0, y], maps[1, y], maps[2, y], d)
