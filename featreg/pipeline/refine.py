"""Refinement: after a first model, guided sub-pixel tie points by local correlation, for every method."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Interval
from numpy.typing import NDArray

from featreg.geometry.overlapping import share_taken_up
from featreg.geometry.robust import irls
from featreg.interfaces import FailedFit, Model
from featreg.pipeline.aligned import (
    MARGIN,
    WholeWindows,
    halved,
    local_affines,
    peak_covariance,
    resampled,
    variance_factor,
)
from featreg.runtime.parameters import Positive, checked
from featreg.runtime.threads import in_parts, side_by_side
from featreg.sar.bridging import on_sample
from featreg.sar.correlation import Peaks, local_correlations, peaks, peaks_near, peaks_uphill
from featreg.sar.correlation_filter import (
    SIDE,
    CorrelationFilter,
    correlation_filter,
    filter_of_squares,
    square_corners,
)
from featreg.sar.gradients.lengths import lengths
from featreg.sar.pyramid import reduced
from featreg.sar.speckle import despeckled, despeckled_halved, log_amplitude
from featreg.sar.windows import as_map, compact, few, places, windows_of_both
from featreg.types import BoolArray, FloatArray, Image, IntArray, Matches

F32 = NDArray[np.float32]

# Points measured in the first pass, and rounds of each robust fit.
SAMPLE = 1000
ROUNDS = 6
# Largest shift that the second pass looks at, px; a peak lies inside that.
FINE = 2
# The filter before the second pass looks about so many pixels beyond a window.
FILTER_MARGIN = 2
# Windows of two places that tell how high peaks are by chance: most of them, the fewest that tell, and the height, of a
# filtered window of the usual size, that chance alone must not be taken to reach.
MOST_CHANCE, LEAST_CHANCE, LEAST_HEIGHT = 200, 30, 0.1
# The grid that fills points up has at most so many times as many cells as are wanted, however little is valid.
MOST_CELLS = 20


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
    sigma : of the Gaussian that smooths the log-amplitude before the first pass, px
    search : largest shift looked for around the first model, px; around the second it is 2
    min_correlation : least height of a peak of the first pass
    by_chance : share of windows of two different places with a peak as high as that of a tie point must be
    max_residual : largest distance of a kept tie point from the final model, px
    least_share : share of the points looked at that must be kept, or the refinement is not used

    Notes
    -----
    The secondary's log-amplitude is warped by the model onto the reference, so that windows need no resampling of their
    own. A first pass at half size finds shifts up to `search`, and the model is fitted again; a model that was fitted
    to located matches needs none. A second pass at full size gives the positions. Before it both images are filtered by
    what they have in common at each frequency (`featreg.sar.correlation_filter`): two dates of one look that show the
    same targets are sharpened, fresh speckle and years of change are smoothed. How high a peak must be, windows of
    different places of the same two images tell. Points are those of the matches, filled up to the budget by the
    strongest gradient of each cell of a regular grid, so that the tie points spread over the image. The covariance of a
    tie point is (1 - rho^2) times the inverse curvature of its peak, times one variance factor for all, estimated
    from the residuals and what the fit to overlapping windows takes of them (`featreg.geometry.overlapping`).
    """

    half: Annotated[int, Ge(4)] = 24
    sigma: Positive = 1.0
    search: Annotated[int, Ge(2)] = 6
    min_correlation: Annotated[float, Interval(gt=0, lt=1)] = 0.35
    by_chance: Annotated[float, Interval(gt=0, lt=1)] = 0.05
    max_residual: Annotated[float, Gt(0)] = 1.0
    least_share: Annotated[float, Interval(ge=0, le=1)] = 0.15

    @property
    def reach(self) -> int:
        """How far from a tie point pixels are looked at, px."""
        return self.half + FILTER_MARGIN + MARGIN + self.search

    def least(self, candidates: int) -> int:
        """Fewest refined tie points, of so many looked at, for a refinement that is worth using."""
        return max(30, round(self.least_share * candidates))

    def run(
        self, reference: Image, secondary: Image, model: Model, matches: Matches, n_features: int, *, near: bool = False
    ) -> Refined:
        """Return at most `n_features` refined tie points around `model`; empty where the images do not correlate.

        `near` says that the model is right to about a pixel, so that no first pass is needed.
        """
        kind = type(model)
        none = Refined(Matches.empty(), FailedFit("no window of the two images correlates"), 0, 0)
        if min(reference.shape) < 4 * self.half:
            return none
        usable = WholeWindows(reference, secondary, model, self.half + FILTER_MARGIN)
        seeds, origin = self._seeds(reference, usable, matches, n_features)
        first = model if near else self._first_pass(reference, secondary, model, seeds)
        if isinstance(first, FailedFit):
            return none
        if _distance(first, model, reference.shape) > 1:
            inside = WholeWindows(reference, secondary, first, self.half + FILTER_MARGIN)(seeds)
            seeds, origin = seeds[inside], origin[inside]
        views = self._views(reference, secondary, first, seeds)
        if views is None:
            return none
        view, aligned, at = views
        fine = peaks_near(view, aligned, at, self.half, FINE - 1)
        least = self._height_by_chance(view, aligned, seeds, at)
        final, there_xy, keep = self._fit(kind, first, seeds, fine.shift, fine, least)
        if isinstance(final, FailedFit):
            return none
        here_xy = seeds.astype(np.float64)
        peaked = fine.sound & (fine.height >= least)
        measured = Matches(here_xy[peaked], there_xy[peaked], fine.height[peaked])
        correlated = int(keep.sum())
        keep &= final.residuals(here_xy, there_xy) <= self.max_residual
        keep &= on_sample(there_xy, secondary)
        here_xy, there_xy = here_xy[keep], there_xy[keep]
        found = fine.take(keep)
        covariance = peak_covariance(found, first, here_xy)
        lost = share_taken_up(final, here_xy, there_xy, 2 * self.half + 1)
        covariance *= variance_factor(there_xy - final(here_xy), covariance) / (1 - lost)
        refined = Matches(here_xy, there_xy, found.height, covariance, origin[keep])
        return Refined(refined, final, len(seeds), correlated, measured)

    def _views(
        self, reference: Image, secondary: Image, model: Model, seeds: IntArray
    ) -> tuple[F32, F32, IntArray] | None:
        """Both images filtered on the reference's grid, and where in these the points are; None where nothing agrees.

        Of a large image only the windows around the points are made, one below the other.
        """
        around = self.half + FINE + 1
        side = 2 * around + 1
        maps = local_affines(model, seeds.astype(np.float64)) if few(len(seeds), side, reference.shape) else None
        if maps is not None and len(maps) and compact(maps).all():
            best = self._filter(reference, secondary, model)
            if best is None:
                return None
            view, aligned = windows_of_both(
                reference, secondary, maps, seeds - around, seeds - around, side, filtered=best.taps
            )
            return as_map(view), as_map(aligned), places(len(seeds), side, around)
        view, aligned = side_by_side(
            [
                lambda: log_amplitude(reference),
                lambda: resampled(log_amplitude(secondary), model, reference.shape),
            ]
        )
        best = correlation_filter(view, aligned, _shared_squares(reference, secondary, model))
        if best is None:
            return None
        view, aligned = side_by_side([partial(best.applied, part, centred=True) for part in (view, aligned)])
        return view, aligned, seeds

    def _filter(self, reference: Image, secondary: Image, model: Model) -> CorrelationFilter | None:
        """The filter of two images, from squares that are whole in both."""
        corners = _shared_squares(reference, secondary, model)
        maps = local_affines(model, corners.astype(np.float64) + SIDE // 2)
        # One far corner in which a model bends too much tells nothing of the others.
        narrow = compact(maps)
        corners, maps = corners[narrow], maps[narrow]
        if not len(corners):
            return None
        return filter_of_squares(*windows_of_both(reference, secondary, maps, corners, corners, SIDE))

    def _first_pass(self, reference: Image, secondary: Image, model: Model, seeds: IntArray) -> Model | FailedFit:
        """The model fitted to shifts at half size, of a sample of the points."""
        small, shape = despeckled_halved(reference, self.sigma), reference.shape
        aligned = halved(resampled(despeckled(secondary, self.sigma), model, shape))
        some = seeds[:: max(1, len(seeds) // SAMPLE)]
        coarse = self._measure(small, aligned, some // 2, self.half // 2, (self.search + 1) // 2)
        return self._fit(type(model), model, some, 2 * coarse.shift, coarse, self.min_correlation)[0]

    def _height_by_chance(self, first: F32, second: F32, seeds: IntArray, at: IntArray) -> float:
        """The height that few peaks of windows of two different places reach; `at` is where points are in the maps."""
        step = max(1, -(-len(seeds) // MOST_CHANCE))
        some, at = seeds[::step], at[::step]
        other = np.roll(some, len(some) // 2, axis=0)
        apart = (np.abs(some - other) > 2 * self.half + 1).any(axis=1)
        if apart.sum() < LEAST_CHANCE:
            return self.min_correlation
        there = np.roll(at, len(at) // 2, axis=0)[apart]
        found = peaks_uphill(first, second, at[apart], there, np.zeros_like(there), self.half, FINE - 1)
        return max(LEAST_HEIGHT, float(np.quantile(found.height, 1 - self.by_chance)))

    def _measure(self, first: F32, second: F32, at: IntArray, half: int, search: int) -> Peaks:
        height, width = first.shape
        reach = half + search + 1
        inside = ((at >= reach) & (at < np.array([width, height]) - reach)).all(axis=1)
        side = 2 * search + 1
        found = np.zeros((len(at), side, side))
        found[inside] = local_correlations(first, second, at[inside], half, search)
        return peaks(found)

    def _fit(
        self, kind: type[Model], around: Model, seeds: IntArray, shift: FloatArray, found: Peaks, least: float
    ) -> tuple[Model | FailedFit, FloatArray, BoolArray]:
        """Robust fit weighted by the inverse variance of the peaks: model, secondary points, and which it used."""
        usable = found.sound & (found.height >= least)
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
        self, reference: Image, usable: WholeWindows, matches: Matches, budget: int
    ) -> tuple[IntArray, IntArray]:
        """Whole-pixel points to look at, without repeats: those of the matches first, then a fill-in of (-1) points."""
        height, width = reference.shape
        at = np.clip(np.rint(matches.reference_xy), 0, [width - 1, height - 1]).astype(np.int64)
        good = usable(at)
        at, origin = at[good], np.flatnonzero(good)
        missing = budget - len(at)
        if missing > 0:
            small = despeckled(reduced(reference, 0.5), self.sigma / 2)
            # So many are to lie in what is valid, not in the frame around it.
            cells = round(missing / max(usable.share, 1 / MOST_CELLS))
            fill = 2 * strongest_of_cells(small, cells, (self.half + MARGIN) // 2)
            fill = fill[usable(fill)]
            at, origin = np.concatenate([at, fill]), np.concatenate([origin, np.full(len(fill), -1)])
        _, first = np.unique(at[:, 1] * width + at[:, 0], return_index=True)
        first = np.sort(first)
        if len(first) > budget:
            # Cells are whole pixels wide and may be more than are wanted: some of every part of the image are left out.
            own, filled = np.split(first, [int(np.searchsorted(first, np.count_nonzero(good)))])
            left = max(0, budget - len(own))
            first = np.concatenate([own, filled[np.arange(left) * len(filled) // max(left, 1)]])[:budget]
        return at[first], origin[first]


def _shared_squares(reference: Image, secondary: Image, model: Model) -> IntArray:
    """(N, 2) upper left corners of squares that are whole in both images."""
    half = SIDE // 2
    corners = square_corners(reference.shape)
    return corners[WholeWindows(reference, secondary, model, half - MARGIN)(corners + half)]


def strongest_of_cells(view: F32, count: int, margin: int) -> IntArray:
    """The pixel of strongest gradient in each cell of a regular grid of about `count` cells inside the margin."""
    import cv2

    height, width = view.shape
    y0, y1, x0, x1 = margin, height - margin, margin, width - margin
    side = max(1, int(np.sqrt(max(0, (y1 - y0) * (x1 - x0)) / max(count, 1))))
    rows, cols = (y1 - y0) // side, (x1 - x0) // side
    if rows < 1 or cols < 1:
        return np.zeros((0, 2), np.int64)
    best = np.empty((rows, cols), np.int64)

    def part(first: int, stop: int) -> None:
        for row in range(first, stop):
            top = y0 + row * side
            # One row more on either side, where there is one, tells the gradient of the outer ones.
            above = max(top - 1, 0)
            some = view[above : min(top + side + 1, height)]
            strength = lengths(cv2.Sobel(some, cv2.CV_32F, 1, 0), cv2.Sobel(some, cv2.CV_32F, 0, 1))
            cells = strength[top - above : top - above + side, x0 : x0 + cols * side].reshape(side, cols, side)
            best[row] = cells.swapaxes(0, 1).reshape(cols, side * side).argmax(axis=1)

    in_parts(part, rows, side * width)
    y = y0 + np.arange(rows)[:, None] * side + best // side
    x = x0 + np.arange(cols)[None, :] * side + best % side
    return np.column_stack([x.ravel(), y.ravel()]).astype(np.int64)


def _distance(first: Model, second: Model, shape: tuple[int, int]) -> float:
    """Largest distance in pixels between two models at the corners of the reference."""
    height, width = shape
    corners = np.array([[0, 0], [width - 1, 0], [0, height - 1], [width - 1, height - 1]], np.float64)
    return float(np.hypot(*(first(corners) - second(corners)).T).max())
