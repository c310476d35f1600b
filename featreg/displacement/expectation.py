"""What a field of displacements says beforehand of the windows that are measured."""

from __future__ import annotations

import numpy as np

from featreg.displacement.band import F32
from featreg.sar.grid_correlation import Expected, WindowGrid, piece_middles
from featreg.types import FloatArray

#: RMS distance of a neighbourhood from a plane, px, beyond which it is none.
ROUGH = 0.5


def expectation(field: F32, windows: WindowGrid) -> Expected:
    """Return what a field (rows, cols, 2) of the windows' middles says of the windows and of their pieces.

    The slope of a cell is that of the plane of least squares through the 5 x 5 cells around, 0 where the cells lie too
    far from any plane, as along a fault.
    """
    import cv2

    side = min(5, *(n - (n + 1) % 2 for n in windows.shape))
    at = np.arange(side) - side // 2
    slope = np.zeros((*windows.shape, 2, 2))
    if side > 1:
        flat, ramp = np.full(side, 1 / side), at / (at**2).sum()

        def fit(along_x: FloatArray, along_y: FloatArray) -> F32:
            return np.asarray(cv2.sepFilter2D(field, -1, along_x, along_y, borderType=cv2.BORDER_REPLICATE), np.float32)

        mean, right, down = fit(flat, flat), fit(ramp, flat), fit(flat, ramp)
        power = cv2.blur(field * field, (side, side), borderType=cv2.BORDER_REPLICATE) - mean**2
        power -= (right**2 + down**2) * np.mean(at**2)
        plane = power.sum(axis=-1, keepdims=True) <= ROUGH**2
        steps = [float(np.diff(starts).mean()) for starts in (windows.lefts, windows.tops)]
        slope = np.where(plane[..., None], np.stack([right, down], -1) / steps, 0.0)
    half = (windows.window - 1) / 2
    map_x, map_y = np.meshgrid(
        *(
            np.interp(middles, starts + half, np.arange(len(starts))).astype(np.float32)
            for middles, starts in zip(piece_middles(windows), (windows.lefts, windows.tops), strict=True)
        )
    )
    pieces = cv2.remap(field, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return Expected(field.astype(np.float64), slope, np.rint(pieces).astype(np.int64))
