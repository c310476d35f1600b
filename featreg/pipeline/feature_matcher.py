"""The matcher that puts a detector, a descriptor and a nearest-neighbour search together."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval

from featreg.errors import ParameterError
from featreg.geometry.base import decompose
from featreg.interfaces import Descriptor, Detector, Matcher, Model, Nearest, Plugin
from featreg.pipeline.aligned import linear_parts
from featreg.runtime.buffers import keeping
from featreg.runtime.parameters import Count, checked
from featreg.runtime.threads import side_by_side
from featreg.runtime.timing import stage
from featreg.sar.pyramid import pyramid, to_base, valid_width
from featreg.types import Features, FloatArray, Image, IntArray, Matches, Searched, read_only
from featreg.types.arrays import middle

# The vote on a common rotation: how many features take part, and how many where those do not agree, the number of
# bins, and how far (in standard deviations of a Poisson count) the best must stand out.
VOTERS, MORE_VOTERS = 500, 2000
BINS = 72
SMOOTHING = 2
SIGNIFICANCE = 6.0
# How far, in radians, a known rotation may be off: descriptors bear it. So many features tell whether they have
# directions.
TURNED, SOME = math.radians(5), 8
# Images are reduced to no less than the first share of their side, and not at all where the second would do.
LEAST_SHARE, WORTH = 0.5, 0.85
# The width of what is valid in a reduced image, px: in less there is hardly a place whose surroundings lie inside.
LEAST_SIDE = 64


@checked("")
@dataclass(frozen=True)
class FeatureMatcher(Matcher):
    """Detect, describe, pair.

    Parameters
    ----------
    detector, descriptor, nearest : the parts; `descriptor` may be None where the detector describes at once
    n_features : at most so many features of each image are used, those of the highest score
    common_rotation : look for one rotation between the images and describe all features of each image in one direction
    pixels_per_feature : where the smaller of the images has more valid pixels than so many for each of `n_features`, or
        of the detector's where that is less, features are found in images reduced to about so many, at most to half of
        their sides and to no side, or strip of valid pixels, of less than 64 pixels; 0 never reduces them

    Notes
    -----
    Reduced images are averages, in which less speckle is left, and features spread further over what is there. At 60 to
    75 pixels for each feature, simulated looks of Sentinel-1 and pairs of its dates have 1.2 to 2 times as many correct
    matches as at full size, found sooner. Positions are as much coarser, so that they are to be measured again.

    Under speckle the orientation of a single keypoint is off by tens of degrees, but two images of one scene are turned
    by one angle. With `common_rotation` the strongest features, described by their own angles, vote on it; where the
    vote is clear, all features of the reference are described upright and those of the secondary turned by that angle.
    Where 500 of each image do not agree, which happens on one in five of change pairs and floods, 2000 are asked: four
    fifths of these have their rotation then. Where the vote is not clear either, each feature keeps its own.
    """

    detector: Detector
    descriptor: Descriptor | None
    nearest: Nearest
    n_features: Count = 5000
    common_rotation: bool = True
    pixels_per_feature: Annotated[float, Interval(ge=0, lt=math.inf)] = 0.0

    @property
    def reach(self) -> float:
        """That of the detector, or of the descriptor at the detector's largest keypoints."""
        found = self.detector.reach
        reach = found if self.descriptor is None else max(found, self.descriptor.reach_of(found))
        return reach / LEAST_SHARE if self.pixels_per_feature else reach

    @property
    def parts(self) -> tuple[Plugin, ...]:
        found = (self.detector, self.descriptor, self.nearest)
        return tuple(part for part in found if part is not None)

    def match(self, reference: Image, secondary: Image) -> Matches:
        return self._found(reference, secondary, None)

    def match_near(self, reference: Image, secondary: Image, initial: Model, radius: float) -> Matches:
        """As `match`; the rotation is that of `initial` where that tells it to a few degrees, and nothing votes."""
        return self._found(reference, secondary, known_rotation(initial, reference.shape, radius))

    def _found(self, reference: Image, secondary: Image, rotation: float | None) -> Matches:
        share = self._share(reference, secondary)
        if share == 1:
            return self._matched(reference, secondary, rotation)
        with stage("detect"):
            one, two = (_reduced(image, share) for image in (reference, secondary))
        found = self._matched(one, two, rotation)
        first, second = to_base(found.reference_xy, one, reference), to_base(found.secondary_xy, two, secondary)
        return replace(found, reference_xy=first, secondary_xy=second)

    def searched_in(self, reference: Image, secondary: Image) -> tuple[Searched, Searched]:
        images = reference, secondary
        share = self._share(*images)
        seen = [_reduced(image, share) for image in images]
        detector = self.detector.for_pair(seen[0], seen[1])
        one, two = (detector.searched(image).of_part("detector") for image in seen)
        if share == 1:
            return one, two
        return one.reduced(share, "pixels_per_feature"), two.reduced(share, "pixels_per_feature")

    def keypoints(self, image: Image) -> FloatArray:
        """(N, 2) keypoints in an image that is compared with one of its size, at most `n_features`."""
        seen = _reduced(image, self._share(image))
        return to_base(self.detector.detect_places(seen).best(self.n_features).xy, seen, image)

    def _share(self, *images: Image) -> float:
        """The share of their sides at which features are found in images."""
        # A detector may have a smaller budget of its own.
        own = getattr(self.detector, "n_features", None)
        wanted = self.pixels_per_feature * min(self.n_features, self.n_features if own is None else own)
        pixels = min(image.valid_count for image in images) if wanted else 0
        if not pixels:
            return 1.0
        least = LEAST_SIDE / min(valid_width(image) for image in images)
        share = max(LEAST_SHARE, least, math.sqrt(wanted / pixels))
        return share if share < WORTH else 1.0

    def _matched(self, reference: Image, secondary: Image, known: float | None) -> Matches:
        with stage("detect"), keeping():
            detector = self.detector.for_pair(reference, secondary)
            found = self._each(self._detect, [(detector, reference), (detector, secondary)])
        if not len(found[0]) or not len(found[1]):
            return Matches.empty()
        images = (reference, secondary)
        rotation = self._rotation(detector, images, found, known)
        with stage("detect"):
            if rotation is None:
                found = self._each(detector.oriented, list(zip(images, found, strict=True)))
            else:
                turns = (0.0, rotation)
                found = [f.having(angle=read_only(np.full(len(f), turn))) for f, turn in zip(found, turns, strict=True)]
        with stage("describe"):
            a, b = self._each(self._describe, [(reference, found[0]), (secondary, found[1])])
        with stage("match"):
            pairs, score = self.nearest.match_features(a, b)
        i, j = pairs.T
        return Matches(
            a.xy[i],
            b.xy[j],
            score,
            rotation=_wrapped(b.angle[j] - a.angle[i]),
            scale_ratio=b.scale[j] / np.maximum(a.scale[i], 1e-9),
        )

    def _detect(self, detector: Detector, image: Image) -> Features:
        with keeping():
            return detector.detect_places(image).best(self.n_features)

    def _describe(self, image: Image, features: Features) -> Features:
        # A descriptor that was asked for describes, whatever the detector may have returned.
        if self.descriptor is None and features.descriptors is not None:
            return features
        if self.descriptor is None:
            name = type(self.detector).__name__
            raise ParameterError(f"detector {name} gives no descriptors: choose one, as in descriptor='brief'")
        return self.descriptor.describe_features(image, features)

    def _each(self, function: Callable[..., Features], given: Sequence[tuple[Any, ...]]) -> list[Features]:
        """What a part makes of each image, side by side where threads were asked for and all parts are compiled."""
        work = [partial(function, *arguments) for arguments in given]
        return side_by_side(work) if all(one.compiled for one in self.parts) else [one() for one in work]

    def _rotation(
        self, detector: Detector, images: tuple[Image, Image], found: list[Features], known: float | None
    ) -> float | None:
        """By how much the secondary is turned, or None where each feature keeps its own direction."""
        described = self.descriptor is None and any(features.descriptors is not None for features in found)
        if not self.common_rotation or described:
            return None
        if known is None:
            return self._vote(detector, images, found)
        with stage("detect"):
            few = detector.oriented(images[0], found[0].best(SOME))
        # Features without directions of their own are described upright, however the images are turned.
        return None if (few.angle == few.angle[0]).all() else known

    def _vote(self, detector: Detector, images: tuple[Image, Image], found: list[Features]) -> float | None:
        turn = None
        for most in (VOTERS, MORE_VOTERS):
            with stage("detect"):
                voters = [(image, f.best(most)) for image, f in zip(images, found, strict=True)]
                voters = list(zip(images, self._each(detector.oriented, voters), strict=True))
            if any((features.angle == features.angle[0]).all() for _, features in voters):
                return None
            with stage("describe"):
                first, second = self._each(self._describe, voters)
            with stage("rotation"):
                pairs, _ = self.nearest.match_features(first, second)
                turn = common_rotation(second.angle[pairs[:, 1]] - first.angle[pairs[:, 0]])
            if turn is not None or max(len(features) for features in found) <= most:
                break
        return turn


