"""How gradient directions are distributed around keypoints: dominant orientation, GLOH-like log-polar descriptors.

References
----------
D. Lowe, "Distinctive image features from scale-invariant keypoints", IJCV 60 (2004) 91,
DOI 10.1023/B:VISI.0000029664.99615.94. K. Mikolajczyk, C. Schmid, "A performance evaluation of local descriptors",
IEEE TPAMI 27 (2005) 1615, DOI 10.1109/TPAMI.2005.188 (GLOH).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from featreg.sar.gradients.gradient_field import GradientField
from featreg.types import Features, FloatArray, Image, IntArray

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
# Pieces of equal weight into which the patterns are cut.
DISC_RINGS, PIECE_RINGS = 8, 8
# Rows, in pixels of the field, of the bands in which points are taken along x.
BAND = 32.0
#: What the parameters of a descriptor of these histograms may be.
Step = Annotated[float, Interval(ge=0.01, le=0.25)]
Harmonics = Annotated[int, Interval(ge=0, le=HARMONICS)]
# No component of a unit histogram may exceed the first (Lowe), no cell of unit harmonics the second: a few strong edges
# must not decide alone.
CLIP, CELL_CLIP = 0.2, 0.3


def dominant_orientation(field: GradientField, xy: FloatArray, radius: FloatArray, step: float = 0.14) -> FloatArray:
    """Return the (N,) direction in radians around which the gradients near each point gather.

    Parameters
    ----------
    field : the gradients
    xy : (N, 2) points in pixels of the field
    radius : (N,) of the discs in pixels of the field; weights fall as a Gaussian of half the radius
    step : distance of the samples relative to the radius

    Notes
    -----
    Lowe's histogram of 36 directions weighted by magnitude, smoothed, its highest peak refined by a parabola. Secondary
    peaks are those of `further_orientations`.
    """
    from featreg.sar.keypoints import direction_kernels

    height, width = field.x.shape
    gx, gy = (np.ascontiguousarray(part).ravel() for part in (field.x, field.y))
    xy, radius = (np.ascontiguousarray(values, np.float64) for values in (xy, radius))
    pattern, angle = _disc(step), np.empty(len(xy))
    direction_kernels.directions(
        gx, gy, width, height, along_rows(xy, width), xy, radius, pattern.samples, pattern.weight, ORIENTATIONS, angle
    )
    return angle


def further_orientations(
    field: GradientField, xy: FloatArray, radius: FloatArray, share: float, step: float = 0.14
) -> tuple[IntArray, FloatArray]:
    """Return ((K,) rows, (K,) radians): the lower peaks of the histograms of `dominant_orientation` near (N, 2) points.

    Those of at least `share` of the highest peak count, as Lowe (2004, section 5) takes them with a share of 0.8.
    """
    histograms = _pooled(field, xy, radius, np.zeros(len(xy)), _disc(step), ORIENTATIONS).astype(np.float64)
    smooth = 6 * histograms
    for shift, weight in ((1, 4.0), (2, 1.0)):
        smooth += weight * (np.roll(histograms, shift, axis=1) + np.roll(histograms, -shift, axis=1))
    before, after = np.roll(smooth, 1, axis=1), np.roll(smooth, -1, axis=1)
    peak = (smooth > before) & (smooth >= after) & (smooth >= share * smooth.max(axis=1, keepdims=True))
    peak[np.arange(len(xy)), smooth.argmax(axis=1)] = False
    rows, bins = np.nonzero(peak)
    low, high = before[rows, bins], after[rows, bins]
    curve = low - 2 * smooth[rows, bins] + high
    offset = np.where(curve < 0, 0.5 * (low - high) / np.where(curve < 0, curve, -1.0), 0.0)
    return rows.astype(np.int64), (bins + offset) * 2 * np.pi / ORIENTATIONS


def gloh(
    field: GradientField,
    xy: FloatArray,
    radius: FloatArray,
    angle: FloatArray,
    harmonics: int = 2,
    step: float = 0.125,
    soft: bool = True,
) -> F32:
    """Return how gradients are directed in the cells around each point, not normalised.

    Parameters
    ----------
    field : the gradients
    xy : (N, 2) points in pixels of the field
    radius : (N,) of the descriptors in pixels of the field
    angle : (N,) radians; cells and directions are relative to it
    harmonics : Fourier harmonics of the directions of a cell, 0 to 3; 4 gives histograms of eight directions instead
    step : distance of the samples relative to the radius
    soft : share each sample between neighbouring cells instead of giving it to one

    Returns
    -------
    (N, 17 * (1 + 2 * harmonics)) float32
        For each cell the sum of the gradients' lengths, and their cosine and sine of each harmonic, cells running
        fastest; with 4 harmonics (N, 136), the cells of each of eight directions in turn.

    Notes
    -----
    A central disc and two rings of eight sectors (radii 0.25, 0.73 and 1): GLOH's 17 cells. Samples lie on a square
    grid that turns with the point and read the nearest pixel of the field; what lies outside the field counts as no
    gradient. Harmonics are weighted as in a histogram in which a direction is shared by the two nearest of eight bins:
    distances are those of such histograms without their finest detail, which is mostly speckle.
    """
    pattern = _log_polar(step, soft)
    if harmonics >= HARMONICS:
        return _pooled(field, xy, radius, angle, pattern, DIRECTIONS)
    return _harmonics(field, xy, radius, angle, pattern, harmonics)


def row_length(harmonics: int) -> int:
    """Numbers of `gloh` for one point."""
    return LENGTH if harmonics >= HARMONICS else CELLS * (1 + 2 * harmonics)


def normalised(rows: F32, root: bool = False) -> F32:
    """Return rows of `gloh` as unit vectors in which no edge decides alone; empty ones stay 0.

    Components of histograms are clipped at 0.2, cells of harmonics at a length of 0.3, and the rows brought to unit
    length again. `root` instead takes the root of each component's share (R. Arandjelovic, A. Zisserman, CVPR 2012,
    DOI 10.1109/CVPR.2012.6248018), or of each cell's, which makes the Euclidean distance one of distributions.
    """
    if rows.shape[1] == LENGTH:
        if root:
            total = rows.sum(axis=1, keepdims=True)
            return np.asarray(np.sqrt(rows / np.where(total > 0, total, 1)), np.float32)
        return unit_length(np.minimum(unit_length(rows), np.float32(CLIP)))
    if root:
        unit = unit_length(rows)
        length = unit[:, :CELLS]
        return unit_length(unit * np.tile(1 / np.sqrt(np.where(length > 0, length, 1)), rows.shape[1] // CELLS))
    from featreg.sar.keypoints import unit_kernels

    out = np.empty(rows.shape, np.float32)
    unit_kernels.unit_cells(np.ascontiguousarray(rows), CELLS, np.float32(CELL_CLIP), out)
    return out


def described(image: Image, features: Features, descriptors: F32) -> Features:
    """Return the features with (N, D) unit descriptors, less those outside the valid pixels or without any gradient."""
    x, y = np.rint(features.xy).astype(np.int64).T
    height, width = image.shape
    kept = (x >= 0) & (y >= 0) & (x < width) & (y < height) & descriptors.any(axis=1)
    kept[kept] = image.mask[y[kept], x[kept]]
    index = np.flatnonzero(kept)
    return replace(features.take(index), descriptors=descriptors[index], norm="l2", index=index)


def unit_length(rows: F32) -> F32:
    """Return rows divided by their lengths; empty ones stay 0."""
    length = np.sqrt(np.einsum("ij,ij->i", rows, rows))
    return np.asarray(rows / np.where(length > 0, length, 1)[:, None], np.float32)


@dataclass(frozen=True, eq=False)
class _Pattern:
    """`samples` (2, S) in the unit disc, the `piece` (S,) each belongs to, `shares` (P, cells) of pieces in cells."""

    samples: F32
    piece: I64
    shares: F32

    @cached_property
    def nearest(self) -> tuple[I64, F32]:
        """(S, 4) cells in which each sample counts, and its shares in them; 0 where there are fewer."""
        shares = self.shares[self.piece]
        cell = np.argsort(-shares, axis=1, kind="stable")[:, :4]
        share = np.take_along_axis(shares, cell, axis=1)
        room = ((0, 0), (0, 4 - cell.shape[1]))
        return np.pad(cell, room), np.pad(share, room)

    @cached_property
    def weight(self) -> F32:
        """(S,) the share of each sample in the first cell."""
        return np.ascontiguousarray(self.shares[self.piece, 0])


def _pooled(
    field: GradientField, xy: FloatArray, radius: FloatArray, angle: FloatArray, pattern: _Pattern, bins: int
) -> F32:
    """(N, bins * cells): every sample shared out to two bins and its cells."""
    from featreg.sar.keypoints import histogram_kernels

    height, width = field.x.shape
    gx, gy = (np.ascontiguousarray(part).ravel() for part in (field.x, field.y))
    out = np.empty((len(xy), bins, pattern.shares.shape[1]), np.float32)
    xy, radius, angle = (np.ascontiguousarray(values, np.float64) for values in (xy, radius, angle))
    cell, share = pattern.nearest
    histogram_kernels.pool(gx, gy, width, height, xy, radius, angle, pattern.samples, cell, share, out)
    return out.reshape(len(xy), out.shape[1] * out.shape[2])


def _harmonics(
    field: GradientField, xy: FloatArray, radius: FloatArray, angle: FloatArray, pattern: _Pattern, count: int
) -> F32:
    """(N, (1 + 2 * count) * cells): the harmonics of every sample, shared out to the cells."""
    from featreg.sar.keypoints import histogram_kernels

    height, width = field.x.shape
    gx, gy = (np.ascontiguousarray(part).ravel() for part in (field.x, field.y))
    out = np.empty((len(xy), 1 + 2 * count, pattern.shares.shape[1]), np.float32)
    xy, radius, angle = (np.ascontiguousarray(values, np.float64) for values in (xy, radius, angle))
    cell, share = pattern.nearest
    order = along_rows(xy, width)
    histogram_kernels.harmonics(gx, gy, width, height, order, xy, radius, angle, pattern.samples, cell, share, out)
    out *= harmonic_weights(count)[:, None]
    return out.reshape(len(xy), out.shape[1] * out.shape[2])


def harmonic_weights(count: int) -> F32:
    """Return (1 + 2 * count,) what length, cosine and sine of each harmonic are multiplied by; see `gloh`."""
    k = np.arange(count + 1)
    weight = np.sinc(k / DIRECTIONS) ** 2 * np.sqrt(np.where(k > 0, 2, 1) / DIRECTIONS)
    return np.repeat(weight, 2)[1:].astype(np.float32)


def along_rows(xy: FloatArray, width: int) -> I64:
    """Return the order of points (N, 2) along the rows of a field, so that neighbours read what is in the cache."""
    return np.argsort(np.floor(xy[:, 1] / BAND) * width + xy[:, 0], kind="stable")


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
