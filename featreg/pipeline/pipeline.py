"""From two images to a registration: a matcher, filters, a model, refinement and trust, each replaceable."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import takewhile
from typing import Any

import numpy as np

from featreg.errors import ParameterError
from featreg.interfaces import Filter, FilterContext, Matcher, Model
from featreg.pipeline.competing import agreement_gates, rival_gate
from featreg.pipeline.identical import identical_pixels, stands_still
from featreg.pipeline.inputs import input_image
from featreg.pipeline.refine import Refine
from featreg.pipeline.steps import Draft, filtered, fitted, judged, refined
from featreg.pipeline.trust import Limits
from featreg.results.registration import Registration
from featreg.runtime.timing import collecting, stage
from featreg.runtime.versions import versions
from featreg.runtime.watching import Progress, Steps
from featreg.types import BoolArray, Gate, Image, Matches

#: What `Pipeline.run` counts as one each: tie points, filters, model, refinement, judgement.
STEPS = 5


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
        progress: Progress | None = None,
    ) -> Registration:
        """Register a pair.

        Parameters
        ----------
        reference, secondary : the images
        seed : of everything random
        initial : a model known beforehand; matches farther than `search_radius` pixels from it are dropped first
        search_radius : px; needed with `initial`
        progress : called with (steps done, steps in all)
        """
        if self.matcher is None:
            raise ParameterError("this pipeline has no matcher: give it one, or use featreg.fit with tie points")
        steps = Steps(STEPS, progress)
        shapes = reference.shape, secondary.shape
        with collecting() as timings:
            matches = self.matcher.match(reference, secondary)
            steps.advance()
            with stage("identical"):
                identical = identical_pixels(reference, secondary)
            before = None if identical is None else {"identical": ~stands_still(matches)}
            known: Any = {"seed": seed, "initial": initial, "search_radius": search_radius}
            stages = self.filtered(matches, *shapes, before=before, **known)
            steps.advance()
            draft = self.fitted(matches, stages)
            steps.advance()
            useful = None
            if self.refine is not None:
                with stage("refine"):
                    found = None
                    if draft.model:
                        found = self.refine.run(reference, secondary, draft.model, matches, self.n_features)
                    draft = refined(draft, found, 0 if found is None else self.refine.least(found.candidates))
                useful = bool(draft.stages["refine"].any())
            steps.advance()
            with stage("trust"):
                gates = agreement_gates(draft, reference, secondary, self.limits, identical=identical, refined=useful)
            result = self.judged(draft, *shapes, further=gates, seconds=timings, **known)
            steps.advance()
        return replace(result, reference=input_image(reference), secondary=input_image(secondary))

    def fit(
        self, matches: Matches, reference_shape: tuple[int, int], secondary_shape: tuple[int, int], *, seed: int = 0
    ) -> Registration:
        """Filter, fit and judge given tie points; without the images nothing is refined."""
        with collecting() as timings:
            draft = self.fitted(matches, self.filtered(matches, reference_shape, secondary_shape, seed=seed))
            return self.judged(draft, reference_shape, secondary_shape, seed=seed, seconds=timings)

    def filtered(
        self,
        matches: Matches,
        reference_shape: tuple[int, int],
        secondary_shape: tuple[int, int],
        *,
        seed: int = 0,
        initial: Model | None = None,
        search_radius: float | None = None,
        before: Mapping[str, BoolArray] | None = None,
    ) -> dict[str, BoolArray]:
        """The stages of tie points, name -> (M,) bool: those that ran `before`, the model known beforehand, filters."""
        stages = dict(before or {})
        if initial is not None:
            if search_radius is None or not search_radius > 0:
                raise ParameterError(f"initial needs search_radius > 0 px, got {search_radius}")
            stages["initial"] = initial.residuals(matches.reference_xy, matches.secondary_xy) <= search_radius
            for mask in (before or {}).values():
                stages["initial"] = stages["initial"] & mask
        left = [(name, keeper) for name, keeper in self.filters if name not in stages]
        context = FilterContext(reference_shape, secondary_shape, self.model, np.random.default_rng(seed), initial)
        return filtered(matches, left, context, stages)

    @property
    def block_filters(self) -> tuple[tuple[str, Filter], ...]:
        """The filters that a scene may run block by block: those before the first that looks at all tie points."""
        return tuple(takewhile(lambda step: step[1].local, self.filters))

    def fitted(self, matches: Matches, stages: Mapping[str, BoolArray]) -> Draft:
        """The model of what the stages kept."""
        return fitted(matches, stages, self.model, self.n_features, robust=self.robust)

    def judged(
        self,
        draft: Draft,
        reference_shape: tuple[int, int],
        chance_shape: tuple[int, int],
        *,
        seed: int,
        seconds: dict[str, float],
        initial: Model | None = None,
        search_radius: float | None = None,
        further: Mapping[str, Gate] | None = None,
    ) -> Registration:
        """The registration of a draft, by the pipeline's own limits; parameters as `featreg.pipeline.steps.judged`.

        `seconds` by stage are read last, when judging has added its own.
        """
        shapes = reference_shape, chance_shape
        with stage("trust"):
            competing = rival_gate(draft, shapes, self.limits, seed, (further or {}).get("scene"))
        status, reason, gates = judged(
            draft,
            shapes,
            self.limits,
            initial=initial,
            search_radius=search_radius,
            further={**competing, **(further or {})},
        )
        provenance = {
            "method": self.name,
            "seed": seed,
            "parameters": dict(self.parameters),
            "global_filters": [name for name, keeper in self.filters if not keeper.local],
            "versions": versions(),
        }
        return Registration(
            draft.matches,
            draft.stages,
            draft.inliers,
            draft.model,
            status,
            reason,
            gates,
            dict(seconds),
            provenance,
        )
