"""BFSIFT: SIFT's extrema of differences in a bilateral scale space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from featreg.errors import ParameterError
from featreg.interfaces import Detector
from featreg.registry import register
from featreg.sar.bilateral import BilateralSpace, bilateral_field, bilateral_levels
from featreg.sar.gradient_histograms import dominant_orientation
from featreg.sar.maxima import local_maxima, quadratic_peak
from featreg.sar.pyramid import clear, pyramid, share_out, to_base
from featreg.types import BoolArray, Features, FloatArray, Image

F32 = NDArray[np.float32]
Found = tuple[FloatArray, FloatArray]


@register("bf-sift")
@dataclass(frozen=True)
class BfSift(Detector):
    """Extrema, in space and scale, of the differences between neighbouring levels of a bilateral scale space.

    Parameters
    ----------
    n_features : at most so many keypoints, shared out over the scales
    octaves, intervals : halvings of the image, and scales that are searched in each
    sigma : spatial standard deviation in pixels of the first level of an octave
    tone : standard deviation of the bilateral weight of a difference, in units of the image's speckle noise
    exact : every level a bilateral filter of the octave's image, instead of the fast cascade of small filters
    threshold : least difference of log-amplitude
    quota_decay : a scale gets `quota_decay` times fewer keypoints than the finer one before it
    support : radius, in units of the scale's sigma, from which a keypoint is described; it must be free of nodata

    Notes
    -----
    S. Wang, H. You, K. Fu, "BFSIFT: a novel method to find feature matches for SAR image registration", IEEE Geosci.
    Remote Sens. Lett. 9 (2012) 649, DOI 10.1109/LGRS.2011.2177437: SIFT in an anisotropic scale space, made with
    bilateral instead of Gaussian filters. The scale space of D. Lowe, IJCV 60 (2004) 91,
    DOI 10.1023/B:VISI.0000029664.99615.94, else: intervals + 3 levels an octave, extrema among 26 neighbours.

    Departures. The filter works on the logarithm of the amplitude, in which speckle is additive, and its range is
    measured in units of the noise, since a filter that keeps every step above the noise keeps single-look speckle. The
    default cascade (see `featreg.sar.bilateral`) is fast and not the same filter; `exact` is the paper's. The paper
    skips the finest scales; here a budget favours them, as their keypoints are placed best. Octaves are halvings of the
    amplitude, not of the smoothed image. The position is that of a quadratic surface in space; the scale stays that of
    the level. No contrast or edge test: the budget keeps the strongest. One orientation a point.
    """

    n_features: int = 5000
    octaves: int = 2
    intervals: int = 3
    sigma: float = 1.2
    tone: float = 5.0
    exact: bool = False
    threshold: float = 0.04
    quota_decay: float = 2.0
    support: float = 8.0

    def __post_init__(self) -> None:
        if min(self.n_features, self.octaves, self.intervals) < 1 or not self.quota_decay >= 1:
            raise ParameterError(
                "bf-sift needs n_features, octaves, intervals and quota_decay >= 1, got "
                f"{self.n_features}, {self.octaves}, {self.intervals} and {self.quota_decay}"
            )
        if not (self.sigma > 0 and self.tone > 0 and self.support > 0 and self.threshold >= 0):
            raise ParameterError(
                "bf-sift needs sigma, tone and support > 0 and threshold >= 0, got "
                f"{self.sigma}, {self.tone}, {self.support} and {self.threshold}"
            )

    @property
    def reach(self) -> float:
        """The radius of the coarsest scale of the last octave."""
        return self.support * self._space().sigma_of(self.intervals) * 2.0 ** (self.octaves - 1)

    def detect_features(self, image: Image) -> Features:
        chain = pyramid(image, self.octaves, 2.0)
        found = [part for level in chain for part in self._octave(level)]
        counts = share_out(self.n_features, [len(score) for _, score in found], self.quota_decay)
        parts = []
        for number, ((at, score), count) in enumerate(zip(found, counts, strict=True)):
            octave, interval = divmod(number, self.intervals)
            level, xy = chain[octave], at[:count]
            field = bilateral_field(level, self._space(), interval + 1)
            sigma = self._space().sigma_of(interval + 1)
            parts.append(
                Features(
                    xy=to_base(xy, level, image),
                    scale=np.full(len(xy), self.support * sigma * image.shape[1] / level.shape[1]),
                    angle=dominant_orientation(field, xy, np.full(len(xy), 0.5 * self.support * sigma)),
                    score=score[:count],
                    level=np.full(len(xy), number),
                )
            )
        everything = Features.concatenate(parts)
        return everything.take(np.argsort(-everything.score, kind="stable"))

    def _space(self) -> BilateralSpace:
        return BilateralSpace(self.intervals, float(self.sigma), float(self.tone), self.exact)

    def _octave(self, level: Image) -> list[Found]:
        """Position in pixels of the level and strength of the extrema of each interval, the strongest first."""
        import cv2

        smooth = bilateral_levels(level, self._space())
        differences = smooth[1:] - smooth[:-1]
        around = np.ones((3, 3), np.uint8)
        found = []
        for sign in (1, -1):
            tops = [cv2.dilate(sign * difference, around) for difference in differences]
            for k in range(1, self.intervals + 1):
                here = sign * differences[k]
                free = clear(level, self.support * self._space().sigma_of(k))
                found.append(self._peaks(here, free & (here >= tops[k - 1]) & (here >= tops[k + 1])))
        return [_merged(*pair) for pair in zip(found[: self.intervals], found[self.intervals :], strict=True)]

    def _peaks(self, difference: F32, allowed: BoolArray) -> Found:
        at = local_maxima(difference, allowed, self.threshold, self.n_features)
        return quadratic_peak(difference, at), difference[at[:, 1], at[:, 0]].astype(np.float64)


def _merged(first: Found, second: Found) -> Found:
    """Both sets, the strongest first."""
    xy, score = (np.concatenate(pair) for pair in zip(first, second, strict=True))
    order = np.argsort(-score, kind="stable")
    return xy[order], score[order]
