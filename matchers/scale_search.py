"""A feature matcher for images of unknown difference in scale, whose features know one scale only."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from annotated_types import Ge, Interval

from featreg import registry
from featreg.geometry import Similarity
from featreg.geometry.robust import fit_consensus
from featreg.interfaces import FailedFit, Matcher, Plugin
from featreg.pipeline.feature_matcher import FeatureMatcher
from featreg.pipeline.trust_measures import distinct
from featreg.registry import register
from featreg.runtime.parameters import Count, Positive, Share
from featreg.runtime.timing import stage
from featreg.sar.pyramid import reduced, to_base
from featreg.types import Image, Matches

logger = logging.getLogger(__name__)

# Shorter sides than this hold too little to tell one scale from the next.
SMALLEST = 64
ITERATIONS = 800
HALVED_SIDE = 256
# Matches at a finer size are preferred where they have this share of the cells.
ENOUGH = 0.4
# Alignments whose corners lie this near to each other, as a share of the diagonal, are one.
NEAR = 0.15


@dataclass(frozen=True, eq=False)
class _Trial:
    """Matches at one ratio of the scales and one size, and the similarity on which so many distinct cells agree."""

    matches: Matches
    model: Similarity
    scale: float
    size: float
    cells: int


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
    halvings : so many times both images are also tried at half the size before, while the shorter side stays 256 px
    threshold : largest residual in reduced pixels of a match that counts
    ambiguity : no match is returned where another alignment has more than this share of the best one's cells
    seed : of the consensus

    Raises
    ------
    ParameterError
        An impossible value.

    Notes
    -----
    Speckle that drowns a structure at full size is averaged away at half of it. At every ratio the image that has the
    finer pixels is reduced to the other's, so that nothing is enlarged. A similarity is fitted to the matches; where
    its scale is not that of the ratio tried (to within one step), its consensus does not count. Final passes at the
    scale found, with all features, from full size down to that of the best trial, replace it where they agree with it
    and have support enough. Index maps hardly tell an image from itself turned by half a turn, so that two alignments
    can each have a consensus on a scene of fields or streets: then none is given.
    """

    n_features: Count = 5000
    trial_features: Count = 2000
    detector: str = "phase-congruency"
    descriptor: str = "max-index-map"
    nearest: str = "brute-force"
    patch: Positive = 84.0
    largest: Annotated[float, Interval(ge=1, le=16)] = 2.0
    step: Annotated[float, Interval(gt=1, le=4)] = 1.3
    halvings: Annotated[int, Ge(0)] = 2
    threshold: Positive = 4.0
    ambiguity: Share = 0.6
    seed: Annotated[int, Ge(0)] = 0

    @property
    def ratios(self) -> tuple[float, ...]:
        """The ratios that are tried, from small to large, 1 among them."""
        half = math.ceil(math.log(self.largest) / math.log(self.step) - 1e-9)
        return tuple(self.largest ** (i / half) for i in range(-half, half + 1)) if half else (1.0,)

    @property
    def parts(self) -> tuple[Plugin, ...]:
        return (self._matcher(self.n_features),)

    def match(self, reference: Image, secondary: Image) -> Matches:
        """Return the matches at the best scale; empty where no scale has a consensus, or where two rival ones do."""
        matcher = self._matcher(self.trial_features)
        trials = [
            self._at(reference, secondary, ratio, size, matcher)
            for size in self._sizes(reference, secondary)
            for ratio in self.ratios
        ]
        found = sorted((t for t in trials if t is not None), key=lambda t: -t.cells)
        if not found:
            return Matches.empty()
        best = found[0]
        rival = max((t.cells for t in found if not _agree(t.model, best.model, reference)), default=0)
        if rival > self.ambiguity * best.cells:
            logger.info("no matches: %d cells agree on one alignment, %d on quite another", best.cells, rival)
            return Matches.empty()
        # The finer the pixels, the more precise are the matches, as long as the structures are still seen in them.
        matcher = self._matcher(self.n_features)
        for size in [s for s in self._sizes(reference, secondary) if s >= best.size]:
            final = self._at(reference, secondary, best.scale, size, matcher)
            least = best.cells if size == best.size else ENOUGH * best.cells
            if final is not None and final.cells > least and _agree(final.model, best.model, reference):
                return final.matches
        return best.matches

    def _sizes(self, reference: Image, secondary: Image) -> list[float]:
        """To what share of their size both images are reduced."""
        shorter = min(*reference.shape, *secondary.shape)
        return [0.5**i for i in range(self.halvings + 1) if i == 0 or shorter * 0.5**i >= HALVED_SIDE]

    def _at(
        self, reference: Image, secondary: Image, ratio: float, size: float, matcher: FeatureMatcher
    ) -> _Trial | None:
        """What is found at one ratio, None where no similarity of about that scale has a consensus."""
        first = reduced(reference, size * min(ratio, 1.0))
        second = reduced(secondary, size * min(1.0 / ratio, 1.0))
        if min(*first.shape, *second.shape) < SMALLEST:
            return None
        found = matcher.match(first, second)
        here, there = to_base(found.reference_xy, first, reference), to_base(found.secondary_xy, second, secondary)
        with stage("scale"):
            rng = np.random.default_rng(self.seed)
            reach = self.threshold * max(ratio, 1.0) / size
            model, inliers = fit_consensus(Similarity, here, there, threshold=reach, rng=rng, iterations=ITERATIONS)
        if isinstance(model, FailedFit):
            return None
        scale = math.sqrt(abs(np.linalg.det(model.matrix[:2, :2])))
        if not ratio / self.step <= scale <= ratio * self.step:
            return None
        enlarged = None if found.scale_ratio is None else found.scale_ratio * ratio
        matches = replace(found, reference_xy=here, secondary_xy=there, scale_ratio=enlarged)
        return _Trial(matches, model, scale, size, distinct(here[inliers], there[inliers]))

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


def _agree(one: Similarity, other: Similarity, reference: Image) -> bool:
    """Whether two models map the corners of the reference to about the same places."""
    height, width = reference.shape
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]], np.float64)
    there = other(corners)
    size = float(np.hypot(*(there[3] - there[0])))
    return bool(np.hypot(*(one(corners) - there).T).max() <= NEAR * size)
