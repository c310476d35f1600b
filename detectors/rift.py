"""Corner and edge points of phase congruency, RIFT's detector."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from annotated_types import Interval

from featreg.interfaces import Detector
from featreg.registry import register
from featreg.runtime.parameters import Count, Positive
from featreg.sar.gradients.log_gabor import Bandwidth, LogGabor, MinWavelength, Multiplier, Orientations, Scales
from featreg.sar.gradients.phase_congruency import Congruency, Noise, View, bytes_of, congruency_maps, without_rim
from featreg.sar.keypoints.corners import fast_corners, orientation, refine_centroid
from featreg.sar.pyramid import SUPPORT, clear
from featreg.types import Features, FloatArray, Image, IntArray, Searched

ORIENTATION_RADIUS = 15


@register("phase-congruency")
@dataclass(frozen=True)
class PhaseCongruency(Detector):
    """FAST corners of the two principal moments of phase congruency: corner points and edge points.

    Parameters
    ----------
    n_features : at most so many keypoints
    corner_share : share of them taken from the minimum moment (corners), the rest from the maximum moment (edges);
        what one cannot fill goes to the other
    threshold : least FAST score on a map quantised to 0..255
    support : radius in pixels that must be free of nodata, of a black rim and of the image border
    subpixel : "centroid" (iterated centroid of the moment around the point) or "none"
    sigma : standard deviation in pixels of the Gaussian weight of the 7 x 7 sub-pixel neighbourhood
    scales, orientations : number of log-Gabor filters
    min_wavelength : of the finest scale, px
    multiplier : ratio of the wavelengths of two neighbouring scales
    bandwidth : of a filter, see `featreg.sar.gradients.log_gabor.LogGabor`
    noise : standard deviations above the mean noise energy that counts as structure
    floor : added to the sum of amplitudes, see `featreg.sar.gradients.phase_congruency`
    view : "soft-log" or "amplitude", what is filtered
    exact : take the noise of each orientation from all pixels, as Kovesi has it, instead of one for all from some, and
        quantise a moment by its greatest value, instead of the 99th percentile of some

    Notes
    -----
    J. Li, Q. Hu, M. Ai, "RIFT: multi-modal image matching based on radiation-variation insensitive feature transform",
    IEEE TIP 29 (2020) 3296, DOI 10.1109/TIP.2019.2959244, Eq. 1 to 10. Departures: the edge points are FAST corners of
    the maximum moment, as in the authors' program; scales, orientations, wavelengths, bandwidth, noise, floor and view
    are those that find SAR corners again (`featreg.sar.gradients.phase_congruency` says why; the preset rift-paper
    holds the paper's): two very broad filters at 6 and 18 px in four directions, a third of the paper's transforms, are
    short both across an edge and along it: the error of matches of two dates is 0.73 px, where narrower filters at 4
    and 12 px in six directions leave 0.77; positions are sub-pixel, without which it is 0.82 px; the angle, towards the
    centroid of the edge map, does not depend on how a sensor maps brightness.
    """

    n_features: Count = 5000
    corner_share: Annotated[float, Interval(ge=0, le=1)] = 0.5
    threshold: Annotated[int, Interval(ge=0, le=254)] = 5
    support: Annotated[float, Interval(ge=3, le=1000)] = SUPPORT
    subpixel: Literal["centroid", "none"] = "centroid"
    sigma: Annotated[float, Interval(gt=0, lt=100)] = 0.8
    scales: Scales = 2
    orientations: Orientations = 4
    min_wavelength: MinWavelength = 6.0
    multiplier: Multiplier = 3.0
    bandwidth: Bandwidth = 0.35
    noise: Noise = 0.0
    floor: Positive = 0.1
    view: View = "soft-log"
    exact: bool = False

    def _settings(self) -> tuple[LogGabor, Congruency]:
        bank = LogGabor(self.scales, self.orientations, self.min_wavelength, self.multiplier, self.bandwidth)
        return bank, Congruency(self.noise, self.floor, self.view, exact=self.exact)

    @property
    def reach(self) -> float:
        """The support, and the coarsest filter around it."""
        return self.support + self._settings()[0].wavelength(self.scales - 1)

    def searched(self, image: Image) -> Searched:
        return Searched(radii=(self.support,))

    def detect_features(self, image: Image) -> Features:
        largest, smallest, _, valid = congruency_maps(image, *self._settings())
        allowed = clear(without_rim(image), self.support)
        if not allowed.any():
            return Features.empty()
        most = 1.0 if self.exact else 0.99
        maps = [bytes_of(moment, valid, most, whole=self.exact) for moment in (smallest, largest)]
        found = [fast_corners(moment, self.threshold, allowed, self.n_features) for moment in maps]
        corners, edges = (len(score) for _, score in found)
        first = min(corners, max(round(self.corner_share * self.n_features), self.n_features - edges))
        parts = []
        for moment, (xy, score), count in zip(maps, found, (first, self.n_features - first), strict=True):
            at = xy[:count]
            parts.append(
                Features(
                    xy=self._position(moment, at),
                    scale=self.support,  # one number stands for all rows
                    angle=orientation(largest, at, ORIENTATION_RADIUS),
                    score=score[:count].astype(np.float64),
                    level=np.zeros(len(at), np.int64),
                )
            )
        everything = Features.concatenate(parts)
        return everything.take(np.argsort(-everything.score, kind="stable"))

    def _position(self, moment: np.ndarray[tuple[int, ...], np.dtype[np.uint8]], at: IntArray) -> FloatArray:
        if self.subpixel == "none":
            return at.astype(np.float64)
        return refine_centroid(moment, at, self.sigma)[0]
