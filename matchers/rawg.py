"""RAWG: templates of angle-weighted ratio gradients, sought around where a model known beforehand says."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Interval, Lt

from featreg import registry
from featreg.geometry import Affine, Similarity
from featreg.geometry.cells import cells
from featreg.geometry.robust import fit_consensus
from featreg.interfaces import FailedFit, Matcher, Model, Plugin
from featreg.pipeline.aligned import shared_pixels, warped
from featreg.pipeline.inputs import local_scale
from featreg.pipeline.trust_measures import log10_chance
from featreg.registry import register
from featreg.runtime.parameters import Count, Positive, Share
from featreg.runtime.timing import stage
from featreg.sar.gradients.angle_weighted import angle_weighted_channels, median_length, smoothing_reach
from featreg.sar.gradients.gradient_field import GradientField, ratio_field
from featreg.sar.gradients.ratio import FLOOR
from featreg.sar.merged_regions import merged_regions
from featreg.sar.speckle import filled_amplitude
from featreg.sar.template_correlation import best_places
from featreg.types import BoolArray, FloatArray, Image, IntArray, Matches, read_only

logger = logging.getLogger(__name__)

#: Templates of other places agree on an alignment where they overlap by more than this share of their side.
INDEPENDENT = 0.5
#: Distance from an alignment within which templates speak for it, px.
WITHIN = 3.0
#: A secondary that shrinks by more than this is smoothed first, standard deviation in px.
LEAST_BLUR = 0.1


@register("angle-weighted-templates")
@dataclass(frozen=True)
class AngleWeightedTemplates(Matcher):
    """Tie points by templates of angle-weighted ratio gradients, of images that are aligned to some pixels (RAWG).

    Parameters
    ----------
    detector : name of the detector that gives the templates' middles
    points : about so many templates
    alpha : exponential weight of the ROEWA gradients, the same for both images, px of the reference
    channels : directions, of half a turn, on which gradients are shared out
    smoothing : standard deviation of the Gaussian that smooths each channel, px; 0 for none
    template : side of a template, px; odd ones are whole, even ones a pixel larger
    search : largest displacement that is sought along x and y, px of the reference; as far as the search radius of
        a model known beforehand where that is more
    apart : correlations within so many pixels of the peak along x and y belong to it
    ratio : a template is left out where another place has more than this share of its correlation
    merge : templates whose common rectangle has at most so many pixels share their channels
    chance : log10 of the expected number of alignments as good by chance, at most; else there are no tie points

    Raises
    ------
    ParameterError
        An impossible value.

    Notes
    -----
    "A high-precision matching method for heterogeneous SAR images based on ROEWA and angle-weighted gradient", Remote
    Sensing 17 (2025) 749, written afresh from its abstract and its headings and, for what is called efficient feature
    construction there, from the steps of section 2.5. As published: points of the reference by a block-based SAR-Harris
    operator, gradients by a single-scale ROEWA operator, gradients shared on channels by angle, template matching in
    the frequency domain within an area that the platform's geolocation gives, non-maximum suppression of the
    correlation, and templates that lie together in one region. The sharing is that of AWOG (Fan et al. 2021).

    Not known, and so ours: every number; the normalisation of the channels (`featreg.sar.gradients.angle_weighted`);
    the normalised correlation coefficient as the measure; that suppression is by the best place elsewhere; the position
    between the pixels, by a quadratic; and how the paper leaves out wrong tie points. A part of an image's
    gradients is computed for the whole image, since the detector needs them there, and the channels for the regions.

    The method forgives no rotation and no scale: the secondary's amplitude is resampled on the reference's grid by the
    model known beforehand. Without one both images are taken to lie on one grid to within `search`.

    Where a search is narrow, wrong templates agree easily. So as many of them as do not much overlap must agree on a
    similarity better than chance (`featreg.pipeline.trust_measures.log10_chance` over the area of the search).

    References
    ----------
    DOI 10.3390/rs17050749; Z. Fan, L. Zhang, Y. Liu, Q. Wang, S. Zlatanova, Remote Sensing 13 (2021) 3535, DOI
    10.3390/rs13173535; R. Fjortoft et al., IEEE TGRS 36 (1998) 793, DOI 10.1109/36.673672
    """

    detector: str = "block-sar-harris"
    points: Count = 225
    alpha: Positive = 1.0
    channels: Annotated[int, Interval(ge=3, le=36)] = 6
    smoothing: Annotated[float, Interval(ge=0, le=20)] = 0.8
    template: Annotated[int, Ge(9)] = 96
    search: Annotated[int, Ge(4)] = 20
    apart: Annotated[int, Ge(1)] = 6
    ratio: Share = 0.9
    merge: Count = 262_144
    chance: Annotated[float, Lt(0)] = -4.0

    @property
    def parts(self) -> tuple[Plugin, ...]:
        return (self._detector(),)

    @property
    def reach(self) -> float:
        """Half a template, the support of its gradients and of their smoothing."""
        return self.template / 2 + 4 * self.alpha + smoothing_reach(self.smoothing)

    @property
    def taken_for_granted(self) -> str:
        return (
            f"without a model known beforehand both images are taken to lie on one grid to within {self.search} px: "
            "give 'initial' and 'search_radius' where they do not"
        )

    def match(self, reference: Image, secondary: Image) -> Matches:
        """As `match_near` around the identity, as far as `search` reaches."""
        return self.match_near(reference, secondary, Affine(np.array([[1.0, 0, 0], [0, 1, 0]])), 0.0)

    def match_near(self, reference: Image, secondary: Image, initial: Model, radius: float) -> Matches:
        """Return one tie point per template that has one good place; empty where these agree as by chance only."""
        height, width = reference.shape
        scale = local_scale(initial, (width / 2, height / 2))
        if not scale:
            return Matches.empty()
        reach = min(max(self.search, math.ceil(radius / scale)), max(reference.shape))
        with stage("detect"):
            xy = np.rint(self._detector().detect_features(reference).xy).astype(np.int64)
        with stage("align"):
            aligned = _on_grid(secondary, initial, scale, reference)
        with stage("templates"):
            rows, shift, correlation = self._places(reference, aligned, xy, reach)
        here = xy[rows].astype(np.float64)
        if not self._more_than_chance(Matches(here, here + shift, correlation), 2 * reach + 1):
            return Matches.empty()
        return Matches(here, initial(here + shift), correlation)

    def _detector(self) -> Any:
        known = registry.entry("detector", self.detector).parameters
        wanted = {"n_features": self.points, "support": float(self._half)}
        return registry.create("detector", self.detector, **{k: v for k, v in wanted.items() if k in known})

    @property
    def _half(self) -> int:
        return self.template // 2

    def _places(
        self, reference: Image, aligned: Image, xy: IntArray, reach: int
    ) -> tuple[IntArray, FloatArray, FloatArray]:
        """Rows of (N, 2) pixels of the reference whose templates have one good place, displacement and correlation."""
        half, room = self._half, np.array(reference.shape[::-1])
        fields = [ratio_field(image, self.alpha, FLOOR) for image in (reference, aligned)]
        weak = [median_length(field) for field in fields]
        inside = np.flatnonzero(((xy >= half) & (xy < room - half)).all(axis=1))
        rows, shift, height = np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros(0)
        if not all(weak):
            return rows, shift, height
        for group in merged_regions(xy[inside], 2 * (half + reach) + 1, self.merge, reference.shape):
            some = inside[group]
            low, high = xy[some].min(axis=0) - half, xy[some].max(axis=0) + half + 1
            here = self._channels(fields[0], weak[0], low, high)
            there = self._channels(fields[1], weak[1], low - reach, high + reach)
            places = best_places(here, there, xy[some] - half - low, 2 * half + 1, reach, self.apart)
            peaks = places.peaks
            good = peaks.sound & (peaks.height > 0) & (places.runner_up <= self.ratio)
            rows = np.concatenate([rows, some[good]])
            shift, height = np.concatenate([shift, peaks.shift[good]]), np.concatenate([height, peaks.height[good]])
        order = np.argsort(rows)
        return rows[order], shift[order], height[order]

    def _channels(self, field: GradientField, weak: float, low: IntArray, high: IntArray) -> Any:
        """The channels of a field from (x, y) `low` to before `high`; 0 beyond the image."""
        height, width = field.x.shape
        margin = smoothing_reach(self.smoothing)
        (left, top), (right, bottom) = low, high
        y0, y1 = max(0, top - margin), min(height, bottom + margin)
        x0, x1 = max(0, left - margin), min(width, right + margin)
        out = np.zeros((self.channels, bottom - top, right - left), np.float32)
        if y0 >= y1 or x0 >= x1:
            return out
        part = GradientField(field.x[y0:y1, x0:x1], field.y[y0:y1, x0:x1])
        made = angle_weighted_channels(part, self.channels, self.smoothing, weak)
        v0, v1, u0, u1 = max(top, 0), min(bottom, height), max(left, 0), min(right, width)
        out[:, v0 - top : v1 - top, u0 - left : u1 - left] = made[:, v0 - y0 : v1 - y0, u0 - x0 : u1 - x0]
        return out

    def _more_than_chance(self, found: Matches, side: int) -> bool:
        """Whether templates that overlap little agree on a similarity, of displacements in a square of a side in px."""
        order = np.argsort(-found.score, kind="stable")
        _, first = np.unique(cells(found.reference_xy[order], INDEPENDENT * self.template), return_index=True)
        alone = found.take(order[first])
        rng = np.random.default_rng(0)
        model, near = fit_consensus(
            Similarity, alone.reference_xy, alone.secondary_xy, threshold=WITHIN, rng=rng, iterations=400
        )
        if isinstance(model, FailedFit):
            logger.info("no tie points: %d of %d templates say nothing in common", len(found), self.points)
            return False
        everything = np.ones(len(alone), np.bool_)
        chance = log10_chance(alone, everything, near, model, (side, side))
        if chance > self.chance:
            logger.info("no tie points: the templates agree as by chance (1e%.1f)", chance)
        return chance <= self.chance


def _on_grid(secondary: Image, model: Model, scale: float, reference: Image) -> Image:
    """The amplitude of the secondary on the reference's grid; valid where both images are."""
    import cv2

    filled = filled_amplitude(secondary)
    # What shrinks is smoothed first, as much as it shrinks.
    blur = 0.5 * math.sqrt(max(scale**2 - 1, 0.0))
    if blur > LEAST_BLUR:
        filled = np.asarray(cv2.GaussianBlur(filled, (0, 0), blur, borderType=cv2.BORDER_REPLICATE), np.float32)
    shape = reference.shape
    pixels = warped(filled, model, shape, cv2.INTER_LINEAR, cv2.BORDER_REPLICATE)
    mask: BoolArray = shared_pixels(reference, secondary, model)
    return Image(read_only(np.asarray(pixels * mask, np.float32)), read_only(mask))
