"""Histograms of gradient directions around keypoints: dominant orientation and GLOH-like log-polar descriptors.

References
----------
D. Lowe, "Distinctive image features from scale-invariant keypoints", IJCV 60 (2004) 91,
DOI 10.1023/B:VISI.0000029664.99615.94. K. Mikolajczyk, C. Schmid, "A performance evaluation of local descriptors",
IEEE TPAMI 27 (2005) 1615, DOI 10.1109/TPAMI.2005.188 (GLOH).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from featreg.types import FloatArray

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]

#: Directions of a descriptor's histograms, and of the histogram from which the dominant orientation is read.
DIRECTIONS = 8
ORIENTATIONS = 36
SECTORS = 8
CELLS = 1 + 2 * SECTORS
#: Outer radii of the central disc and the inner ring, relative to that of the descriptor.
DISC, RING = 0.25, 0.73
# No component of a unit descriptor may exceed this (Lowe): a few strong edges must not decide alone.
CLIP = 0.2


@dataclass(frozen=True, eq=False)
class PolarField:
    """A gradient field by length and direction.

    `magnitude` (H, W) float32; `direction` (H, W) float32 radians in [0, 2 pi), counter-clockwise as seen, towards
    growing values.
    """

    magnitude: F32
    direction: F32

    @classmethod
    def of(cls, gx: F32, gy: F32) -> PolarField:
        """From (H, W) float32 components along x and (downwards) y."""
        import cv2

        magnitude, direction = cv2.cartToPolar(gx, gy)
        # Counter-clockwise as seen is the other way round than OpenCV's, whose y points down.
        return cls(np.asarray(magnitude, np.float32), np.asarray(np.float32(2 * math.pi) - direction, np.float32))


def dominant_orientation(field: PolarField, xy: FloatArray, radius: FloatArray, step: float = 0.14) -> FloatArray:
    """Return the (N,) direction in radians around which the gradients near each point gather.

    Parameters
    ----------
    field : the gradients
    xy : (N, 2) points in pixels of the field
    radius : (N,) of the discs in pixels of the field; weights fall as a Gaussian of half the radius
    step : distance of the samples relative to the radius

    Notes
    -----
    Lowe's histogram of 36 directions weighted by magnitude, smoothed, its highest peak refined by a parabola.
    Secondary peaks make no points of their own.
    """
    from featreg.sar import histogram_kernels

    pattern, weights = _disc(step)
    histograms = _pooled(field, xy, radius, np.zeros(len(xy)), pattern, np.zeros((len(weights), 1), np.int64), weights,
                         1, ORIENTATIONS)  # fmt: skip
    angle = np.empty(len(xy))
    histogram_kernels.peak_direction(histograms, angle)
    return angle


def gloh(
    field: PolarField, xy: FloatArray, radius: FloatArray, angle: FloatArray, step: float = 1 / 12, soft: bool = True
) -> F32:
    """Return (N, 136) float32 histograms of the gradients around each point, not normalised.

    Parameters
    ----------
    field : the gradients
    xy : (N, 2) points in pixels of the field
    radius : (N,) of the descriptors in pixels of the field
    angle : (N,) radians; cells and directions are relative to it
    step : distance of the samples relative to the radius
    soft : share each sample between neighbouring cells instead of giving it to one

    Notes
    -----
    A central disc and two rings of eight sectors (radii 0.25, 0.73 and 1), each with a histogram of eight directions:
    GLOH's 17 cells with half of its directions. Samples lie on a square grid that turns with the point and read the
    nearest pixel of the field; what lies outside the field counts as no gradient.
    """
    pattern, cells, shares = gloh_pattern(step, soft)
    return _pooled(field, xy, radius, angle, pattern, cells, shares, CELLS, DIRECTIONS)


def normalised(histograms: F32, root: bool = False) -> F32:
    """Return unit vectors whose components were clipped at 0.2 and brought to unit length again.

    `root` takes the root of each component's share instead (R. Arandjelovic, A. Zisserman, CVPR 2012,
    DOI 10.1109/CVPR.2012.6248018), which makes the Euclidean distance one of distributions. Empty rows stay 0.
    """
    if root:
        total = histograms.sum(axis=1, keepdims=True)
        return np.asarray(np.sqrt(histograms / np.where(total > 0, total, 1)), np.float32)
    clipped = np.minimum(_unit(histograms), np.float32(CLIP))
    return _unit(clipped)


def _unit(rows: F32) -> F32:
    length = np.sqrt(np.einsum("ij,ij->i", rows, rows))
    return np.asarray(rows / np.where(length > 0, length, 1)[:, None], np.float32)


def _pooled(
    field: PolarField, xy: FloatArray, radius: FloatArray, angle: FloatArray, pattern: F32, cells: I64, shares: F32,
    count: int, bins: int,
) -> F32:  # fmt: skip
    from featreg.sar import histogram_kernels

    height, width = field.magnitude.shape
    out = np.zeros((len(xy), count * bins), np.float32)
    histogram_kernels.pool(
        np.ascontiguousarray(field.magnitude).ravel(), np.ascontiguousarray(field.direction).ravel(), width, height,
        np.ascontiguousarray(xy, np.float64), np.ascontiguousarray(radius, np.float64),
        np.ascontiguousarray(angle, np.float64), pattern, cells, shares, bins, out,
    )  # fmt: skip
    return out


@lru_cache(maxsize=16)
def _disc(step: float) -> tuple[F32, F32]:
    pattern = _grid(step)
    weights = np.exp(-2.0 * (pattern.astype(np.float64) ** 2).sum(axis=0)).astype(np.float32)[:, None]
    return pattern, weights


@lru_cache(maxsize=16)
def gloh_pattern(step: float, soft: bool = True) -> tuple[F32, I64, F32]:
    """Return samples (2, S) in the unit disc, and (S, C) the cells each belongs to and with which weight.

    Cell 0 is the disc; 1 to 8 are the sectors of the inner ring, the first centred on the point's direction, the
    others following counter-clockwise; 9 to 16 those of the outer ring. With `soft`, C is 4 and the weights of a
    sample add up to 1.
    """
    pattern = _grid(step)
    rho = np.hypot(*pattern.astype(np.float64))
    place = np.arctan2(pattern[1], pattern[0]).astype(np.float64) * (SECTORS / (2 * math.pi))
    if not soft:
        ring = np.searchsorted([DISC, RING], rho)
        sector = np.rint(place).astype(np.int64) % SECTORS
        cells = np.where(ring == 0, 0, 1 + (ring - 1) * SECTORS + sector)[:, None]
        return pattern, cells, np.ones(cells.shape, np.float32)
    middles = [0.0, (DISC + RING) / 2, (RING + 1) / 2]
    between = np.clip(np.interp(rho, middles, [0.0, 1.0, 2.0]), 0, 2)
    inner = np.minimum(np.floor(between), 1).astype(np.int64)
    outward = between - inner
    first = np.floor(place).astype(np.int64)
    onward = place - first
    cells, shares = [], []
    for ring, ring_share in ((inner, 1 - outward), (inner + 1, outward)):
        for sector, sector_share in ((first % SECTORS, 1 - onward), ((first + 1) % SECTORS, onward)):
            cells.append(np.where(ring == 0, 0, 1 + (ring - 1) * SECTORS + sector))
            shares.append(ring_share * sector_share)
    return pattern, np.column_stack(cells), np.column_stack(shares).astype(np.float32)


def _grid(step: float) -> F32:
    """A square grid of samples inside the unit disc, symmetric about its centre: (2, S)."""
    steps = np.arange(-math.floor(1 / step), math.floor(1 / step) + 1) * step
    u, v = np.meshgrid(steps, steps)
    inside = u * u + v * v <= 1
    return np.stack([u[inside], v[inside]]).astype(np.float32)
