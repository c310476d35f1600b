"""Dense matching: global orientation correlation, windows that verify and refine what it finds."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge, Interval, Lt

from featreg.geometry import Affine, Similarity
from featreg.geometry.robust import irls
from featreg.interfaces import FailedFit, Matcher
from featreg.registry import register
from featreg.runtime.parameters import Count, Positive, Share
from featreg.runtime.timing import stage
from featreg.sar.correlation import Peaks, peaks
from featreg.sar.orientation.levels import Level, aligned
from featreg.sar.orientation.search import Alignment, Grid, scale_steps, search
from featreg.sar.orientation.verification import Verified, verified
from featreg.sar.orientation.windows import Surfaces, correlated
from featreg.types import BoolArray, FloatArray, Image, Matches

logger = logging.getLogger(__name__)

#: Samples along the longer side of the first fine level; each further one has twice as many.
FINE_SIDE = 256
#: Windows that determine an affine correction of the alignment, and a similarity.
LEAST_AFFINE, LEAST_SIMILAR = 24, 6
#: Errors of windows below this are not told apart, samples.
SCALE = 0.3
#: Samples of a field whose correlation tells one independent one, as measured on simulated pairs.
CORRELATED = 12.0


@register("orientation-correlation")
@dataclass(frozen=True)
class OrientationCorrelation(Matcher):
    """Tie points by correlating the orientation of ratio gradients: of the whole images first, then window by window.

    Parameters
    ----------
    n_features : at most about so many windows
    largest : ratios of the scales (secondary over reference) from 1 / `largest` to `largest` are sought
    scale_step : largest factor between neighbouring ratios
    rotation_step : largest angle in degrees between neighbouring rotations, of all 360
    side : longer side to which both fields are reduced for the search
    least_overlap : share of the smaller image that must be common to both, about
    candidates : alignments that are verified
    chance : `log10_chance` of the windows of an alignment (`featreg.sar.orientation.verification`) at most
    ambiguity : no tie point is returned where another alignment has more than this share of the best one's logarithm
    alpha : of the gradients whose field gives the tie points, px
    window : side of a window, px
    search : largest displacement of a window between one level and the next, px

    Raises
    ------
    ParameterError
        An impossible value.

    Notes
    -----
    The field is the double-angle one of ROEWA gradients (`featreg.sar.orientation.field`), which forgets reversed
    contrast, so that optical and SAR images compare. Every pixel votes in the search, which speckle does not survive;
    its peak does not tell related from unrelated images, so that several candidates are kept. Windows that do not
    overlap refine each of them together and then say, each by the rank of its own correlation there, whether it is
    more than chance. The best one is followed to full resolution, where each window gives a tie point.

    The covariance of a tie point is (1 - rho^2) / (n rho) times the inverse curvature of its peak of height rho, n the
    number of independent samples in the window.

    References
    ----------
    A. J. Fitch, A. Kadyrov, W. J. Christmas, J. Kittler, "Orientation correlation", BMVC 2002, DOI 10.5244/C.16.11;
    R. Fjortoft et al., "An optimal multiedge detector for SAR image segmentation", IEEE TGRS 36 (1998) 793, DOI
    10.1109/36.673672
    """

    n_features: Count = 5000
    largest: Annotated[float, Interval(ge=1, le=16)] = 2.0
    scale_step: Annotated[float, Interval(gt=1, le=2)] = 1.15
    rotation_step: Annotated[float, Interval(gt=0, le=30)] = 7.5
    side: Annotated[int, Interval(ge=16, le=256)] = 48
    least_overlap: Share = 0.15
    candidates: Count = 6
    chance: Annotated[float, Lt(0)] = -6.5
    ambiguity: Share = 0.7
    alpha: Positive = 2.0
    window: Annotated[int, Ge(8)] = 32
    search: Count = 4

    @property
    def reach(self) -> float:
        """Half a window, what its displacement adds, and the support of its gradients."""
        return self.window / 2 + self.search + 4 * self.alpha

    def match(self, reference: Image, secondary: Image) -> Matches:
        """Return one tie point per window; empty where no alignment is more than chance, or where two are."""
        grid = Grid(self.side, self.rotation_step, scale_steps(self.largest, self.scale_step), self.least_overlap)
        with stage("search"):
            starts = search(reference, secondary, grid, self.candidates)
        with stage("verify"):
            best = self._best(verified(reference, secondary, starts))
        if best is None:
            return Matches.empty()
        with stage("windows"):
            return self._tie_points(reference, secondary, best)

    def _best(self, judged: Sequence[Verified]) -> Alignment | None:
        """The alignment for which windows speak most, None where that is chance or another has as much."""
        if not judged:
            return None
        best = judged[0].log10_chance
        rival = judged[1].log10_chance if len(judged) > 1 else 0.0
        if best > self.chance:
            logger.info("no tie points: the windows of the best alignment agree as by chance (1e%.1f)", best)
            return None
        if rival < self.ambiguity * best:
            logger.info("no tie points: the windows of two alignments agree (1e%.1f and 1e%.1f by chance)", best, rival)
            return None
        return judged[0].alignment

    def _tie_points(self, reference: Image, secondary: Image, alignment: Alignment) -> Matches:
        """Follow an alignment to full resolution; the windows of the finest level are the tie points."""
        affine = alignment.affine
        finest = max(reference.shape) * min(1.0, alignment.scale)
        samples = min(float(FINE_SIDE), finest)
        while True:
            level = aligned(reference, secondary, affine, samples, self.alpha)
            found = correlated(level, self.window, self.search, self._step(level))
            seen = peaks(found.values.astype(np.float64))
            if samples >= finest:
                return self._matches(level, found, seen)
            affine = _corrected(level, found, seen)
            samples = min(2 * samples, finest)

    def _step(self, level: Level) -> int:
        """Distance of neighbouring windows, so that they touch at most, and fewer than the budget fit."""
        return max(self.window, math.ceil(math.sqrt(level.valid.size / self.n_features)))

    def _matches(self, level: Level, found: Surfaces, seen: Peaks) -> Matches:
        good = np.flatnonzero(seen.sound & (seen.height > 0))
        height = seen.height[good]
        here = level.reference_xy(found.xy[good])
        there = level.secondary_xy(found.xy[good] + seen.shift[good])
        covariance = np.linalg.inv(seen.curvature[good])
        covariance *= (np.maximum(1 - height**2, 1e-6) * CORRELATED / (height * found.samples[good]))[:, None, None]
        onto = level.affine[:, :2] / level.factor
        return Matches(here, there, height, onto @ covariance @ onto.T)


def _corrected(level: Level, found: Surfaces, seen: Peaks) -> FloatArray:
    """The alignment after a robust fit to what the windows of a level say; as it was where they say too little."""
    good: BoolArray = seen.sound & (seen.height > 0)
    here, there = found.xy[good], found.xy[good] + seen.shift[good]
    for kind, least in ((Affine, LEAST_AFFINE), (Similarity, LEAST_SIMILAR)):
        if len(here) < least:
            continue
        model, weights = irls(kind, here, there, weights=seen.height[good] ** 2, scale_px=SCALE, iterations=5)
        if not isinstance(model, FailedFit) and np.count_nonzero(weights) >= least and model.matrix is not None:
            return level.moved(model.matrix[:2])
    return level.affine
