"""The maximum index map around keypoints, RIFT's descriptor, with RIFT2's way to rotation invariance."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from featreg.errors import ParameterError
from featreg.interfaces import Descriptor
from featreg.registry import register
from featreg.runtime.parameters import Positive, Share
from featreg.sar.gradients.log_gabor import Bandwidth, LogGabor, MinWavelength, Multiplier, Orientations, Scales
from featreg.sar.gradients.phase_congruency import Congruency, Noise, View
from featreg.sar.keypoints.index_map import Cells, cell_list, level_bits, places_of, turned_histograms, turned_triples
from featreg.types import Features, FloatArray, Image

F32 = NDArray[np.float32]

# Points described at a time; their numbers stay in the processor's cache.
BLOCK = 256


@register("max-index-map")
@dataclass(frozen=True)
class MaxIndexMap(Descriptor):
    """How strong edges are around the keypoint, and which orientation's log-Gabor response is the largest.

    Parameters
    ----------
    patch : side of the square that is described, px
    grid : cells along each side of it
    soft : packed bits of each cell's mean vote and its first harmonic over the orientations; False gives unit vectors
        of histograms of whole indices
    levels : so many of each number are told apart in soft cells
    weighted : a vote weighs as much as the edge map is strong there; False counts all pixels alike
    power : to which the votes of a cell are raised; 0.5 keeps a few strong ones from deciding
    centred : subtract what the whole image would have there
    least : share of the cells that must lie on data
    reindex : "angle" turns the orientations by the keypoint's angle, "dominant" makes the patch's most frequent one
        the first (RIFT2), "none" leaves them
    scales, orientations : number of log-Gabor filters; a histogram has as many bins as orientations
    min_wavelength : of the finest scale, px
    multiplier : ratio of the wavelengths of two neighbouring scales
    bandwidth : of a filter, see `featreg.sar.gradients.log_gabor.LogGabor`
    noise : standard deviations above the mean noise energy that counts as structure
    floor : added to the sum of amplitudes, see `featreg.sar.gradients.phase_congruency`
    view : "soft-log" or "amplitude", what is filtered
    exact : take the noise of each orientation from all pixels, as Kovesi has it, instead of one for all from some

    Notes
    -----
    J. Li, Q. Hu, M. Ai, "RIFT: multi-modal image matching based on radiation-variation insensitive feature transform",
    IEEE TIP 29 (2020) 3296, DOI 10.1109/TIP.2019.2959244, section III-B; J. Li, P. Shi, Q. Hu, Y. Zhang, "RIFT2:
    speeding-up RIFT with a new rotation-invariance technique", arXiv 2303.00319. The maps are shared with the detector
    where their parameters are equal.

    Departures, the paper's form behind a parameter. Many small cells tell neighbouring points apart better than few
    detailed ones: 13 x 13 of 5 px with three numbers each (`featreg.sar.keypoints.index_map`) instead of 6 x 6 of 16 px
    with a histogram of six bins. In five levels of equal probability these match nearly as well as the numbers
    themselves, at a quarter of the time, since differing bits are counted instead of products summed. Votes are
    weighted by the edge map, because where there is no edge the index is noise. The index has a fraction
    (`featreg.sar.gradients.phase_congruency`), so that it turns by any angle; cells stay upright squares, whose centres
    turn with the keypoint, to every second pixel. Cells off the image, on nodata or on a black rim are left out as if
    they were average, so that points near a border need not be dropped and the shape of the border does not look like
    content; a point with too few cells left is dropped.
    """

    patch: Annotated[float, Interval(ge=3, le=1000)] = 63.0
    grid: Annotated[int, Interval(ge=1, le=32)] = 13
    soft: bool = True
    levels: Annotated[int, Interval(ge=2, le=16)] = 5
    weighted: bool = True
    power: Annotated[float, Interval(gt=0, le=2)] = 0.5
    centred: bool = True
    least: Share = 0.6
    reindex: Literal["angle", "dominant", "none"] = "angle"
    scales: Scales = 2
    orientations: Orientations = 4
    min_wavelength: MinWavelength = 6.0
    multiplier: Multiplier = 3.0
    bandwidth: Bandwidth = 0.35
    noise: Noise = 0.0
    floor: Positive = 0.1
    view: View = "soft-log"
    exact: bool = False

    def __post_init__(self) -> None:
        if self.patch < 3 * self.grid:
            raise ParameterError(f"max-index-map needs patch >= 3 * grid, got {self.patch} and {self.grid}")

    def _settings(self) -> tuple[LogGabor, Congruency]:
        bank = LogGabor(self.scales, self.orientations, self.min_wavelength, self.multiplier, self.bandwidth)
        return bank, Congruency(self.noise, self.floor, self.view, exact=self.exact)

    def reach_of(self, scale: float) -> float:
        """Half the diagonal of the patch, which may be turned, and the coarsest filter at its corner."""
        return self.patch / math.sqrt(2) + self._settings()[0].wavelength(self.scales - 1)

    def describe_features(self, image: Image, features: Features) -> Features:
        cells = Cells(self.patch / self.grid, self.soft, self.weighted, self.power, self.centred)
        listed = cell_list(image, *self._settings(), cells)
        described: list[Any] = []
        indices = []
        for start in range(0, max(len(features), 1), BLOCK):
            block = slice(start, start + BLOCK)
            angle = features.angle[block]
            place = places_of(cells, image.shape, features.xy[block], angle, self.grid)
            values, known = self._turned(listed, place, angle)
            kept = np.flatnonzero(known >= self.least)
            if len(kept) < len(known):
                values, known = values[kept], known[kept]
            described.append(level_bits(values, known, self.levels) if self.soft else _unit(values))
            indices.append(start + kept)
        index = np.concatenate(indices)
        norm = "hamming" if self.soft else "l2"
        return replace(features.take(index), descriptors=np.concatenate(described), norm=norm, index=index)

    def _turned(self, listed: F32, place: NDArray[np.int32], angle: FloatArray) -> tuple[F32, F32]:
        """(N, ...) cells, their orientations turned, and the (N,) share of known ones."""
        turn = angle if self.reindex == "angle" else np.zeros(len(angle))
        if not self.soft:
            bins = None if self.reindex == "dominant" else turn * self.orientations / math.pi
            return turned_histograms(listed, place, bins)
        triples, known = turned_triples(listed, place, turn)
        if self.reindex == "dominant":
            _, even, odd = triples.sum(axis=2, dtype=np.float64).T
            triples, known = turned_triples(listed, place, -np.arctan2(odd, even) / 2)
        return triples, known


def _unit(values: F32) -> F32:
    rows = values.reshape(len(values), math.prod(values.shape[1:]))
    length = np.sqrt(np.einsum("ij,ij->i", rows, rows))
    return np.asarray(rows / np.maximum(length, np.float32(1e-12))[:, None], np.float32)
