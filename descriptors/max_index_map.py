"""Histograms of the maximum index map, RIFT's descriptor, with RIFT2's way to rotation invariance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from featreg.errors import ParameterError
from featreg.interfaces import Descriptor
from featreg.registry import register
from featreg.sar.log_gabor import LogGabor
from featreg.sar.phase_congruency import STEPS, Congruency, bytes_of, congruency_maps
from featreg.types import Features, FloatArray, Image, IntArray

F32 = NDArray[np.float32]

# Directions to which the grid of a keypoint's own angle is rounded.
TURNS = 72
# A vote is shared out between two indices in so many parts.
PARTS = 16
# Beside nodata the filters see what was filled in.
MARGIN = 6
# A cell with a smaller share of valid pixels says nothing.
LEAST_OF_CELL = 0.5


@register("max-index-map")
@dataclass(frozen=True)
class MaxIndexMap(Descriptor):
    """Histograms, on a grid around the keypoint, of which orientation's log-Gabor response is the largest.

    Parameters
    ----------
    patch : side of the square that is described, px
    grid : cells along each side of it
    soft : share each vote out between the two nearest indices; False counts the nearest alone
    weighted : a vote weighs as much as the edge map is strong there; False counts all pixels alike
    power : to which the counts are raised; 0.5 keeps a few strong cells from deciding
    centred : subtract what the histogram of the whole image would have there
    least : share of the cells that must lie on data
    reindex : "angle" turns the indices by the keypoint's angle, "dominant" makes the patch's most frequent index the
        first one (RIFT2), "none" leaves them
    scales, orientations : number of log-Gabor filters; the bins of a histogram are the orientations
    min_wavelength : of the finest scale, px
    multiplier : ratio of the wavelengths of two neighbouring scales
    bandwidth : of a filter, see `featreg.sar.log_gabor.LogGabor`
    noise : standard deviations above the mean noise energy that counts as structure
    floor : added to the sum of amplitudes, see `featreg.sar.phase_congruency`
    view : "soft-log" or "amplitude", what is filtered

    Notes
    -----
    J. Li, Q. Hu, M. Ai, "RIFT: multi-modal image matching based on radiation-variation insensitive feature transform",
    IEEE TIP 29 (2020) 3296, DOI 10.1109/TIP.2019.2959244, section III-B; J. Li, P. Shi, Q. Hu, Y. Zhang, "RIFT2:
    speeding-up RIFT with a new rotation-invariance technique", arXiv 2303.00319. The maps are shared with the detector
    where their parameters are equal.

    Departures, the paper's form behind a parameter: smaller cells (9 instead of 16 px), whose histograms tell
    neighbouring points apart; votes weighted by the edge map, because where there is no edge the index is noise; shared
    out and compressed votes; an index with a fraction, which turns by any angle instead of whole indices (see
    `featreg.sar.phase_congruency`). Cells stay upright squares, whose centres turn with the keypoint, read to even
    pixels from a summed-area table. Cells off the image, on nodata or on a black rim are left out as if they were
    average, so that points near a border need not be dropped and the shape of the border does not look like content; a
    point with too few cells left is dropped.
    """

    patch: float = 63.0
    grid: int = 7
    soft: bool = True
    weighted: bool = True
    power: float = 0.5
    centred: bool = True
    least: float = 0.6
    reindex: str = "angle"
    scales: int = 2
    orientations: int = 6
    min_wavelength: float = 4.0
    multiplier: float = 3.0
    bandwidth: float = 0.5
    noise: float = 0.0
    floor: float = 0.1
    view: str = "soft-log"

    def __post_init__(self) -> None:
        self._settings()
        if not (1 <= self.grid <= 32 and 3 * self.grid <= self.patch <= 1000):
            raise ParameterError(
                f"max-index-map needs 1 <= grid <= 32 and 3 * grid <= patch <= 1000, got {self.grid} and {self.patch}"
            )
        if not (0 < self.power <= 2 and 0 < self.least <= 1):
            raise ParameterError(
                f"max-index-map needs 0 < power <= 2 and 0 < least <= 1, got {self.power} and {self.least}"
            )
        if self.reindex not in ("angle", "dominant", "none"):
            raise ParameterError(f"max-index-map needs reindex 'angle', 'dominant' or 'none', got '{self.reindex}'")

    def _settings(self) -> tuple[LogGabor, Congruency]:
        bank = LogGabor(self.scales, self.orientations, self.min_wavelength, self.multiplier, self.bandwidth)
        return bank, Congruency(self.noise, self.floor, self.view)

    def reach_of(self, scale: float) -> float:
        """Half the diagonal of the patch, which may be turned, and the coarsest filter at its corner."""
        return self.patch / math.sqrt(2) + self._settings()[0].wavelength(self.scales - 1)

    def describe_features(self, image: Image, features: Features) -> Features:
        angle = features.angle
        # One direction for all: the votes themselves are turned, exactly, rather than the finished histograms.
        common = bool(len(features)) and bool((angle == angle[0]).all())
        turned = float(angle[0]) if common and self.reindex == "angle" else 0.0
        bank, congruency = self._settings()
        sums, mean = image.derive(
            index_table, bank=bank, congruency=congruency, soft=self.soft, weighted=self.weighted, turned=turned
        )
        counts, seen = self._pool(sums, features.xy, angle, common=common)
        known = seen >= LEAST_OF_CELL
        index = np.flatnonzero(known.mean(axis=1) >= self.least)
        counts, known = counts[index], known[index]
        average = np.broadcast_to(mean, (len(index), 1, len(mean)))
        shift = self._shift(counts, angle[index]) if not (common and self.reindex == "angle") else None
        if shift is not None:
            counts, average = _rolled(counts, shift), _rolled(average, shift)
        counts = counts ** np.float32(self.power)
        if self.centred:
            counts -= average ** np.float32(self.power)
        counts *= known[:, :, None]
        flat = counts.reshape(len(index), self.grid**2 * self.orientations)
        flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), np.float32(1e-12))
        chosen = features.take(index)
        described = np.ascontiguousarray(flat, np.float32)
        return Features(chosen.xy, chosen.scale, chosen.angle, chosen.score, chosen.level, described, "l2", index)

    def _pool(self, sums: NDArray[np.int32], xy: FloatArray, angle: FloatArray, *, common: bool) -> tuple[F32, F32]:
        """Mean votes per pixel (N, cells, orientations) and share of valid pixels (N, cells)."""
        from featreg.sar import index_map_kernels

        step = self.patch / self.grid
        half = round((step - 1) / 2)
        along = (np.arange(self.grid) - (self.grid - 1) / 2) * step
        centres = np.stack(np.meshgrid(along, along), -1).reshape(-1, 2)
        if common:
            angles, turns = [float(angle[0])], np.zeros(len(angle), np.int64)
        else:
            angles = [2 * math.pi * turn / TURNS for turn in range(TURNS)]
            turns = np.rint(angle * TURNS / (2 * math.pi)).astype(np.int64) % TURNS
        # x to the right, y down: counter-clockwise as seen is (cos, sin; -sin, cos).
        matrices = [np.array([[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]]) for a in angles]
        cells = np.rint(np.stack([centres @ m for m in matrices])).astype(np.int64)
        xs, ys = np.ascontiguousarray(np.rint(xy).astype(np.int64).T)
        out = np.empty((len(xy), len(centres), sums.shape[2]), np.float32)
        # From top to bottom, so that the rows in use stay in the cache.
        order = np.argsort(ys, kind="stable")
        index_map_kernels.pooled(sums, xs, ys, cells, turns, order, half, out)
        bins = self.orientations
        votes, pixels = out[:, :, :bins], out[:, :, bins : bins + 1]
        share = pixels[:, :, 0] / np.float32((2 * half + 1) ** 2)
        return np.asarray(votes / np.maximum(pixels, 1), np.float32), np.asarray(share, np.float32)

    def _shift(self, counts: F32, angle: FloatArray) -> FloatArray | None:
        """By how many indices each point's histograms are turned."""
        if self.reindex == "angle":
            return np.asarray(angle * self.orientations / math.pi)
        if self.reindex == "dominant":
            return np.asarray(-counts.sum(axis=1).argmax(axis=1).astype(np.float64))
        return None