def known_rotation(initial: Model, shape: tuple[int, int], radius: float) -> float | None:
    """Return the angle in radians by which a model turns the middle of an image, counter-clockwise as seen.

    None where points that lie up to `radius` px off the model leave it open by more than a few degrees.
    """
    if 2 * radius > math.tan(TURNED) * min(shape):
        return None
    rotation = decompose(linear_parts(initial, np.array([[shape[1] - 1, shape[0] - 1]]) / 2)[0]).rotation_deg
    return math.radians(rotation) if math.isfinite(rotation) else None


def _reduced(image: Image, share: float) -> Image:
    """The image at a share of its sides, as a pyramid makes it; averages over areas match no better and take longer."""
    return image if share == 1 else pyramid(image, 2, 1 / share)[-1]


def common_rotation(differences: FloatArray) -> float | None:
    """Return the angle in radians on which (M,) angle differences agree, or None where they do not stand out."""
    if not len(differences):
        return None
    wrapped = _wrapped(differences)
    bins: IntArray = np.floor((wrapped + math.pi) / (2 * math.pi) * BINS).astype(np.int64) % BINS
    counts = np.bincount(bins, minlength=BINS)
    around = np.concatenate([counts[-SMOOTHING:], counts, counts[:SMOOTHING]])
    window = np.convolve(around, np.ones(2 * SMOOTHING + 1, np.int64), "valid")
    best = int(np.argmax(window))
    expected = len(wrapped) * (2 * SMOOTHING + 1) / BINS
    if window[best] < expected + SIGNIFICANCE * math.sqrt(expected):
        return None
    centre = (best + 0.5) / BINS * 2 * math.pi - math.pi
    near = _wrapped(wrapped - centre)
    near = near[np.abs(near) <= (2 * SMOOTHING + 1) * math.pi / BINS]
    return centre + middle(near)


def _wrapped(angle: FloatArray) -> FloatArray:
    return np.asarray((angle + math.pi) % (2 * math.pi) - math.pi)
