"""BFSIFT: SIFT's extrema of differences in a bilateral scale space."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Self

import numpy as np
from annotated_types import Ge, Interval
from numpy.typing import NDArray

from featreg.interfaces import Detector
from featreg.registry import register
from featreg.runtime.parameters import Count, Positive
from featreg.sar.gradients.bilateral import BilateralSpace, bilateral_extrema, bilateral_field, bilateral_level
from featreg.sar.gradients.gradient_field import from_base
from featreg.sar.keypoints.gradient_histograms import dominant_orientation, further_orientations
from featreg.sar.keypoints.maxima import around, quadratic_steps
from featreg.sar.pyramid import clear, level_count, pyramid, share_out, to_base
from featreg.types import Features, FloatArray, Image, IntArray, Searched

F32 = NDArray[np.float32]
Found = tuple[IntArray, FloatArray]
NONE: Found = (np.zeros(0, np.int64), np.zeros(0))

# Pixels of the image for each keypoint asked for, from which on the finer scales of an octave have enough extrema.
PLENTY = 55


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
    thin : leave the coarsest scale of each octave out where the image has at least 55 valid pixels for each keypoint
        asked for, and an octave more than one scale
    skip : so many of the finest scales give no keypoints
    orientation_scale : the orientation is that of gradients whose sigma is so many times that of the keypoint, within
        half of so many times the support
    second : another peak of the histogram of directions of at least this share of the highest makes a further keypoint
        at the same place; 1: none does

    Notes
    -----
    S. Wang, H. You, K. Fu, "BFSIFT: a novel method to find feature matches for SAR image registration", IEEE Geosci.
    Remote Sens. Lett. 9 (2012) 649, DOI 10.1109/LGRS.2011.2177437: SIFT in an anisotropic scale space, made with
    bilateral instead of Gaussian filters. The scale space of D. Lowe, IJCV 60 (2004) 91,
    DOI 10.1023/B:VISI.0000029664.99615.94, else: intervals + 3 levels an octave, extrema among 26 neighbours.

    Departures. The filter works on the logarithm of the amplitude, in which speckle is additive, and its range is
    measured in units of the noise, since a filter that keeps every step above the noise keeps single-look speckle. The
    default cascade (see `featreg.sar.gradients.bilateral`) is fast and not the same filter; `exact` is the paper's.
    Windows of whole pixels, cut at 1.5 sigma, make the steps between levels uneven, so that some intervals hold few
    extrema. The paper skips the finest scale (`skip`); here a budget favours it, as its keypoints lie best. Octaves
    are halvings of the amplitude, not of the smoothed image. The position is that of a quadratic surface in space; the
    scale stays that of the level. No contrast or edge test: the budget keeps the strongest. One orientation a point
    (`second`; 0.8 is SIFT's), from gradients half as coarse again as the point, in which less speckle is left;
    `orientation_scale` 1 is SIFT's.
    Where an image has pixels enough for the budget the coarsest scale of an octave is left out (`thin`): its last level
    takes a third of the time of all, and without it a twentieth more matches are correct, in a fifth more places. The
    smaller of a pair decides for both (`for_pair`): were only one of them thinned, half of the matches would be lost.
    """

    n_features: Count = 5000
    octaves: Count = 2
    intervals: Count = 3
    sigma: Positive = 1.2
    tone: Positive = 5.0
    exact: bool = False
    threshold: Annotated[float, Ge(0)] = 0.04
    quota_decay: Annotated[float, Ge(1)] = 1.6
    support: Positive = 8.0
    thin: bool = True
    skip: Annotated[int, Ge(0)] = 0
    orientation_scale: Positive = 1.5
    second: Annotated[float, Interval(gt=0, le=1)] = 1.0

    @property
    def reach(self) -> float:
        """The radius of the coarsest scale of the last octave."""
        return self.support * self._space().sigma_of(self.intervals) * 2.0 ** (self.octaves - 1)

    def for_pair(self, reference: Image, secondary: Image) -> Self:
        """With all scales where the smaller of the images needs them."""
        return self if self._plenty(reference) == self._plenty(secondary) else replace(self, thin=False)

    def detect_features(self, image: Image) -> Features:
        space = self._space()
        chain = pyramid(image, self.octaves, 2.0)
        most = self._intervals(image)
        found = [self._found(level, k) if k < most else NONE for level in chain for k in range(self.intervals)]
        found[: self.skip] = [NONE] * min(self.skip, len(found))
        counts = share_out(self.n_features, [len(flat) for flat, _ in found], self.quota_decay)
        parts = []
        for number, ((flat, score), count) in enumerate(zip(found, counts, strict=True)):
            octave, interval = divmod(number, self.intervals)
            level = chain[octave]
            if not count:
                continue
            finer, coarser = (bilateral_level(level, space, interval + k) for k in (1, 2))
            xy = to_base(_places(finer, coarser, flat[:count]), level, image)
            scale = self.support * space.sigma_of(interval + 1) * image.shape[1] / level.shape[1]
            rows, angle = self._orientations(image, chain, number, xy, scale)
            parts.append(
                Features(
                    xy=xy[rows],
                    scale=np.full(len(rows), scale),
                    angle=angle,
                    score=score[:count][rows],
                    level=np.full(len(rows), number),
                )
            )
        everything = Features.concatenate(parts)
        return everything.take(np.argsort(-everything.score, kind="stable")[: self.n_features])

    def searched(self, image: Image) -> Searched:
        space, most = self._space(), self._intervals(image)
        kept: list[float] = []
        coarsest: list[float] = []
        for octave in range(level_count(image.shape, self.octaves, 2.0)):
            for k in range(self.intervals):
                radius = self.support * space.sigma_of(k + 1) * 2.0**octave
                if octave * self.intervals + k >= self.skip:
                    (kept if k < most else coarsest).append(radius)
        return Searched(radii=tuple(kept), left_out={"thin": tuple(coarsest)} if coarsest else {})

    def _intervals(self, image: Image) -> int:
        """How many of the scales of an octave are looked at."""
        return max(1, self.intervals - 1) if self.thin and self._plenty(image) else self.intervals

    def _plenty(self, image: Image) -> bool:
        return image.valid_count >= PLENTY * self.n_features

    def _space(self) -> BilateralSpace:
        return BilateralSpace(self.intervals, float(self.sigma), float(self.tone), self.exact)

    def _found(self, level: Image, interval: int) -> Found:
        """Flat indices (N,) and strength (N,) of the extrema of an interval, the strongest first."""
        space = self._space()
        flat = bilateral_extrema(level, space, interval, self.threshold)
        flat = flat[clear(level, self.support * space.sigma_of(interval + 1)).ravel()[flat]]
        finer, coarser = (bilateral_level(level, space, interval + k).ravel() for k in (1, 2))
        strength = np.abs(coarser[flat] - finer[flat])
        if len(flat) > self.n_features:
            kept = strength >= np.partition(strength, -self.n_features)[-self.n_features]
            flat, strength = flat[kept], strength[kept]
        best = np.argsort(-strength, kind="stable")[: self.n_features]
        return flat[best], strength[best].astype(np.float64)

    def _orientations(
        self, image: Image, chain: tuple[Image, ...], number: int, xy: FloatArray, scale: float
    ) -> tuple[IntArray, FloatArray]:
        """((K,) rows, (K,) directions) of the gradients around points (N, 2) of one scale, found in one interval.

        Every point comes once, and after all of them those that have further directions.
        """
        coarser = number + round(math.log2(self.orientation_scale) * self.intervals)
        octave, interval = divmod(min(max(0, coarser), len(chain) * self.intervals - 1), self.intervals)
        level = chain[octave]
        field = bilateral_field(level, self._space(), interval + 1)
        radius = 0.5 * self.orientation_scale * scale * level.shape[1] / image.shape[1]
        around = field, from_base(xy, level, image), np.full(len(xy), radius)
        rows, angle = np.arange(len(xy)), dominant_orientation(*around)
        if self.second < 1:
            further, others = further_orientations(*around, self.second)
            rows, angle = np.concatenate([rows, further]), np.concatenate([angle, others])
        return rows, angle


def _places(finer: F32, coarser: F32, flat: IntArray) -> FloatArray:
    """(N, 2) places between the pixels of extrema of the difference of two levels (H, W), by their flat indices."""
    width = finer.shape[1]
    near = around(flat, width)
    values = coarser.ravel()[near] - finer.ravel()[near]
    y, x = np.divmod(flat, width)
    # A least value is the greatest of what is turned round.
    return np.column_stack([x, y]) + quadratic_steps(np.where(values[:, 4:5] < 0, -values, values))
