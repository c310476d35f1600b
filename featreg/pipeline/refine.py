"""Refinement: after a first model, guided sub-pixel tie points by local correlation, for every method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Interval
from numpy.typing import NDArray

from featreg.geometry.robust import irls
from featreg.interfaces import FailedFit, Model
from featreg.pipeline.aligned import MARGIN, WholeWindows, halved, peak_covariance, resampled, variance_factor
from featreg.runtime.parameters import Positive, checked
from featreg.sar.bridging import on_sample
from featreg.sar.correlation import Peaks, local_correlations, peaks
from featreg.sar.speckle import despeckled
from featreg.types import BoolArray, FloatArray, Image, IntArray, Matches

F32 = NDArray[np.float32]

# Points measured in the first pass, and rounds of each robust fit.
SAMPLE = 1000
ROUNDS = 6


@dataclass(frozen=True, eq=False)
class Refined:
    """What a refinement found.

    Parameters
    ----------
    matches : the new tie points, all within the residual limit of the model; `origin` names the match they came from
    model : fitted to them, or why not
    candidates : how many points were looked at
    correlated : how many of these had a sound correlation peak
    measured : those with a sound peak, also what the fit left out; by them the fit is judged
    """

    matches: Matches
    model: Model | FailedFit
    candidates: int
    correlated: int
    measured: Matches = field(default_factory=Matches.empty)


@checked("refine")
@dataclass(frozen=True)
class Refine:
    """Correlate the aligned images around the points that were detected, and fit the model again.

    Parameters
    ----------
    half : half the correlation window, px; it is 2 * half + 1 wide
    sigma : of the Gaussian that smooths the log-amplitude, px
    search : largest shift looked for around the first model, px; around the second it is 2
    min_correlation : least height of a peak
    max_residual : largest distance of a kept tie point from the final model, px
    least_share : share of the points looked at that must be kept, or the refinement is not used

    Notes
    -----
    The secondary's despeckled log-amplitude is warped by the model onto the reference, so that windows need no
    resampling of their own. A first pass at half size finds shifts up to `search`, the model is fitted again, and a
    second pass at full size gives the positions. Points are those of the matches, filled up to the budget by the
    strongest gradient of each cell of a regular grid, so that the tie points spread over the image. The covariance of a
    tie point is (1 - rho^2) times the inverse curvature of its peak, times one variance factor for all, estimated
    from the residuals.
    """

    half: Annotated[int, Ge(4)] = 24
    sigma: Positive = 1.0
    search: Annotated[int, Ge(2)] = 6
    min_correlation: Annotated[float, Interval(gt=0, lt=1)] = 0.35
    max_residual: Annotated[float, Gt(0)] = 1.0
    least_share: Annotated[float, Interval(ge=0, le=1)] = 0.15

    @property
    def reach(self) -> int:
        """How far from a tie point pixels are looked at, px."""
        return self.half + MARGIN + self.search

    def least(self, candidates: int) -> int:
        """Fewest refined tie points, of so many looked at, for a refinement that is worth using."""
        return max(30, round(self.least_share * candidates))

    def run(self, reference: Image, secondary: Image, model: Model, matches: Matches, n_features: int) -> Refined:
        """Return at most `n_features` refined tie points around `model`; empty where the images do not correlate."""
        kind = type(model)
        none = Refined(Matches.empty(), FailedFit("no window of the two images correlates"), 0, 0)
        if min(reference.shape) < 4 * self.half:
            return none
        here, there = despeckled(reference, self.sigma), despeckled(secondary, self.sigma)
        aligned = resampled(there, model, reference.shape)
        small = halved(here), halved(aligned)
        usable = WholeWindows(reference, secondary, model, self.half)
        seeds, origin = self._seeds(small[0], usable, matches, n_features)
        # Pass one: at half size, a sample of the points.
        some = seeds[:: max(1, len(seeds) // SAMPLE)]
        coarse = self._measure(small[0], small[1], some // 2, self.half // 2, (self.search + 1) // 2)
        first, _, _ = self._fit(kind, model, some, 2 * coarse.shift, coarse)
        if isinstance(first, FailedFit):
            return none
        # Pass two: at full size around the better model.
        if _distance(first, model, reference.shape) > 1:
            inside = WholeWindows(reference, secondary, first, self.half)(seeds)
            seeds, origin = seeds[inside], origin[inside]
        aligned = resampled(there, first, reference.shape)
        fine = self._measure(here, aligned, seeds, self.half, 2)
        final, there_xy, keep = self._fit(kind, first, seeds, fine.shift, fine)
        if isinstance(final, FailedFit):
            return none
        here_xy = seeds.astype(np.float64)
        peaked = fine.sound & (fine.height >= self.min_correlation)
        measured = Matches(here_xy[peaked], there_xy[peaked], fine.height[peaked])
        correlated = int(keep.sum())
        keep &= final.residuals(here_xy, there_xy) <= self.max_residual
        keep &= on_sample(there_xy, secondary)
        here_xy, there_xy = here_xy[keep], there_xy[keep]
        found = fine.take(keep)
        covariance = peak_covariance(found, first, here_xy)
        covariance *= variance_factor(there_xy - final(here_xy), covariance)
        refined = Matches(here_xy, there_xy, found.height, covariance, origin[keep])
        return Refined(refined, final, len(seeds), correlated, measured)

    def _measure(self, first: F32, second: F32, at: IntArray, half: int, search: int) -> Peaks:
        height, width = first.shape
        reach = half + search + 1
        inside = ((at >= reach) & (at < np.array([width, height]) - reach)).all(axis=1)
        side = 2 * search + 1
        found = np.zeros((len(at), side, side))
        found[inside] = local_correlations(first, second, at[inside], half, search)
        return peaks(found)

    def _fit(
        self, kind: type[Model], around: Model, seeds: IntArray, shift: FloatArray, found: Peaks
    ) -> tuple[Model | FailedFit, FloatArray, BoolArray]:
        """Robust fit weighted by the inverse variance of the peaks: model, secondary points, and which it used."""
        usable = found.sound & (found.height >= self.min_correlation)
        here = seeds.astype(np.float64)
        there = around(here + shift)
        if usable.sum() < max(3 * kind.minimum, 8):
            return FailedFit(f"only {int(usable.sum())} of {len(seeds)} windows correlate"), there, usable
        c = found.curvature
        sharpness = np.sqrt(np.maximum(c[:, 0, 0] * c[:, 1, 1] - c[:, 0, 1] ** 2, 0))
        prior = np.where(usable, sharpness / np.maximum(1 - found.height**2, 1e-3), 0.0)
        model, weights = irls(kind, here, there, weights=prior / prior.max(), scale_px=0.05, iterations=ROUNDS)
        return model, there, usable & (weights > 0)

    def _seeds(
        self, small: F32, usable: Callable[[IntArray], BoolArray], matches: Matches, budget: int
    ) -> tuple[IntArray, IntArray]:
        """Whole-pixel points to look at, without repeats: those of the matches first, then a fill-in of (-1) points."""
        height, width = 2 * small.shape[0], 2 * small.shape[1]
        at = np.clip(np.rint(matches.reference_xy), 0, [width - 1, height - 1]).astype(np.int64)
        good = usable(at)
        at, origin = at[good], np.flatnonzero(good)
        missing = budget - len(at)
        if missing > 0:
            fill = 2 * strongest_of_cells(small, missing, (self.half + MARGIN) // 2)
            fill = fill[usable(fill)]
            at, origin = np.concatenate([at, fill]), np.concatenate([origin, np.full(len(fill), -1)])
        _, first = np.unique(at[:, 1] * width + at[:, 0], return_index=True)
        first = np.sort(first)[:budget]
        return at[first], origin[first]


def strongest_of_cells(view: F32, count: int, margin: int) -> IntArray:
    """The pixel of strongest gradient in each cell of a regular grid of about `count` cells inside the margin."""
    import cv2

    height, width = view.shape
    y0, y1, x0, x1 = margin, height - margin, margin, width - margin
    side = max(1, int(np.sqrt(max(0, (y1 - y0) * (x1 - x0)) / max(count, 1))))
    rows, cols = (y1 - y0) // side, (x1 - x0) // side
    if rows < 1 or cols < 1:
        return np.zeros((0, 2), np.int64)
    strength = cv2.magnitude(cv2.Sobel(view, cv2.CV_32F, 1, 0), cv2.Sobel(view, cv2.CV_32F, 0, 1))
    strength = strength[y0 : y0 + rows * side, x0 : x0 + cols * side]
    cells = strength.reshape(rows, side, cols, side).swapaxes(1, 2).reshape(rows, cols, side * side)
    best = cells.argmax(axis=2)
    y = y0 + np.arange(rows)[:, None] * side + best // side
    x = x0 + np.arange(cols)[None, :] * side + best % side
    return np.column_stack([x.ravel(), y.ravel()]).astype(np.int64)


def _distance(first: Model, second: Model, shape: tuple[int, int]) -> float:
    """Largest distance in pixels between two models at the corners of the reference."""
    height, width = shape
    corners = np.array([[0, 0], [width - 1, 0], [0, height - 1], [width - 1, height - 1]], np.float64)
    return float(np.hypot(*(first(corners) - second(corners)).T).max())
