"""Dense matching: global orientation correlation, windows that verify and refine what it finds."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Interval, Lt

from featreg.errors import ParameterError
from featreg.geometry import Affine, Similarity
from featreg.geometry.robust import irls
from featreg.interfaces import FailedFit, Matcher, Model
from featreg.registry import register
from featreg.runtime.parameters import Count, Positive, Share
from featreg.runtime.timing import stage
from featreg.sar.correlation import Peaks, peaks
from featreg.sar.orientation.levels import Level, aligned
from featreg.sar.orientation.pieces import (
    Piece,
    distinct_of_pieces,
    in_part,
    in_whole,
    pairs_of_pieces,
    settled,
    shared_part,
)
from featreg.sar.orientation.precision import peak_covariances
from featreg.sar.orientation.scales import with_coarser
from featreg.sar.orientation.search import Alignment, Correlator, Grid, scale_steps, search
from featreg.sar.orientation.verification import DECIDED, Verified, near, verified
from featreg.sar.orientation.windows import Surfaces, correlated
from featreg.types import BoolArray, FloatArray, Image, Matches

logger = logging.getLogger(__name__)

#: So many ratios of the scales nearest to 1 are tried first; an alignment stands out whose score is so many times that
#: of the next.
SIMILAR, OUTSTANDING = 3, 1.4
#: Samples along the longer side of the first fine level; each further one has at most so many times as many.
FINE_SIDE, FINER = 256, 4
#: Windows that determine an affine correction of the alignment, and a similarity.
LEAST_AFFINE, LEAST_SIMILAR = 24, 6
#: So many times what errors of windows add to the two further parameters of an affine correction, it has to add.
SURE = 9.0
#: Errors of windows below this are not told apart, samples.
SCALE = 0.3


@register("orientation-correlation")
@dataclass(frozen=True)
class OrientationCorrelation(Matcher):
    """Tie points by correlating the orientation of ratio gradients: of the whole images first, then window by window.

    Parameters
    ----------
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
    overlapping : share of a window's side that neighbours have in common, at most
    most : about so many windows at most
    search : largest displacement of a window between one level and the next, px
    backend : what the global search runs on, "torch" by the extra of that name
    device : of torch: "cpu", "cuda", "auto", ...; None for "auto"

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
    more than chance. The best one is followed to full resolution, where each window gives a tie point; where speckle
    leaves the windows at odds, with what twice as large ones say of coarser gradients
    (`featreg.sar.orientation.scales`). Pixels that stand alike in both images while their surroundings disagree do not
    vote.

    The covariance of a tie point is that of its window's peak, rival peaks counted
    (`featreg.sar.orientation.precision`).

    References
    ----------
    A. J. Fitch, A. Kadyrov, W. J. Christmas, J. Kittler, "Orientation correlation", BMVC 2002, DOI 10.5244/C.16.11;
    R. Fjortoft et al., "An optimal multiedge detector for SAR image segmentation", IEEE TGRS 36 (1998) 793, DOI
    10.1109/36.673672
    """

    largest: Annotated[float, Interval(ge=1, le=16)] = 2.0
    scale_step: Annotated[float, Interval(gt=1, le=2)] = 1.15
    rotation_step: Annotated[float, Interval(gt=0, le=30)] = 7.5
    side: Annotated[int, Interval(ge=16, le=256)] = 48
    least_overlap: Share = 0.15
    candidates: Count = 6
    chance: Annotated[float, Lt(0)] = -6.2
    ambiguity: Share = 0.7
    alpha: Positive = 0.8
    window: Annotated[int, Ge(8)] = 48
    overlapping: Annotated[float, Interval(ge=0, le=0.9)] = 0.5
    most: Count = 144
    search: Count = 6
    backend: Literal["numpy", "torch"] = "numpy"
    device: str | None = None

    @property
    def reach(self) -> float:
        """Half a window, what its displacement adds, and the support of its gradients."""
        return self.window / 2 + self.search + 4 * self.alpha

    def match(self, reference: Image, secondary: Image) -> Matches:
        """Return one tie point per window; empty where no alignment is more than chance, or where two are."""
        best, ambiguous = self._best(self._alignments(reference, secondary))
        if best is None and not ambiguous:
            best = self._best_of_pieces(reference, secondary)
        if best is None:
            return Matches.empty()
        with stage("windows"):
            return self._tie_points(reference, secondary, best)

    def match_near(self, reference: Image, secondary: Image, initial: Model, radius: float) -> Matches:
        """As `match`, of images that `initial` aligns to within a radius in pixels of the secondary."""
        affine = _linearised(initial, reference.shape)
        known = None
        if affine is not None:
            with stage("verify"):
                part = shared_part(reference, secondary, affine, radius / Alignment(affine, 0.0).scale)
                known = near(part.image, secondary, in_part(affine, part), radius)
        if known is None:
            return self.match(reference, secondary)
        best, _ = self._best([known])
        if best is None:
            return Matches.empty()
        with stage("windows"):
            # What is known of the shape of the map needs no coarse level.
            return self._tie_points(reference, secondary, in_whole(best, part, Piece(secondary)), FINER * FINE_SIDE)

    def _alignments(self, reference: Image, secondary: Image) -> list[Verified]:
        """Verified alignments of two images, best first."""
        scales = scale_steps(self.largest, self.scale_step)
        # Most images have about the same scale: where an alignment of these stands out and is decided, it is the one.
        judged = self._search(reference, secondary, scales[:SIMILAR], OUTSTANDING)
        if not judged or judged[0].answer > DECIDED:
            judged = self._search(reference, secondary, scales, 0.0)
        return judged

    def _best_of_pieces(self, reference: Image, secondary: Image) -> Alignment | None:
        """The best alignment of a strip, or of a small image in a large one, by pieces of them."""
        pairs = pairs_of_pieces(reference, secondary)
        # Two strips are settled by two pairs that agree; elsewhere in a large image a small one may lie as well.
        strips = len({first.corner for first, _ in pairs}) > 1 and len({second.corner for _, second in pairs}) > 1
        # So many more pairs have as many times the chance.
        more = math.log10(max(1, len(pairs)))
        found: list[tuple[Verified, Piece]] = []
        for first, second in pairs:
            for one in self._alignments(first.image, second.image):
                found.append((replace(one, alignment=in_whole(one.alignment, first, second)), first))
            if strips and settled(found, self.chance - more):
                break
        return self._best(distinct_of_pieces(found), more)[0]

    def _search(
        self, reference: Image, secondary: Image, scales: Sequence[float], outstanding: float
    ) -> list[Verified]:
        """Verified alignments at some ratios of the scales; none where the best is not better by a factor."""
        grid = Grid(self.side, self.rotation_step, scales, self.least_overlap)
        with stage("search"):
            starts = search(reference, secondary, grid, self.candidates, self._correlator())
        if not starts or (len(starts) > 1 and starts[0].score < outstanding * starts[1].score):
            return []
        with stage("verify"):
            return verified(reference, secondary, starts)

    def _correlator(self) -> Correlator | None:
        if self.backend == "numpy":
            if self.device is not None:
                raise ParameterError(f"device {self.device!r} needs backend='torch'")
            return None
        from featreg.interop.torch_orientation import TorchCorrelator

        return TorchCorrelator(self.device or "auto")

    def _best(self, judged: Sequence[Verified], more: float = 0.0) -> tuple[Alignment | None, bool]:
        """The alignment for which windows speak most, None where that is chance, `more` powers of ten of it, or another
        has as much; and whether that is why.
        """
        if not judged:
            return None, False
        best = judged[0].log10_chance
        rival = judged[1].log10_chance if len(judged) > 1 else 0.0
        if best > self.chance - more:
            logger.info("no tie points: the windows of the best alignment agree as by chance (1e%.1f)", best)
            return None, False
        if rival < self.ambiguity * best:
            logger.info("no tie points: the windows of two alignments agree (1e%.1f and 1e%.1f by chance)", best, rival)
            return None, True
        return judged[0].alignment, False

    def _tie_points(
        self, reference: Image, secondary: Image, alignment: Alignment, first: float = FINE_SIDE
    ) -> Matches:
        """Follow an alignment to full resolution; the windows of the finest level are the tie points."""
        part = shared_part(reference, secondary, alignment.affine)
        reference, affine = part.image, in_part(alignment.affine, part)
        finest = max(reference.shape) * min(1.0, alignment.scale)
        # A strip has room for two windows across.
        samples = min(max(first, 2 * self.window * max(reference.shape) / min(reference.shape)), finest)
        while True:
            level = aligned(reference, secondary, affine, samples, self.alpha)
            found = correlated(level, self.window, self.search, self._step(level))
            found = with_coarser(reference, secondary, level, found, samples, self.alpha)
            seen = peaks(found.values.astype(np.float64))
            if samples >= finest:
                matches = self._matches(level, found, seen)
                return replace(matches, reference_xy=matches.reference_xy + np.array(part.corner))
            affine = _corrected(level, found, seen)
            samples = min(FINER * samples, finest)

    def _step(self, level: Level) -> int:
        """Distance of neighbouring windows, samples."""
        least = max(1, round((1 - self.overlapping) * self.window))
        return max(least, math.ceil(math.sqrt(np.count_nonzero(level.valid) / self.most)))

    def _matches(self, level: Level, found: Surfaces, seen: Peaks) -> Matches:
        sound: BoolArray = seen.sound & (seen.height > 0)
        good = np.flatnonzero(sound)
        height = seen.height[good]
        here = level.reference_xy(found.xy[good])
        there = level.secondary_xy(found.xy[good] + seen.shift[good])
        covariance = peak_covariances(found.parts, found.xy[good], found.values[good], seen.take(sound))
        onto = level.affine[:, :2] / level.factor
        return Matches(here, there, height, onto @ covariance @ onto.T)


def _corrected(level: Level, found: Surfaces, seen: Peaks) -> FloatArray:
    """The alignment after a robust fit to what the windows of a level say; as it was where they say too little.

    It stays a similarity unless the windows, those that do not overlap, say more of an affine one than chance.
    """
    good: BoolArray = seen.sound & (seen.height > 0)
    here, there = found.xy[good], found.xy[good] + seen.shift[good]
    fits: list[Model] = []
    for kind, least in ((Similarity, LEAST_SIMILAR), (Affine, LEAST_AFFINE)):
        if len(here) < least:
            continue
        model, weights = irls(kind, here, there, weights=seen.height[good] ** 2, scale_px=SCALE, iterations=5)
        if not isinstance(model, FailedFit) and np.count_nonzero(weights) >= least:
            fits.append(model)
    if len(fits) == 2:
        beyond = ((fits[1](here) - fits[0](here)) ** 2).sum(axis=1).mean()
        # The median of the squared length of two Gaussian errors is 2 ln 2 times the variance of each.
        variance = np.median(fits[1].residuals(here, there) ** 2) / (2 * math.log(2))
        if beyond < SURE * 2 * variance * found.side**2 / np.count_nonzero(level.valid):
            fits.pop()
    return level.affine if not fits or fits[-1].matrix is None else level.moved(fits[-1].matrix[:2])


def _linearised(model: Model, shape: tuple[int, int]) -> FloatArray | None:
    """The (2, 3) affine map nearest to a model over an image of (H, W); None where it is not known well enough."""
    x, y = np.meshgrid(*(np.linspace(0, n - 1, 5) for n in shape[::-1]))
    lattice = np.column_stack([x.ravel(), y.ravel()])
    there = model(lattice)
    good = np.isfinite(there).all(axis=1)
    affine = Affine.from_estimate(lattice[good], there[good])
    return None if isinstance(affine, FailedFit) else affine.matrix[:2]
