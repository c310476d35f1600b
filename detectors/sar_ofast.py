"""SAR-OFAST: oriented FAST corners on the ROEWA edge pyramid of a SAR image."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Literal, Self

import numpy as np
from annotated_types import Ge, Interval
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.interfaces import Detector
from featreg.registry import register
from featreg.runtime.parameters import Count, Positive
from featreg.sar.gradients.gradient_field import from_base
from featreg.sar.gradients.ratio import quantised_edges, ratio_gradients
from featreg.sar.keypoints.corners import fast_corners, orient_level, orientation, refine_centroid, refine_corner
from featreg.sar.pyramid import REACH, SUPPORT, clear, level_count, pyramid, share_out, to_base, valid_width
from featreg.sar.speckle import despeckled_bytes_around
from featreg.types import Features, Image, Searched, read_only

ORIENTATION_RADIUS = 15
# Least number of valid pixels of the first level for each keypoint asked for where finer levels are not searched.
PLENTY = 90


@register("sar-ofast")
@dataclass(frozen=True)
class SarOfast(Detector):
    """FAST corners of the edge maps of a SAR image pyramid, with orientation and sub-pixel position.

    Parameters
    ----------
    n_features : at most so many keypoints, shared out over the levels
    levels, factor : pyramid levels, and the ratio of the sizes of two neighbours
    alpha : exponential weight of the ROEWA means, in pixels of the level
    floor : added to the means before their ratio is taken, relative to the image's mean amplitude
    threshold : least FAST score on the edge map quantised to 0..255
    quota_decay : a level gets `quota_decay` times fewer keypoints than the level before it
    support : radius in pixels of the level that must be free of nodata and of the image border
    edge : "log" (length of the log-ratio gradient) or "eq5" (the paper's Eq. 5)
    subpixel : "centroid" (of the edge map), "corner" (the paper's Eq. 6 and 7) or "none"
    clip : whether the strongest edges share the value 255, or it stands for the greatest strength alone
    sigma : standard deviation in pixels of the Gaussian weight of the 7 x 7 sub-pixel neighbourhood
    centroid : of what the direction of a corner is the centroid: "amplitude" (despeckled, of every third pixel along x
        and y, around the sub-pixel position) or "edges" (the paper's, of every pixel, around the corner of FAST)
    skip : at most so many of the finest levels are not searched, but as many more coarser ones: as long as the first
        one that is has at least 90 valid pixels for each keypoint asked for, and the last one room for a keypoint

    Notes
    -----
    Z. Wang et al., "Rapid Subpixel Matching Method for Spaceborne Synthetic Aperture Radar Images", Sensors and
    Materials 34 (2022) 3138, section 2.3. As there, every level's edge map is computed from that level's image.
    Departures, each with the paper's form behind a parameter: the edge map is the length of the logarithmic ratio
    gradient, which orders edges of equal contrast alike in all directions; the sub-pixel position is the iterated
    centroid of the edge strength, because few corners under speckle are crossings of two edges, and at the others the
    gradients of Eq. 6 are not perpendicular on the lines to the corner (measured on one-look Sentinel-1 pairs: 0.70 px
    RMSE of the correct matches against 0.83 px without and 0.83 px by Eq. 7); finer levels get a larger share
    (`quota_decay`), because a pixel of error there costs less; the direction is that of the despeckled
    amplitude; strong edges are clipped. A corner that runs away stays at its pixel and is marked False in
    `Features.subpixel`. Where corners are few beside the pixels, the finest levels are not searched (`skip`): coarser
    ones have less speckle, and more corners are found again (a corner for each 180 px, three levels of 1.3 from the
    second on: a fifth more correct matches at four looks, twice as many at one), for half of the work. The number of
    valid pixels decides, that of the smaller image of a pair for both (`for_pair`).
    """

    n_features: Count = 5000
    levels: Count = 8
    factor: Annotated[float, Interval(gt=1, lt=math.inf)] = 1.2
    alpha: Positive = 2.0
    floor: Annotated[float, Interval(ge=0, lt=math.inf)] = 0.1
    threshold: Annotated[int, Interval(ge=0, le=254)] = 10
    quota_decay: Annotated[float, Ge(1)] = 2.5
    support: Annotated[float, Interval(ge=3, le=1000)] = SUPPORT
    edge: Literal["log", "eq5"] = "log"
    subpixel: Literal["centroid", "corner", "none"] = "centroid"
    sigma: Annotated[float, Interval(ge=0.3, le=10)] = 1.0
    clip: bool = True
    centroid: Literal["amplitude", "edges"] = "amplitude"
    skip: Annotated[int, Interval(ge=0, le=8)] = 0

    @property
    def reach(self) -> float:
        """What must be free on the coarsest level."""
        return (self.support + REACH) * self.factor ** (self.skip + self.levels - 1)

    def for_pair(self, reference: Image, secondary: Image) -> Self:
        """With the finest levels that either image needs."""
        return replace(self, skip=min(self._skipped(reference), self._skipped(secondary)))

    def searched(self, image: Image) -> Searched:
        first = self._skipped(image)
        radii = [
            self.support * self.factor**n for n in range(level_count(image.shape, first + self.levels, self.factor))
        ]
        return Searched(radii=tuple(radii[first:]), left_out={"skip": tuple(radii[:first])} if first else {})

    def detect_features(self, image: Image) -> Features:
        return self.oriented(image, self.detect_places(image))

    def detect_places(self, image: Image) -> Features:
        """As `detect_features`, upright but for directions of the edges."""
        first = self._skipped(image)
        chain = pyramid(image, first + self.levels, self.factor)[first:]
        found = [self._corners(level) for level in chain]
        counts = share_out(self.n_features, [len(score) for _, score in found], self.quota_decay)
        parts = []
        for number, (level, (xy, score), count) in enumerate(zip(chain, found, counts, strict=True), first):
            moved, stable = self._subpixel(level, xy[:count])
            # The published direction is that of the corner, before it moves; ours is asked for later, of few at times.
            if self.centroid == "edges":
                angle = orientation(self._edges(level), xy[:count], ORIENTATION_RADIUS, stride=1)
            else:
                angle = np.zeros(count)
            radius = self.support * math.sqrt(image.mask.size / level.mask.size)
            parts.append(
                (
                    to_base(moved, level, image), score[:count], stable, np.full(count, radius), np.full(count, number),
                    angle,
                )
            )  # fmt: skip
        places, score, stable, scale, numbers, angle = (np.concatenate(columns) for columns in zip(*parts, strict=True))
        order = np.argsort(255 - score, kind="stable")
        return Features(
            xy=read_only(places.take(order, 0)),
            scale=read_only(scale.take(order)),
            angle=read_only(angle.take(order)),
            score=score.take(order),
            level=read_only(numbers.take(order)),
            subpixel=read_only(stable.take(order)),
        )

    def oriented(self, image: Image, features: Features) -> Features:
        """With the direction to the centroid of the disc around the pixel on which a keypoint falls on its level."""
        if self.centroid == "edges":
            return features
        angle, numbers, shape = np.zeros(len(features)), features.level, image.shape
        counts = np.bincount(numbers).tolist()
        chain = pyramid(image, len(counts), self.factor)
        if len(chain) < len(counts):
            raise InputError(
                f"keypoints of level {len(counts) - 1} are not of this image: its levels of factor {self.factor:g} end "
                f"with {len(chain) - 1}"
            )
        for number, (level, count) in enumerate(zip(chain, counts, strict=False)):
            if not count:
                continue
            places = partial(_places, features, number, level, image)
            view = despeckled_bytes_around(level, places, count, ORIENTATION_RADIUS)
            orient_level(view, features.xy, shape, numbers, number, ORIENTATION_RADIUS, angle)
        return features.having(angle=read_only(angle))

    def _skipped(self, image: Image) -> int:
        """How many of the finest levels are not searched: none for which no coarser one can hold a keypoint instead."""
        valid, skipped = image.valid_count, 0
        most = min(self.skip, level_count(image.shape, self.skip + self.levels, self.factor) - self.levels)
        # What the last level is smaller by at most, so that more than a border is left of it.
        smaller = valid_width(image) / (2 * math.ceil(self.support + REACH) + 1)
        while skipped < most and self.factor ** (skipped + self.levels) <= smaller:
            if valid < PLENTY * self.n_features * self.factor ** (2 * (skipped + 1)):
                break
            skipped += 1
        return skipped

    def _edges(self, level: Image) -> NDArray[np.uint8]:
        return level.derive(quantised_edges, alpha=self.alpha, floor=self.floor, eq5=self.edge == "eq5", clip=self.clip)

    def _corners(self, level: Image) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
        return fast_corners(self._edges(level), self.threshold, clear(level, self.support + REACH), self.n_features)

    def _subpixel(self, level: Image, at: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        if self.subpixel == "centroid":
            return refine_centroid(self._edges(level), at, self.sigma)
        if self.subpixel == "corner":
            return refine_corner(*ratio_gradients(level, self.alpha, self.floor), at, self.sigma)
        return at.astype(np.float64), np.ones(len(at), np.bool_)


def _places(features: Features, number: int, level: Image, image: Image) -> NDArray[np.int64]:
    """(M, 2) pixels of a level of that number of an image on which its keypoints fall."""
    return np.asarray(np.rint(from_base(features.xy[features.level == number], level, image)), np.int64)
