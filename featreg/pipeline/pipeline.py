"""From two images to a registration: a matcher, filters, a model, refinement and trust, each replaceable."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import takewhile
from typing import Any

import numpy as np

from featreg.errors import ParameterError
from featreg.interfaces import FailedFit, Filter, FilterContext, Matcher, Model
from featreg.pipeline.competing import agreement_gates, rival_gate
from featreg.pipeline.feature_matcher import FeatureMatcher
from featreg.pipeline.frame import Frame, stated_frame
from featreg.pipeline.identical import identical_pixels, stands_still, without_identical
from featreg.pipeline.inputs import input_image, pixel_ratio, searched_record, with_hints
from featreg.pipeline.locate import Locate
from featreg.pipeline.refine import Refine
from featreg.pipeline.steps import (
    Draft,
    before_global,
    counted_from,
    filtered,
    fitted,
    judged,
    located,
    model_counted_back,
    refined,
)
from featreg.pipeline.trust import Limits
from featreg.results.losses import image_words
from featreg.results.registration import Registration
from featreg.runtime.threads import side_by_side
from featreg.runtime.timing import collecting, stage
from featreg.runtime.versions import versions
from featreg.runtime.watching import Progress, Steps
from featreg.sar.bridging import bridged, on_samples
from featreg.types import BoolArray, FloatArray, Gate, Image, Matches

#: What `Pipeline.run` counts as one each: tie points, filters, model, locating, refinement, judgement.
STEPS = 6


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
    locate : how the matches are measured again after the first model, or None
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
    locate: Locate | None = None

    def run(
        self,
        reference: Image,
        secondary: Image,
        *,
        seed: int = 0,
        initial: Model | None = None,
        search_radius: float | None = None,
        progress: Progress | None = None,
        prior: str | None = None,
    ) -> Registration:
        """Register a pair.

        Parameters
        ----------
        reference, secondary : the images
        seed : of everything random
        initial : a model known beforehand; matches farther than `search_radius` pixels from it are dropped first
        search_radius : px; needed with `initial`
        progress : called with (steps done, steps in all)
        prior : "none" leaves aside where the images say they lie

        Notes
        -----
        Where both images state by their geolocation that one is a mirror, a stretch, a zoom or a turn of the other, the
        secondary is compared, and the result judged, in the reference's frame (`featreg.pipeline.frame`). A result that
        cannot be trusted there is tried without.
        """
        if self.matcher is None:
            raise ParameterError("this pipeline has no matcher: give it one, or use featreg.fit with tie points")
        with collecting() as timings, stage("prior"):
            frame = None if initial is not None or prior == "none" else self._frame(reference, secondary)
        if frame is not None:
            held = self._run(reference, frame.resampled(secondary), seed, None, None, progress)
            held = _in_own_pixels(held, frame, secondary)
            if held.status == "ok":
                return replace(held, timings={**timings, **held.timings})
            plain = self._run(reference, secondary, seed, None, None, None)
            return plain if plain.status == "ok" else held
        return self._run(reference, secondary, seed, initial, search_radius, progress)

    def _frame(self, reference: Image, secondary: Image) -> Frame | None:
        """What to take out by the geography of two images, where the method and the model allow it."""
        if reference.geolocation is None or secondary.geolocation is None:
            return None
        if secondary.is_complex and not isinstance(self.matcher, FeatureMatcher):
            return None  # it may rest on phases
        frame = stated_frame(reference, secondary, self.model)
        return frame if frame is not None and frame.held_by(self.model, reference.shape) else None

    def _run(
        self,
        reference: Image,
        secondary: Image,
        seed: int,
        initial: Model | None,
        search_radius: float | None,
        progress: Progress | None,
    ) -> Registration:
        matcher = self.matcher
        if matcher is None:
            raise ParameterError("this pipeline has no matcher")
        steps = Steps(STEPS, progress)
        shapes = reference.shape, secondary.shape
        given = reference, secondary
        records = input_image(reference), input_image(secondary)
        with collecting() as timings:
            with stage("identical"):
                identical = identical_pixels(reference, secondary)
                if identical is not None:
                    reference, secondary = without_identical(reference, secondary, identical)
            with stage("read"):
                reference, secondary = side_by_side(
                    [partial(bridged, reference), partial(bridged, secondary)], reference.mask.size // 8
                )
            if initial is None or search_radius is None:
                matches = matcher.match(reference, secondary)
            else:
                matches = matcher.match_near(reference, secondary, initial, search_radius)
            looked = searched_record(matcher, reference, secondary)
            matches = on_samples(matches, reference, secondary)
            steps.advance()
            before = None if identical is None else {"identical": ~stands_still(matches)}
            known: Any = {"seed": seed, "initial": initial, "search_radius": search_radius}
            ratio = pixel_ratio(*records, initial)
            stages = self.filtered(matches, *shapes, before=before, pixel_ratio=ratio, **known)
            steps.advance()
            far = None if search_radius is None else f"lies within {search_radius:g} px of the initial model"
            draft = self.fitted(matches, stages, {} if far is None else {"initial": far})
            if not len(matches):
                seen = zip(("reference", "secondary"), records, strict=True)
                draft = draft.without_model("; ".join(image_words(role, image) for role, image in seen))
            steps.advance()
            if self.locate is not None:
                with stage("locate"):
                    at = Matches.empty()
                    if draft.model:
                        kept = self.to_locate(draft.stages, len(matches))
                        at = self.locate.run(reference, secondary, draft.model, matches, np.flatnonzero(kept))
                    draft = located(draft, at, self.n_features, self.locate.side)
            steps.advance()
            useful = None
            if self.refine is not None:
                with stage("refine"):
                    found = None
                    if draft.model:
                        near = self.locate is not None and bool((draft.inliers & draft.stages["locate"]).any())
                        found = self.refine.run(reference, secondary, draft.model, matches, self.n_features, near=near)
                    draft = refined(draft, found, 0 if found is None else self.refine.least(found.candidates))
                useful = bool(draft.stages["refine"].any())
            steps.advance()
            with stage("trust"):
                gates, chance = agreement_gates(
                    draft, reference, secondary, self.limits, identical=identical, refined=useful
                )
            result = self.judged(draft, *shapes, further=gates, seconds=timings, chance=chance, **known)
            steps.advance()
        reason = with_hints(result.reason, *given)
        if reason and initial is None and matcher.taken_for_granted:
            reason = f"{reason}; {matcher.taken_for_granted}"
        return replace(
            result,
            reason=reason,
            provenance={**result.provenance, **({"searched": [looked]} if looked else {})},
            reference=records[0],
            secondary=records[1],
        )

    def fit(
        self,
        matches: Matches,
        reference_shape: tuple[int, int],
        secondary_shape: tuple[int, int],
        *,
        seed: int = 0,
        origins: tuple[tuple[int, int], tuple[int, int]] = ((0, 0), (0, 0)),
    ) -> Registration:
        """Filter, fit and judge given tie points; without the images nothing is refined.

        `origins` are the (x, y) at which the two images begin. Filters, fit and gates count from there; the model and
        the tie points of the result do not.
        """
        shapes = reference_shape, secondary_shape
        with collecting() as timings:
            moved = counted_from(matches, *origins)
            draft = self.fitted(moved, self.filtered(moved, *shapes, seed=seed))
            result = self.judged(draft, *shapes, seed=seed, seconds=timings)
        model = model_counted_back(draft.model, moved.reference_xy[draft.inliers], *origins)
        if isinstance(model, FailedFit) and draft.model:
            result = replace(result, status="unreliable", reason=f"no model in these coordinates: {model.reason}")
        return replace(result, matches=matches, model=model)

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
        pixel_ratio: tuple[float, float] = (1.0, 1.0),
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
        rng = np.random.default_rng(seed)
        context = FilterContext(reference_shape, secondary_shape, self.model, rng, initial, pixel_ratio)
        return filtered(matches, left, context, stages)

    def to_locate(self, stages: Mapping[str, BoolArray], count: int) -> BoolArray:
        """(M,) tie points of `count` that are measured again: those of every stage before the first global filter."""
        return before_global(stages, self.global_filters, count)

    @property
    def global_filters(self) -> list[str]:
        """Names of the filters that look at all tie points at once."""
        return [name for name, keeper in self.filters if not keeper.local]

    @property
    def block_filters(self) -> tuple[tuple[str, Filter], ...]:
        """The filters that a scene may run block by block: those before the first that looks at all tie points."""
        return tuple(takewhile(lambda step: step[1].local, self.filters))

    def fitted(
        self, matches: Matches, stages: Mapping[str, BoolArray], meanings: Mapping[str, str] | None = None
    ) -> Draft:
        """The model of what the stages kept; `meanings` as in `featreg.pipeline.steps.fitted`."""
        return fitted(matches, stages, self.model, self.n_features, robust=self.robust, meanings=meanings)

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
        stated: FloatArray | None = None,
        chance: float = 0.0,
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
            stated=stated,
            chance=chance,
        )
        provenance = {
            "method": self.name,
            "seed": seed,
            "parameters": dict(self.parameters),
            "global_filters": self.global_filters,
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


def _in_own_pixels(result: Registration, frame: Frame, secondary: Image) -> Registration:
    """A result of the reference and the frame as one of the reference and the secondary, with the gates as judged.

    A model that no longer is of the class that was fitted says of which it is in the frame.
    """
    model = result.model
    if not isinstance(model, FailedFit) and result.reference is not None:
        model = frame.model_back(model, result.reference.shape)
    fitted = {} if type(model) is type(result.model) else {"model": type(result.model).__name__.lower()}
    return replace(
        result,
        matches=frame.back(result.matches),
        model=model,
        provenance={
            **result.provenance,
            "frame": {"source": "geolocation", "linear": frame.linear.tolist(), **fitted},
        },
        secondary=input_image(secondary),
    )
