"""A feature matcher for images of unknown difference in scale, whose features know one scale only."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from featreg import registry
from featreg.errors import ParameterError
from featreg.feature_matcher import FeatureMatcher
from featreg.geometry import Similarity, local_linear
from featreg.interfaces import FailedFit, Matcher
from featreg.registry import register
from featreg.robust import fit_consensus
from featreg.sar.pyramid import to_base
from featreg.timing import stage
from featreg.trust import distinct
from featreg.types import BoolArray, FloatArray, Image, Matches

# Shorter sides than this hold too little to tell one scale from the next.
SMALLEST = 64
ITERATIONS = 800
# A reduced pixel counts where at least this share of it, of 255, is data.
WHOLE = 254


@register("scale-search")
@dataclass(frozen=True)
class ScaleSearch(Matcher):
    """Features of both images at several ratios of their scales, of which the one with the largest consensus counts.

    Parameters
    ----------
    n_features : at most so many features of each image in the final pass
    trial_features : at most so many of each image at every ratio tried
    detector, descriptor, nearest : names of the parts
    patch : side in pixels of what is described, for descriptors that have this parameter
    largest : ratios of the scales (secondary over reference) from 1 / `largest` to `largest` are sought
    step : largest factor between neighbouring ratios
    threshold : largest residual in reduced pixels of a match that counts
    seed : of the consensus

    Raises
    ------
    ParameterError
        An impossible value.

    Notes
    -----
    At every ratio the image that has the finer pixels is reduced to the other's, so that nothing is enlarged. A
    similarity is fitted to the matches; where its scale is not that of the ratio tried (to within one step), its
    consensus does not count. A final pass at the scale found, with all features, replaces the trial where more distinct
    places agree.
    """

    n_features: int = 5000
    trial_features: int = 2000
    detector: str = "phase-congruency"
    descriptor: str = "max-index-map"
    nearest: str = "brute-force"
    patch: float = 84.0
    largest: float = 2.0
    step: float = 1.3
    threshold: float = 4.0
    seed: int = 0

    def __post_init__(self) -> None:
        if self.n_features < 1 or self.trial_features < 1 or self.seed < 0:
            raise ParameterError(
                "scale-search needs n_features >= 1, trial_features >= 1 and seed >= 0, got "
                f"{self.n_features}, {self.trial_features} and {self.seed}"
            )
        if not (1 <= self.largest <= 16 and 1 < self.step <= 4 and self.threshold > 0):
            raise ParameterError(
                "scale-search needs largest from 1 to 16, step above 1 and up to 4, and threshold > 0, got "
                f"{self.largest}, {self.step} and {self.threshold}"
            )

    @property
    def ratios(self) -> tuple[float, ...]:
        """The ratios that are tried, from small to large, 1 among them."""
        half = math.ceil(math.log(self.largest) / math.log(self.step) - 1e-9)
        return tuple(self.largest ** (i / half) for i in range(-half, half + 1)) if half else (1.0,)

    def match(self, reference: Image, secondary: Image) -> Matches:
        """Return the matches at the best scale; empty where no scale has a consensus."""
        best, count, scale = Matches.empty(), 0, 0.0
        for ratio in self.ratios:
            found, places, fitted = self._at(reference, secondary, ratio, self.trial_features)
            if places > count:
                best, count, scale = found, places, fitted
        if count:
            found, places, _ = self._at(reference, secondary, scale, self.n_features)
            if places > count:
                best = found
        return best

    def _at(self, reference: Image, secondary: Image, ratio: float, budget: int) -> tuple[Matches, int, float]:
        """Matches at one ratio, how many distinct places agree on a similarity of about that scale, and its scale."""
        first, second = _reduced(reference, min(ratio, 1.0)), _reduced(secondary, min(1.0 / ratio, 1.0))
        if min(*first.shape, *second.shape) < SMALLEST:
            return Matches.empty(), 0, 0.0
        found = self._matcher(budget).match(first, second)
        here, there = to_base(found.reference_xy, first, reference), to_base(found.secondary_xy, second, secondary)
        with stage("scale"):
            rng = np.random.default_rng(self.seed)
            model, inliers = fit_consensus(
                Similarity, here, there, threshold=self.threshold * max(ratio, 1.0), rng=rng, iterations=ITERATIONS
            )
        if isinstance(model, FailedFit):
            return Matches.empty(), 0, 0.0
        scale = _scale(model, here)
        if not ratio / self.step <= scale <= ratio * self.step:
            return Matches.empty(), 0, 0.0
        enlarged = None if found.scale_ratio is None else found.scale_ratio * ratio
        matches = replace(found, reference_xy=here, secondary_xy=there, scale_ratio=enlarged)
        return matches, _places(here, there, inliers), scale

    def _matcher(self, budget: int) -> FeatureMatcher:
        return FeatureMatcher(
            registry.create("detector", self.detector, **_taken("detector", self.detector, n_features=budget)),
            registry.create("descriptor", self.descriptor, **_taken("descriptor", self.descriptor, patch=self.patch)),
            registry.create("nearest", self.nearest),
            budget,
        )


def _taken(kind: str, name: str, **parameters: float) -> dict[str, float]:
    """Those of the parameters that the plugin has."""
    known = registry.entry(kind, name).parameters
    return {key: value for key, value in parameters.items() if key in known}


def _scale(model: Similarity, at: FloatArray) -> float:
    linear = local_linear(model, at.mean(axis=0, keepdims=True))[0]
    return float(math.sqrt(abs(np.linalg.det(linear))))


def _places(here: FloatArray, there: FloatArray, inliers: BoolArray) -> int:
    return distinct(here[inliers], there[inliers])


def _reduced(image: Image, factor: float) -> Image:
    """The amplitude image `factor` times as large, by area weighting; kept with the image."""
    height, width = (max(1, round(n * factor)) for n in image.shape)
    if (height, width) == image.shape:
        return image
    return image.derive(_reduced_to, height=height, width=width)


def _reduced_to(image: Image, height: int, width: int) -> Image:
    import cv2

    size = (width, height)
    pixels = np.asarray(cv2.resize(image.amplitude, size, interpolation=cv2.INTER_AREA), np.float32)
    mask = np.ones(pixels.shape, np.bool_)
    if not image.all_valid:
        share = cv2.resize(image.mask.view(np.uint8) * np.uint8(255), size, interpolation=cv2.INTER_AREA)
        mask = np.asarray(share >= WHOLE)
        pixels = np.where(mask, pixels, np.float32(0))
    return Image(pixels, mask, source_dtype=image.source_dtype)
