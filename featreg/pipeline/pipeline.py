"""From two images to a registration: a matcher, filters, a model, refinement and trust, each replaceable."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from featreg.errors import ParameterError
from featreg.geometry import inverse_variances
from featreg.geometry.robust import irls
from featreg.interfaces import FailedFit, Filter, FilterContext, Matcher, Model
from featreg.pipeline.refine import Refine, Refined
from featreg.pipeline.trust import Evidence, Limits, assess
from featreg.results.registration import Registration
from featreg.runtime.timing import collecting, stage
from featreg.types import BoolArray, FloatArray, Gate, Image, IntArray, Matches

# Errors below this, in pixels, are not told apart by the robust fit.
SCALE_PX = 0.3
# Rounds of the robust fit; the consensus before it is near the answer.
ROUNDS = 3


@dataclass(frozen=True, eq=False)
class Gathered:
    """What has been done block by block already, and is not done again over all.

    Parameters
    ----------
    stages : name -> (M,) bool of the filters that ran, in their order
    refine : from the first model to the refined tie points, or None where there are none
    chance_shape : (H, W) of the area of the secondary over which a wrong match may lie
    gates : further gates, of the final tie points and their model
    """

    stages: Mapping[str, BoolArray]
    refine: Callable[[Model], Refined] | None
    chance_shape: tuple[int, int]
    gates: Callable[[Matches, BoolArray, Model], Mapping[str, Gate]]


@dataclass(frozen=True)
class Pipeline:
    """A whole method, ready to run on any pair of images.

    Parameters
    ----------
    matcher : the source of tie points, or None for tie points given by the user
    filters : (name, filter) in the order in which they run; the name is that of the stage in the result
    model : class of the model to fit
    refine : the refinement, or None
    limits : what a trusted result must reach
    n_features : most final tie points
    robust : whether the fit to what the filters kept is iteratively reweighted, from the inverse variances of the tie
        points where these are known, or plain least squares
    name : of the method, for the record
    parameters : every parameter, for the record
    """

    matcher: Matcher | None
    filters: tuple[tuple[str, Filter], ...]
    model: type[Model]
    refine: Refine | None = None
    limits: Limits = field(default_factory=Limits)
    n_features: int = 5000
    robust: bool = True
    name: str = "custom"
    parameters: Mapping[str, Any] = field(default_factory=dict)

    def run(
        self,
        reference: Image,
        secondary: Image,
        *,
        seed: int = 0,
        initial: Model | None = None,
        search_radius: float | None = None,
    ) -> Registration:
        """Register a pair.

        Parameters
        ----------
        reference, secondary : the images
        seed : of everything random
        initial : a model known beforehand; matches farther than `search_radius` pixels from it are dropped first
        search_radius : px; needed with `initial`
        """
        if self.matcher is None:
            raise ParameterError("this pipeline has no matcher: give it one, or use featreg.fit with tie points")
        with collecting() as timings:
            matches = self.matcher.match(reference, secondary)
            return self.finish(
                matches,
                reference,
                secondary,
                seed=seed,
                initial=initial,
                search_radius=search_radius,
                timings=timings,
            )

    def finish(
        self,
        matches: Matches,
        reference: Image | tuple[int, int],
        secondary: Image | tuple[int, int],
        *,
        seed: int = 0,
        initial: Model | None = None,
        search_radius: float | None = None,
        timings: dict[str, float] | None = None,
        gathered: Gathered | None = None,
    ) -> Registration:
        """Filter, fit, refine and judge tie points; images given as (H, W) only are not refined on.

        `gathered` holds what was done block by block; its filters are not run again.
        """
        shapes = [i.shape if isinstance(i, Image) else i for i in (reference, secondary)]
        context = FilterContext(shapes[0], shapes[1], self.model, np.random.default_rng(seed), initial)
        done = {} if gathered is None else gathered.stages
        stages, kept = self._filter(matches, context, initial, search_radius, done)
        with stage("model"):
            model, inliers = self._fit(matches, kept)
        supported, putative = kept, np.ones(len(matches), np.bool_)
        judged: Model | FailedFit = model
        refine = self._refinement(reference, secondary, matches) if gathered is None else gathered.refine
        if self.refine is not None and refine is not None:
            with stage("refine"):
                if model:
                    refined = refine(model)
                    count = len(refined.matches)
                    useful = bool(refined.model) and count >= self.refine.least(refined.candidates)
                    judged = refined.model if useful else model
                    added = np.ones(count if useful else 0, np.bool_)
                    if useful:
                        matches = matches.appended(refined.matches)
                        inliers = np.concatenate([np.zeros(len(kept), np.bool_), added])
                    stages = {name: np.concatenate([mask, ~added]) for name, mask in stages.items()}
                    supported, putative = (np.concatenate([m, ~added]) for m in (supported, putative))
                    stages["refine"] = np.concatenate([np.zeros(len(kept), np.bool_), added])
                else:
                    stages["refine"] = np.zeros(len(matches), np.bool_)
        with stage("trust"):
            chance_shape = shapes[1] if gathered is None else gathered.chance_shape
            status, reason, gates = assess(
                Evidence(
                    matches, putative, supported, inliers, judged, shapes[0], chance_shape, initial, search_radius
                ),
                self.limits,
                {} if gathered is None or not judged else gathered.gates(matches, inliers, judged),
            )
        return Registration(
            matches, stages, inliers, judged, status, reason, gates, dict(timings or {}), self._provenance(seed)
        )

    def _refinement(
        self, reference: Image | tuple[int, int], secondary: Image | tuple[int, int], matches: Matches
    ) -> Callable[[Model], Refined] | None:
        """The refinement on two images; None where there is none or the images are not at hand."""
        refine = self.refine
        if refine is None or not isinstance(reference, Image) or not isinstance(secondary, Image):
            return None
        return lambda model: refine.run(reference, secondary, model, matches, self.n_features)

    def _filter(
        self,
        matches: Matches,
        context: FilterContext,
        initial: Model | None,
        search_radius: float | None,
        done: Mapping[str, BoolArray],
    ) -> tuple[dict[str, BoolArray], BoolArray]:
        """Every filter sees what the one before it kept; its mask covers all matches."""
        kept = np.ones(len(matches), np.bool_)
        stages: dict[str, BoolArray] = dict(done)
        for mask in done.values():
            kept = kept & mask
        if initial is not None:
            if search_radius is None or not search_radius > 0:
                raise ParameterError(f"initial needs search_radius > 0 px, got {search_radius}")
            kept = kept & (initial.residuals(matches.reference_xy, matches.secondary_xy) <= search_radius)
            stages["initial"] = kept
        for name, keeper in self.filters:
            if name in done:
                continue
            with stage(name):
                rows = np.flatnonzero(kept)
                kept = np.zeros(len(matches), np.bool_)
                kept[rows[keeper.keep(matches.take(rows), context)]] = True
            stages[name] = kept
        return stages, kept

    def _fit(self, matches: Matches, kept: BoolArray) -> tuple[Model | FailedFit, BoolArray]:
        """Fit to what the filters kept; the inliers are those the fit did not leave out, best score first."""
        here, there = matches.reference_xy[kept], matches.secondary_xy[kept]
        model: Model | FailedFit
        if self.robust:
            known = None if matches.covariance is None else inverse_variances(matches.covariance[kept])
            model, weights = irls(self.model, here, there, weights=known, scale_px=SCALE_PX, iterations=ROUNDS)
        else:
            model, weights = self.model.from_estimate(here, there), np.ones(len(here))
        inliers = np.zeros(len(matches), np.bool_)
        if isinstance(model, FailedFit):
            return model, inliers
        rows = np.flatnonzero(kept)[weights > 0]
        rows = rows[np.argsort(-matches.score[rows], kind="stable")]
        inliers[rows[_distinct_rows(matches.reference_xy[rows])][: self.n_features]] = True
        return model, inliers

    def _provenance(self, seed: int) -> dict[str, Any]:
        from featreg.runtime.versions import versions

        return {"method": self.name, "seed": seed, "parameters": dict(self.parameters), "versions": versions()}


def _distinct_rows(xy: FloatArray) -> IntArray:
    """Rows of the first of each set of equal points, in order."""
    order = np.lexsort(xy.T)
    new = np.concatenate([[True], (np.diff(xy[order], axis=0) != 0).any(axis=1)]) if len(xy) else np.zeros(0, np.bool_)
    return np.sort(order[new])
