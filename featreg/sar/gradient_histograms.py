"""Histograms of gradient directions around keypoints: dominant orientation and GLOH-like log-polar descriptors.

References
----------
D. Lowe, "Distinctive image features from scale-invariant keypoints", IJCV 60 (2004) 91,
DOI 10.1023/B:VISI.0000029664.99615.94. K. Mikolajczyk, C. Schmid, "A performance evaluation of local descriptors",
IEEE TPAMI 27 (2005) 1615, DOI 10.1109/TPAMI.2005.188 (GLOH).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from featreg.sar.pyramid import pyramid
from featreg.sar.ratio import ratio_gradients, roewa
from featreg.sar.speckle import filled_amplitude
from featreg.types import BoolArray, Features, FloatArray, Image

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]

#: Directions of a descriptor's histograms, and of the histogram from which the dominant orientation is read.
DIRECTIONS = 8
HARMONICS = DIRECTIONS // 2
ORIENTATIONS = 36
SECTORS = 8
CELLS = 1 + 2 * SECTORS
LENGTH = CELLS * DIRECTIONS
#: Outer radii of the central disc and the inner ring, relative to that of the descriptor.
DISC, RING = 0.25, 0.73
# Pixels nearer than so many alpha to nodata, which counts as the mean, get no ratio gradient.
BLIND = 3.0
# Pieces of equal weight into which the patterns are cut.
DISC_RINGS, PIECE_RINGS = 8, 8
# Points whose pieces are held at a time.
BLOCK = 64
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


def octave(image: Image, alpha: float, finest: float = 1.25) -> tuple[Image, float]:
    """Return the image, halved as often as leaves `alpha` at least `finest`, and what alpha is there.

    What is smoothed over many pixels says as much on a coarser grid, at a quarter of the cost each time.
    """
    halvings = max(0, math.floor(math.log2(alpha / finest) + 1e-6))
    chain = pyramid(image, halvings + 1, 2.0)
    level = chain[-1]
    return level, alpha / 2 ** (len(chain) - 1)


def from_base(xy: FloatArray, level: Image, base: Image) -> FloatArray:
    """Map (N, 2) points of the base image to a level of it; the inverse of `to_base`."""
    scale = np.array([level.shape[1] / base.shape[1], level.shape[0] / base.shape[0]])
    return np.asarray((xy + 0.5) * scale - 0.5)


def clear_of_nodata(image: Image, distance: float) -> BoolArray:
    """Return the (H, W) bool map of pixels with no invalid one in a square of `distance` pixels; borders are free."""
    import cv2

    side = 2 * math.ceil(distance) + 1
    return np.asarray(cv2.erode(image.mask.view(np.uint8), np.ones((side, side), np.uint8))).view(np.bool_)


def filled_gradients(level: Image, alpha: float, floor: float) -> tuple[F32, F32]:
    """Return ROEWA gradients (H, W) with invalid pixels at the mean amplitude: false within some alpha of them.

    Half the cost of `ratio_gradients`, where that has to weigh its means; equal to it where every pixel is valid.
    """
    if level.all_valid:
        return ratio_gradients(level, alpha, floor)
    return level.derive(_filled_gradients, alpha=float(alpha), floor=float(floor))


def _filled_gradients(level: Image, alpha: float, floor: float) -> tuple[F32, F32]:
    return roewa(filled_amplitude(level), alpha, None, floor)


def ratio_field(level: Image, alpha: float, floor: float) -> PolarField:
    """Return the ROEWA gradient of an image, computed once, by length and direction; 0 within 3 alpha of nodata."""
    return level.derive(_ratio_field, alpha=float(alpha), floor=float(floor))


def _ratio_field(level: Image, alpha: float, floor: float) -> PolarField:
    field = PolarField.of(*filled_gradients(level, alpha, floor))
    if level.all_valid:
        return field
    return PolarField(field.magnitude * clear_of_nodata(level, BLIND * alpha), field.direction)


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

    histograms = _pooled(field, xy, radius, np.zeros(len(xy)), _disc(step), ORIENTATIONS)
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
    return _pooled(field, xy, radius, angle, _log_polar(step, soft), DIRECTIONS)


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


def leading_harmonics(histograms: F32, count: int) -> F32:
    """Return (N, 17 * (1 + 2 count)) float32: the mean and the first `count` harmonics of each cell's directions.

    Their basis is orthonormal, so that distances are those of the histograms without their finest detail, which is
    mostly speckle. With all four harmonics the (N, 136) histograms come back as they are.
    """
    if count >= HARMONICS:
        return histograms
    return np.asarray(histograms @ _harmonic_basis(count), np.float32)


@lru_cache(maxsize=4)
def _harmonic_basis(count: int) -> F32:
    turn = 2 * math.pi * np.arange(DIRECTIONS) / DIRECTIONS
    waves = [wave(k * turn) for k in range(1, count + 1) for wave in (np.cos, np.sin)]
    basis = np.stack([np.full(DIRECTIONS, math.sqrt(0.5)), *waves], axis=1) * math.sqrt(2 / DIRECTIONS)
    return np.kron(basis, np.eye(CELLS)).astype(np.float32)


def described(image: Image, features: Features, descriptors: F32) -> Features:
    """Return the features with (N, D) unit descriptors, less those outside the valid pixels or without any gradient."""
    x, y = np.rint(features.xy).astype(np.int64).T
    height, width = image.shape
    kept = (x >= 0) & (y >= 0) & (x < width) & (y < height) & descriptors.any(axis=1)
    kept[kept] = image.mask[y[kept], x[kept]]
    index = np.flatnonzero(kept)
    return replace(features.take(index), descriptors=descriptors[index], norm="l2", index=index)


def _unit(rows: F32) -> F32:
    length = np.sqrt(np.einsum("ij,ij->i", rows, rows))
    return np.asarray(rows / np.where(length > 0, length, 1)[:, None], np.float32)


@dataclass(frozen=True, eq=False)
class _Pattern:
    """`samples` (2, S) in the unit disc, the `piece` (S,) each belongs to, `shares` (P, cells) of pieces in cells."""

    samples: F32
    piece: I64
    shares: F32


def _pooled(
    field: PolarField, xy: FloatArray, radius: FloatArray, angle: FloatArray, pattern: _Pattern, bins: int
) -> F32:
    """(N, bins * cells): samples go to small pieces first, where each costs two additions, and pieces to cells."""
    from featreg.sar import histogram_kernels

    height, width = field.magnitude.shape
    flat = np.ascontiguousarray(field.magnitude).ravel(), np.ascontiguousarray(field.direction).ravel()
    pieces, cells = pattern.shares.shape
    out = np.empty((len(xy), bins * cells), np.float32)
    xy, radius, angle = (np.ascontiguousarray(values, np.float64) for values in (xy, radius, angle))
    for start in range(0, len(xy), BLOCK):
        rows = slice(start, start + BLOCK)
        small = np.zeros((len(xy[rows]), bins, pieces), np.float32)
        histogram_kernels.pool(
            *flat, width, height, xy[rows], radius[rows], angle[rows], pattern.samples, pattern.piece, small
        )
        out[rows] = (small.reshape(-1, pieces) @ pattern.shares).reshape(-1, bins * cells)
    return out


@lru_cache(maxsize=16)
def _disc(step: float) -> _Pattern:
    """Samples of one cell, in rings whose weights fall as a Gaussian of half the radius."""
    samples = _grid(step)
    rho = np.hypot(*samples.astype(np.float64))
    piece = np.minimum((rho * DISC_RINGS).astype(np.int64), DISC_RINGS - 1)
    middle = (np.arange(DISC_RINGS) + 0.5) / DISC_RINGS
    return _Pattern(samples, piece, np.exp(-2.0 * middle**2).astype(np.float32)[:, None])


@lru_cache(maxsize=16)
def _log_polar(step: float, soft: bool) -> _Pattern:
    """Cell 0 is the disc; 1 to 8 are the sectors of the inner ring, 9 to 16 those of the outer one.

    The first sector is centred on the point's direction, the others follow counter-clockwise. With `soft` a sample is
    shared between the two nearest rings and sectors, as far as pieces of 1/8 of the radius and 1/16 of a turn allow.
    """
    samples = _grid(step)
    rho = np.hypot(*samples.astype(np.float64))
    place = np.arctan2(samples[1], samples[0]).astype(np.float64) * (SECTORS / (2 * math.pi))
    if not soft:
        outward = np.searchsorted([DISC, RING], rho)
        piece = np.where(outward == 0, 0, 1 + (outward - 1) * SECTORS + np.rint(place).astype(np.int64) % SECTORS)
        return _Pattern(samples, piece, np.eye(CELLS, dtype=np.float32))
    out = np.minimum((rho * PIECE_RINGS).astype(np.int64), PIECE_RINGS - 1)
    piece = out * 2 * SECTORS + np.floor(2 * place).astype(np.int64) % (2 * SECTORS)
    ring, sector = np.divmod(np.arange(PIECE_RINGS * 2 * SECTORS), 2 * SECTORS)
    rho, place = (ring + 0.5) / PIECE_RINGS, (sector + 0.5) / 2
    between: FloatArray = np.interp(rho, [0.0, (DISC + RING) / 2, (RING + 1) / 2], [0.0, 1.0, 2.0])
    inner = np.minimum(np.floor(between), 1).astype(np.int64)
    beyond = between - inner
    first = np.floor(place).astype(np.int64)
    onward = place - first
    shares = np.zeros((len(rho), CELLS), np.float32)
    pieces = np.arange(len(rho))
    for nearest, ring_share in ((inner, 1 - beyond), (inner + 1, beyond)):
        for beside, sector_share in ((first, 1 - onward), (first + 1, onward)):
            cell = np.where(nearest == 0, 0, 1 + (nearest - 1) * SECTORS + beside % SECTORS)
            np.add.at(shares, (pieces, cell), ring_share * sector_share)
    return _Pattern(samples, piece, shares)


def _grid(step: float) -> F32:
    """A square grid of samples inside the unit disc, symmetric about its centre: (2, S)."""
    steps = np.arange(-math.floor(1 / step), math.floor(1 / step) + 1) * step
    u, v = np.meshgrid(steps, steps)
    inside = u * u + v * v <= 1
    return np.stack([u[inside], v[inside]]).astype(np.float32)
