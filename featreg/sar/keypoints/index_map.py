"""Cells of the maximum index map: which orientations, and how strong edges, lie around every second pixel.

Notes
-----
With the index phi, a direction over half a turn, and the weight w of a pixel, a cell is the triple (sum w,
sum w cos 2 phi, sum w sin 2 phi), a mean vote and its first harmonic over the orientations, or a histogram of whole
indices. A triple turns by any angle exactly.

References
----------
J. Li, Q. Hu, M. Ai, "RIFT: multi-modal image matching based on radiation-variation insensitive feature transform",
IEEE TIP 29 (2020) 3296, DOI 10.1109/TIP.2019.2959244, section III-B.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from featreg.sar.gradients.log_gabor import LogGabor
from featreg.sar.gradients.phase_congruency import STEPS, Congruency, bytes_of, congruency_maps
from featreg.sar.pyramid import whole_squares
from featreg.types import FloatArray, Image, IntArray

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]
U8 = NDArray[np.uint8]

# Beside nodata the filters see what was filled in.
MARGIN = 6
# A cell with a smaller share of valid pixels says nothing.
LEAST_OF_CELL = 0.5
# Rows of cells made at a time.
STRIP = 128
# No mean vote is divided by less, a hundredth of the weakest that there is.
LEAST_VOTE = 1e-2


@dataclass(frozen=True)
class Cells:
    """How votes make cells.

    Parameters
    ----------
    side : of a cell, px
    soft : triples from cells that run into each other; False makes histograms from cells with sharp borders
    weighted : a vote weighs as much as the edge map is strong there; False counts all pixels alike
    power : to which a histogram's counts are raised; a triple is multiplied by its mean raised to one less
    centred : subtract what the whole image would have there
    """

    side: float
    soft: bool = True
    weighted: bool = True
    power: float = 0.5
    centred: bool = True

    @property
    def taps(self) -> tuple[int, ...]:
        """How much each block of 2 x 2 pixels counts along a side: a box, or for soft cells a box and one of half."""
        blocks = self.side / 2
        if not self.soft:
            return (1,) * round(blocks)
        wide = max(1, int(blocks))
        return tuple(np.convolve(np.ones(wide, np.int64), np.ones((wide + 1) // 2, np.int64)).tolist())

    def votes(self, orientations: int) -> F32:
        """What each step of the index adds to a cell: (lanes, 240)."""
        if self.soft:
            turn = 2 * math.pi * np.arange(STEPS) / STEPS
            return np.stack([np.ones(STEPS), np.cos(turn), np.sin(turn)]).astype(np.float32)
        nearest = np.floor(np.arange(STEPS) * orientations / STEPS + 0.5).astype(np.int64) % orientations
        return np.ascontiguousarray(np.eye(orientations, dtype=np.float32)[:, nearest])

    def compressed(self, votes: F32) -> F32:
        """Raise (lanes, ...) mean votes to the power."""
        if not self.soft:
            return np.asarray(votes**self.power, np.float32)
        mean = np.maximum(votes[0], np.float32(LEAST_VOTE))
        return np.asarray(votes * (mean**self.power / mean), np.float32)


def cell_list(image: Image, bank: LogGabor, congruency: Congruency, cells: Cells) -> F32:
    """Return the (rows * columns + 1, lanes + 1) float32 cells around every second pixel, and one that is unknown.

    The lanes, of a mean pixel, are 0 where fewer than half of the pixels are data; the last lane is 0 there and 1
    elsewhere. There are ``(H + 1) // 2`` rows and ``(W + 1) // 2`` columns.
    """
    return image.derive(_cell_list, bank=bank, congruency=congruency, cells=cells)


def places_of(cells: Cells, shape: tuple[int, int], xy: FloatArray, angle: FloatArray, grid: int) -> I32:
    """Return the (N, grid * grid) rows of the list of cells on a grid around each point, which turns with its angle.

    Parameters
    ----------
    cells : whose side is the step of the grid
    shape : (height, width) of the image
    xy : (N, 2) px
    angle : (N,) radians, counter-clockwise as seen
    grid : cells along each side
    """
    from featreg.sar.keypoints import index_map_kernels

    height, width = ((n + 1) // 2 for n in shape)
    along = (np.arange(grid) - (grid - 1) / 2) * cells.side
    across, down = (np.ascontiguousarray(v.ravel(), np.float32) for v in np.meshgrid(along, along))
    place = np.empty((len(xy), grid**2), np.int32)
    # Cells of an even number of blocks lie around the edge between two.
    shift = 0.5 if len(cells.taps) % 2 else -0.5
    index_map_kernels.place_cells(np.ascontiguousarray(xy), angle, across, down, shift, height, width, place)
    return place


def turned_triples(listed: F32, place: I32, angle: FloatArray) -> tuple[F32, F32]:
    """Return (N, 3, cells) triples, turned by each point's angle, and the (N,) share of known cells."""
    from featreg.sar.keypoints import index_map_kernels

    triples = np.empty((len(place), 3, place.shape[1]), np.float32)
    known = np.empty(len(place), np.float32)
    flat = triples.reshape(len(place), 3 * place.shape[1])
    index_map_kernels.gather_turned(listed.ravel(), place, angle, flat, known)
    return triples, known


