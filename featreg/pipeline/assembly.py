"""From a preset and keywords to a Pipeline: which part each keyword belongs to, and an error where none does."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from featreg import registry
from featreg.errors import ParameterError, suggest
from featreg.interfaces import Descriptor, Detector, Filter, Matcher, Model, Nearest
from featreg.pipeline.feature_matcher import FeatureMatcher
from featreg.pipeline.pipeline import Pipeline
from featreg.pipeline.refine import Refine
from featreg.pipeline.trust import Limits
from featreg.presets import PRESETS, Part, Preset
from featreg.runtime.parameters import check

DEFAULT_METHOD = "sar-orb"
DEFAULT_MODEL = "affine"
DEFAULT_FEATURES = 5000
ROLES: Mapping[str, type[Any]] = {
    "detector": Detector,
    "descriptor": Descriptor,
    "nearest": Nearest,
    "matcher": Matcher,
}


@dataclass
class _Slot:
    """One part while keywords are being sorted: its registry entry or ready-made object, and its parameters."""

    kind: str
    name: str
    parameters: dict[str, Any]
    known: Mapping[str, Any]
    ready: Any = None

    @classmethod
    def of(cls, kind: str, part: Part | Any) -> _Slot:
        if isinstance(part, Part):
            return cls(kind, part.name, dict(part.parameters), registry.entry(kind, part.name).parameters)
        return cls(kind, type(part).__name__, {}, {}, part)

    def make(self) -> Any:
        return self.ready if self.ready is not None else registry.create(self.kind, self.name, **self.parameters)  # type: ignore[call-overload]


def assemble(
    method: str | Pipeline | Matcher = DEFAULT_METHOD,
    *,
    model: str | type[Model] | None = None,
    refine: bool | None = None,
    n_features: int | None = None,
    **keywords: Any,
) -> Pipeline:
    """Build the pipeline of a method.

    Parameters
    ----------
    method : a preset's name, a `Matcher` (given the default filters), or a `Pipeline` (to which no keyword is added)
    model : name or class of the geometric model
    refine : whether to refine; None leaves it to the preset
    n_features : most features per image and most final tie points
    keywords : ``detector``, ``descriptor``, ``nearest``, ``matcher`` (name or object), ``filters`` (list of names or
        objects), ``common_rotation``, ``robust`` (see `Pipeline`), and any parameter of any part, as ``name`` or
        ``part.name``

    Raises
    ------
    UnknownNameError, ParameterError
        An unknown name; a keyword that no part has or that more than one has.
    """
    if isinstance(method, Pipeline):
        given = [k for k, v in (("model", model), ("refine", refine), ("n_features", n_features)) if v is not None]
        if given or keywords:
            raise ParameterError(f"a Pipeline takes no further keywords, got {', '.join([*given, *keywords])}")
        return method
    budget = DEFAULT_FEATURES if n_features is None else n_features
    if not isinstance(budget, int | np.integer) or isinstance(budget, bool) or budget < 1:
        raise ParameterError(f"n_features must be a whole number >= 1, got {budget!r}")
    budget = int(budget)
    name, preset = _preset(method)
    keywords = dict(keywords)
    slots = _slots(preset, method, keywords)
    steps = _filters(preset, keywords)
    common = keywords.pop("common_rotation", preset.common_rotation)
    robust = keywords.pop("robust", preset.robust)
    for key, value in (("common_rotation", common), ("robust", robust)):
        check(key, value, bool)
    refinement, limits = _route(keywords, slots, steps, preset)
    for slot in slots.values():
        if "n_features" in slot.known:
            slot.parameters.setdefault("n_features", budget)
    matcher = _matcher(slots, budget, common)
    filters = tuple((step, slot.make()) for step, slot in steps.items())
    use = preset.refine if refine is None else refine
    chosen = registry.model_class(model or preset.model or DEFAULT_MODEL) if not isinstance(model, type) else model
    refinement_asked = Refine(**refinement)
    refiner = refinement_asked if use else None
    parameters: dict[str, Any] = {
        "n_features": budget,
        "model": registry.model_name(chosen),
        "refine": bool(use),
        "robust": bool(robust),
    }
    if isinstance(matcher, FeatureMatcher):
        parameters["common_rotation"] = matcher.common_rotation
    for role, slot in {**slots, **steps}.items():
        parameters[role] = {"name": slot.name, **values_of(slot.make(), slot.parameters, slot.known)}
    if refiner is not None:
        parameters["refinement"] = values_of(refiner, {}, {})
    parameters["trust"] = values_of(limits, {}, {})
    return Pipeline(matcher, filters, chosen, refiner, limits, budget, robust, name, parameters)


def values_of(part: Any, given: Mapping[str, Any], known: Mapping[str, Any]) -> dict[str, Any]:
    """Return every parameter of a part with its value: what it was given, else its default."""
    if known:
        return {**known, **given}
    names = inspect.signature(type(part)).parameters
    return {key: getattr(part, key) for key in names if hasattr(part, key)}


def _preset(method: str | Matcher) -> tuple[str, Preset]:
    if isinstance(method, Matcher):
        return type(method).__name__, Preset(type(method).__name__)
    if method not in PRESETS:
        raise registry.unknown("method", str(method))
    return method, PRESETS[method]


def _slots(preset: Preset, method: str | Matcher, keywords: dict[str, Any]) -> dict[str, _Slot]:
    """The parts that make tie points, with those replaced that a keyword names."""
    slots: dict[str, _Slot] = {}
    if isinstance(method, Matcher):
        slots["matcher"] = _Slot.of("matcher", method)
    for role, base in ROLES.items():
        part = getattr(preset, role)
        if role in keywords:
            part = keywords.pop(role)
            if isinstance(part, str):
                part = Part(part)
            elif part is not None and not isinstance(part, base):
                raise ParameterError(f"{role} must be a name or a {base.__name__}, got {type(part).__name__}")
        if part is not None:
            slots[role] = _Slot.of(role, part)
    detector = slots.get("detector")
    # A descriptor was asked for, so a detector that could describe its own points must not.
    if detector and "descriptor" in slots and "describe" in detector.known:
        detector.parameters["describe"] = False
    return slots


def _filters(preset: Preset, keywords: dict[str, Any]) -> dict[str, _Slot]:
    steps: dict[str, _Slot] = {}
    given = keywords.pop("filters", preset.filters)
    for part in [given] if isinstance(given, str | Filter) else given:
        slot = _Slot.of("filter", Part(part) if isinstance(part, str) else part)
        if slot.ready is not None and not isinstance(slot.ready, Filter):
            raise ParameterError(f"filters must be names or Filter objects, got {slot.name}")
        name = slot.name if slot.ready is None else slot.name.lower()
        if name in steps:
            raise ParameterError(f"filter '{name}' stands twice in the chain")
        steps[name] = slot
    return steps


def _route(
    keywords: dict[str, Any], slots: Mapping[str, _Slot], steps: Mapping[str, _Slot], preset: Preset
) -> tuple[dict[str, Any], Limits]:
    """Give every keyword to the one part that has a parameter of that name."""
    refinement, trust = dict(preset.refinement), dict(preset.trust)
    takers: dict[str, tuple[dict[str, Any], set[str]]] = {
        "refine": (refinement, {f.name for f in fields(Refine)}),
        "trust": (trust, {f.name for f in fields(Limits)}),
    }
    for role, slot in {**slots, **steps}.items():
        takers[role] = (slot.parameters, set(slot.known))
    everything = [f"{role}.{key}" for role, (_, known) in takers.items() for key in sorted(known)]
    for key, value in keywords.items():
        part, _, short = key.rpartition(".")
        owners = [role for role, (_, known) in takers.items() if short in known and part in ("", role)]
        if len(owners) > 1:
            raise ParameterError(f"'{key}' is ambiguous: write " + " or ".join(f"'{role}.{short}'" for role in owners))
        if not owners:
            own = ["model", "seed", "refine", "initial", "search_radius", "n_features", "nodata", "scale"]
            names = everything if part else [*own, *ROLES, "filters", *(e.split(".")[1] for e in everything)]
            raise ParameterError(f"no part of this method has a parameter '{key}', {suggest(key, set(names))}")
        takers[owners[0]][0][short] = value
    return refinement, Limits(**trust)


def _matcher(slots: Mapping[str, _Slot], budget: int, common_rotation: bool) -> Matcher:
    if "matcher" in slots:
        ready: Matcher = slots["matcher"].make()
        return ready
    missing = [role for role in ("detector", "nearest") if role not in slots]
    if missing:
        raise ParameterError(f"a feature method needs a {' and a '.join(missing)}")
    descriptor = slots["descriptor"].make() if "descriptor" in slots else None
    return FeatureMatcher(
        slots["detector"].make(), descriptor, slots["nearest"].make(), budget, common_rotation=common_rotation
    )