def index_table(
    image: Image, bank: LogGabor, congruency: Congruency, soft: bool, weighted: bool, turned: float
) -> tuple[NDArray[np.int32], F32]:
    """Return the (rows, columns, lanes) summed votes, and the (orientations,) mean of a valid pixel.

    A row and a column for every second pixel and one before the first. Lanes are the orientations, the number of valid
    pixels, and zeros up to a multiple of eight.
    """
    import cv2

    from featreg.sar import index_map_kernels

    largest, _, index, valid = congruency_maps(image, bank, congruency)
    seen = valid.view(np.uint8)
    if not valid.all():
        square = np.ones((2 * MARGIN + 1, 2 * MARGIN + 1), np.uint8)
        seen = np.asarray(cv2.erode(seen, square, borderType=cv2.BORDER_CONSTANT, borderValue=1), np.uint8)
    weight = np.maximum(bytes_of(largest, valid, 0.95), 1) * seen if weighted else seen
    votes = _votes(bank.orientations, turned * bank.orientations / math.pi, soft=soft)
    height, width = ((n + 1) // 2 + 1 for n in image.shape)
    sums = np.empty((height, width, votes.shape[1]), np.int32)
    index_map_kernels.index_sums(index, weight, votes, bank.orientations, sums)
    # Of every third pixel along both axes.
    some = weight[::3, ::3].ravel()
    weights = np.bincount(index[::3, ::3].ravel(), weights=some, minlength=STEPS)
    mean = weights @ votes[:, : bank.orientations] / max(int(np.count_nonzero(some)), 1)
    return sums, mean.astype(np.float32)


def _votes(orientations: int, shift: float, *, soft: bool) -> NDArray[np.int32]:
    """How each step of the index, turned by `shift` indices, is shared out: (240, lanes)."""
    value = (np.arange(STEPS) * orientations / STEPS + shift) % orientations
    low = np.floor(value).astype(np.int64)
    part = np.rint((value - low) * PARTS).astype(np.int32)
    if not soft:
        part = np.where(part * 2 >= PARTS, PARTS, 0).astype(np.int32)
    votes = np.zeros((STEPS, (orientations + 8) // 8 * 8), np.int32)
    rows = np.arange(STEPS)
    votes[rows, low % orientations] += PARTS - part
    votes[rows, (low + 1) % orientations] += part
    return votes


def _rolled(counts: F32, shift: FloatArray) -> F32:
    """(N, cells, orientations) histograms turned cyclically by (N,) indices, fractions by linear interpolation."""
    bins = counts.shape[2]
    low: IntArray = np.floor(shift).astype(np.int64)
    part = (shift - low).astype(np.float32)[:, None, None]
    source = ((np.arange(bins) - low[:, None]) % bins)[:, None, :]
    one = np.take_along_axis(counts, source, axis=2)
    two = np.take_along_axis(counts, (source - 1) % bins, axis=2)
    return np.asarray((1 - part) * one + part * two, np.float32)