def turned_histograms(listed: F32, place: I32, shift: FloatArray | None) -> tuple[F32, F32]:
    """Return (N, cells, bins) histograms and the (N,) share of known cells.

    They are turned by (N,) bins, fractions by linear interpolation; None makes the largest bin of each point the first.
    """
    seen = listed[place]
    counts, known = seen[:, :, :-1], np.asarray(seen[:, :, -1].mean(axis=1), np.float32)
    if shift is None:
        shift = -counts.sum(axis=1).argmax(axis=1).astype(np.float64)
    bins = counts.shape[2]
    low: IntArray = np.floor(shift).astype(np.int64)
    part = (shift - low).astype(np.float32)[:, None, None]
    source = ((np.arange(bins) - low[:, None]) % bins)[:, None, :]
    one = np.take_along_axis(counts, source, axis=2)
    two = np.take_along_axis(counts, (source - 1) % bins, axis=2)
    return np.asarray((1 - part) * one + part * two, np.float32), known


def level_bits(triples: F32, known: F32, levels: int) -> U8:
    """Return (N, bytes) packed bits, the number of those that differ being the sum of the differences in levels.

    Each number of a (N, 3, cells) triple is told apart in `levels` that a normal distribution would fill alike, by as
    many bits less one. Means and harmonics have a standard deviation of their own, over the `known` (N,) share.
    """
    from featreg.sar.keypoints import index_map_kernels

    limits = np.array([NormalDist().inv_cdf(k / levels) for k in range(1, levels)], np.float32)
    flat = triples.reshape(len(triples), math.prod(triples.shape[1:]))
    bits = np.empty((len(flat), -(-len(limits) * flat.shape[1] // 8)), np.uint8)
    index_map_kernels.level_bits(flat, known, limits, bits)
    return bits


def _cell_list(image: Image, bank: LogGabor, congruency: Congruency, cells: Cells) -> F32:
    import cv2

    from featreg.sar.keypoints import index_map_kernels

    largest, _, index, valid = congruency_maps(image, bank, congruency)
    seen = valid.view(np.uint8)
    if not valid.all():
        seen = whole_squares(valid, MARGIN, outside=True).view(np.uint8)
    weight = np.maximum(bytes_of(largest, valid, 0.95), 1) * seen if cells.weighted else seen
    votes = cells.votes(bank.orientations)
    average = cells.compressed(_average(index, weight, votes)) if cells.centred else np.zeros(len(votes), np.float32)
    taps = np.array(cells.taps, np.float32)
    least = LEAST_OF_CELL * 4 * taps.sum() ** 2
    height, width = ((n + 1) // 2 for n in image.shape)
    before, after = len(taps) // 2, (len(taps) - 1) // 2
    listed = np.zeros((height * width + 1, len(votes) + 1), np.float32)
    out = listed[:-1].reshape(height, width, -1)
    room = np.empty((len(votes) + 1) * (STRIP + before + after) * width, np.float32)
    for top in range(0, height, STRIP):
        first, bottom = max(top - before, 0), min(top + STRIP, height)
        rows = slice(2 * first, 2 * (bottom + after))
        count = min(bottom + after, height) - first
        blocks = room[: (len(votes) + 1) * count * width].reshape(-1, count, width)
        index_map_kernels.block_votes(index[rows], weight[rows], votes, blocks[:-1])
        index_map_kernels.block_votes(index[rows], seen[rows], np.ones((1, STEPS), np.float32), blocks[-1:])
        for plane in blocks:
            plane[:] = cv2.sepFilter2D(plane, -1, taps, taps, borderType=cv2.BORDER_CONSTANT)
        mine = blocks[:, top - first : bottom - first]
        pixels = mine[-1]
        known = pixels >= least
        lanes = cells.compressed(mine[:-1] / np.maximum(pixels, 1))
        lanes -= average[:, None, None]
        lanes *= known
        out[top:bottom, :, :-1] = np.moveaxis(lanes, 0, -1)
        out[top:bottom, :, -1] = known
    return listed


def _average(index: U8, weight: U8, votes: F32) -> F32:
    """The (lanes,) votes of a mean pixel, from every third along both axes."""
    some = weight[::3, ::3].ravel()
    weights = np.bincount(index[::3, ::3].ravel(), weights=some, minlength=STEPS)
    return np.asarray(votes @ weights / max(int(np.count_nonzero(some)), 1), np.float32)
