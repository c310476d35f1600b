"""From a preset and keywords to a Pipeline: which part each keyword belongs to, and an error where it does nothing."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cache, cached_property
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval

from featreg import registry
from featreg.errors import ParameterError, suggest
from featreg.interfaces import Descriptor, Detector, Filter, Matcher, Model, Nearest
from featreg.pipeline import keywords as declared
from featreg.pipeline.feature_matcher import FeatureMatcher
from featreg.pipeline.locate import Locate
from featreg.pipeline.pipeline import Pipeline
from featreg.pipeline.refine import Refine
from featreg.pipeline.trust import Limits
from featreg.presets import DEFAULT_METHOD, Part, Preset
from featreg.runtime.parameters import check, owner_of

DEFAULT_MODEL = "affine"
#: Features of an image, and of a block: there, detection takes the same time for a hundred as for a thousand.
DEFAULT_FEATURES, BLOCK_FEATURES = 5000, 1000
ROLES: Mapping[str, type[Any]] = {
    "detector": Detector,
    "descriptor": Descriptor,
    "nearest": Nearest,
    "matcher": Matcher,
}
#: Limits of trust that only a scene in blocks is held to.
BLOCK_LIMITS = ("block_share", "held_out_rmse_px", "block_error_px")


@dataclass(frozen=True)
class _Slot:
    """One part while keywords are being sorted: its registry entry or ready-made object, and its parameters."""

    kind: str
    name: str
    parameters: dict[str, Any] = field(default_factory=dict)
    entry: registry.Entry | None = None
    ready: Any = None

    @classmethod
    def of(cls, kind: str, part: Part | Any) -> _Slot:
        if isinstance(part, Part):
            return cls(kind, part.name, dict(part.parameters), registry.entry(kind, part.name))
        return cls(kind, type(part).__name__, ready=part)

    @property
    def known(self) -> Mapping[str, Any]:
        """The parameters that may be given, with their defaults."""
        return {} if self.entry is None else self.entry.parameters

    @cached_property
    def made(self) -> Any:
        """The part itself, made once."""
        return self.ready if self.ready is not None else registry.create(self.kind, self.name, **self.parameters)  # type: ignore[call-overload]  # kind is one of the names that it knows

    @property
    def record(self) -> dict[str, Any]:
        """The name of the part and every parameter with its value."""
        if self.entry is not None:
            return {"name": self.name, **self.known, **self.parameters}
        return {"name": self.name, **_values(self.made)}


def assemble(
    method: str | Pipeline | Matcher = DEFAULT_METHOD,
    *,
    model: str | type[Model] | None = None,
    refine: bool | None = None,
    locate: bool | None = None,
    n_features: int | None = None,
    blocks: bool | None = False,
    **keywords: Any,
) -> Pipeline:
    """Build the pipeline of a method.

    Parameters
    ----------
    method : a preset's name, a `Matcher` (given the default filters), or a `Pipeline` (to which no keyword is added)
    model : name or class of the geometric model
    refine, locate : whether to refine, and to measure the matches again before; None leaves it to the preset
    n_features : most features per image and most final tie points; in blocks, of each block
    blocks : whether it is to work in blocks: each plugin then has its `block_parameters`; None where it is not known
    keywords : ``detector``, ``descriptor``, ``nearest``, ``matcher`` (name or object), ``filters`` (list of names or
        objects), ``common_rotation`` and ``pixels_per_feature`` (see `FeatureMatcher`), ``robust`` (see `Pipeline`),
        and any parameter of any part, as ``name`` or ``part.name``

    Raises
    ------
    UnknownNameError, ParameterError
        An unknown name; a keyword that no part has, that more than one has, or that does nothing here.
    """
    if isinstance(method, Pipeline):
        own = {"model": model, "refine": refine, "locate": locate, "n_features": n_features}
        more = [name for name, value in own.items() if value is not None]
        if more or keywords:
            raise ParameterError(f"a Pipeline takes no further keywords, got {', '.join([*more, *keywords])}")
        return method
    name, preset = _preset(method)
    given = dict(keywords)
    slots = _slots(name, preset, method, given)
    own = {key: given.pop(key, None) for key in ("common_rotation", "pixels_per_feature")}
    features: dict[str, Any] = {key: value for key, value in own.items() if value is not None}
    if features and "matcher" in slots:
        raise ParameterError(
            f"{next(iter(features))} is for methods that describe features, and '{name}' makes tie points by the "
            f"matcher '{slots['matcher'].name}': leave it out"
        )
    switches = {
        # The positions of a matcher of its own may be what it is good at.
        "locate": _switch("locate", preset.locate and "matcher" not in slots if locate is None else locate),
        "refine": _switch("refine", preset.refine if refine is None else refine),
    }
    # Where nothing measures positions again they are found at full size; what blocks gain is not known.
    reduced = any(switches.values()) and not blocks
    usual = {"common_rotation": preset.common_rotation, "pixels_per_feature": preset.pixels_per_feature * reduced}
    features = usual | features
    for key, allowed in (
        ("common_rotation", bool),
        ("pixels_per_feature", Annotated[float, Interval(ge=0, lt=math.inf)]),
    ):
        check(key, features[key], allowed)
    return _assembled(name, preset, slots, model, switches, n_features, blocks, features, given)


def assemble_all(method: str | Pipeline | Matcher = DEFAULT_METHOD, **keywords: Any) -> tuple[Pipeline, ...]:
    """Build the pipelines among which a method chooses, in the order in which they are tried; of most methods one.

    Parameters and errors as `assemble`; every one of the methods must take the keywords.
    """
    preset = registry.presets().get(method) if isinstance(method, str) else None
    if preset is None or not preset.methods:
        return (assemble(method, **keywords),)
    try:
        return tuple(assemble(name, **keywords) for name in preset.methods)
    except ParameterError as error:
        raise ParameterError(f"'{method}' is a choice of {', '.join(preset.methods)}: {error}") from error


def assemble_fit(*, model: str | type[Model] | None, filters: Any, **keywords: Any) -> Pipeline:
    """Build the pipeline of given tie points: filters, model and trust; parameters and errors as `assemble`."""
    preset = Preset("tie points", filters=())
    of_match = [name for name in keywords if name in declared.BY_NAME]
    if of_match:
        raise ParameterError(f"{of_match[0]} is for featreg.match: the tie points of a fit are given")
    none = {"locate": False, "refine": False}
    return _assembled("tie points", preset, {}, model, none, None, False, {}, {**keywords, "filters": filters})


def _switch(name: str, value: Any) -> bool:
    check(name, value, bool)
    return bool(value)


def _assembled(
    name: str,
    preset: Preset,
    slots: dict[str, _Slot],
    model: str | type[Model] | None,
    switches: Mapping[str, bool],
    n_features: int | None,
    blocks: bool | None,
    features: Mapping[str, Any],
    keywords: dict[str, Any],
) -> Pipeline:
    budget = _budget(n_features, BLOCK_FEATURES if blocks else DEFAULT_FEATURES)
    steps = _filters(preset, keywords)
    robust = keywords.pop("robust", preset.robust)
    check("robust", robust, bool)
    locating, refinement, limits = _route(keywords, {**slots, **steps}, preset, switches, blocks)
    for slot in (*slots.values(), *steps.values()):
        for key, value in slot.entry.block_parameters.items() if blocks and slot.entry else ():
            slot.parameters.setdefault(key, value)
        if "n_features" in slot.known:
            slot.parameters.setdefault("n_features", budget)
    matcher = _matcher(slots, budget, features) if slots else None
    chosen = model if isinstance(model, type) else registry.model_class(model or preset.model or DEFAULT_MODEL)
    parameters: dict[str, Any] = {
        "n_features": budget,
        "model": registry.model_name(chosen),
        **switches,
        "robust": bool(robust),
    }
    if isinstance(matcher, FeatureMatcher):
        parameters |= features
    parameters |= {role: slot.record for role, slot in {**slots, **steps}.items()}
    if locating is not None:
        parameters["locating"] = _values(locating)
    if refinement is not None:
        parameters["refinement"] = _values(refinement)
    parameters["trust"] = _values(limits)
    filters = tuple((step, slot.made) for step, slot in steps.items())
    return Pipeline(matcher, filters, chosen, refinement, limits, budget, robust, name, parameters, locating)


def _budget(n_features: int | None, usual: int) -> int:
    budget = usual if n_features is None else n_features
    if not isinstance(budget, int | np.integer) or isinstance(budget, bool) or budget < 1:
        raise ParameterError(f"n_features must be a whole number >= 1, got {budget!r}")
    return int(budget)


def _values(part: Any) -> dict[str, Any]:
    """Every parameter of an object with its value, where it keeps it under its own name."""
    return {key: getattr(part, key) for key in _names(type(part)) if hasattr(part, key)}  # type: ignore[arg-type]  # classes can be keys


@cache
def _names(kind: Callable[..., Any]) -> tuple[str, ...]:
    return tuple(inspect.signature(kind).parameters)


def _preset(method: str | Matcher) -> tuple[str, Preset]:
    if isinstance(method, Matcher):
        return type(method).__name__, Preset(type(method).__name__)
    preset = registry.presets().get(method)
    if preset is None:
        raise registry.unknown("method", str(method))
    if preset.methods:
        raise ParameterError(f"'{method}' is a choice of methods, no pipeline: take one of {', '.join(preset.methods)}")
    return method, preset


def _slots(name: str, preset: Preset, method: str | Matcher, keywords: dict[str, Any]) -> dict[str, _Slot]:
    """The parts that make tie points, with those replaced that a keyword names."""
    parts: dict[str, Any] = {role: getattr(preset, role) for role in ROLES}
    if isinstance(method, Matcher):
        parts["matcher"] = method
    if "matcher" in keywords:
        parts = {**dict.fromkeys(ROLES), "matcher": _part("matcher", keywords.pop("matcher"))}
    whole = parts["matcher"]
    taken = registry.entry("matcher", whole.name).parameters if isinstance(whole, Part) else {}
    for role in ROLES:
        # A matcher may have a parameter of that name, as one has that looks for features at several scales.
        if role not in keywords or role in taken:
            continue
        if whole is not None:
            what = whole.name if isinstance(whole, Part) else type(whole).__name__
            raise ParameterError(
                f"{role} does nothing here: '{name}' makes tie points by the matcher '{what}'; "
                "choose a method that is made of a detector, or leave it out"
            )
        parts[role] = _part(role, keywords.pop(role))
    slots = {role: _Slot.of(role, part) for role, part in parts.items() if part is not None}
    detector = slots.get("detector")
    # A descriptor was asked for, so a detector that could describe its own points must not.
    if detector and "descriptor" in slots and detector.entry and detector.entry.describes:
        detector.parameters[detector.entry.describes] = False
    return slots


def _part(role: str, given: Any) -> Any:
    base = ROLES[role]
    if isinstance(given, str):
        return Part(given)
    if given is not None and not isinstance(given, base):
        raise ParameterError(f"{role} must be a name or a {base.__name__}, got {type(given).__name__}")
    return given


def _filters(preset: Preset, keywords: dict[str, Any]) -> dict[str, _Slot]:
    steps: dict[str, _Slot] = {}
    given = keywords.pop("filters", preset.filters)
    if not isinstance(given, str | Filter | Sequence):
        raise ParameterError(f"filters must be a list of names or Filter objects, got {given!r}")
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
    keywords: Mapping[str, Any],
    slots: Mapping[str, _Slot],
    preset: Preset,
    switches: Mapping[str, bool],
    blocks: bool | None,
) -> tuple[Locate | None, Refine | None, Limits]:
    """Give every keyword to the one part that has a parameter of that name."""
    locating: dict[str, Any] = {}
    refinement, trust = dict(preset.refinement), dict(preset.trust)
    takers: dict[str, tuple[dict[str, Any], Iterable[str]]] = {
        "locate": (locating, [f.name for f in fields(Locate)]),
        "refine": (refinement, [f.name for f in fields(Refine)]),
        "trust": (trust, [f.name for f in fields(Limits)]),
        **{role: (slot.parameters, slot.known) for role, slot in slots.items()},
    }
    for role in ("refine", "trust"):  # what the preset says of them
        given, names = takers[role]
        if wrong := [key for key in given if key not in names]:
            raise ParameterError(f"the preset: {role} has no parameter '{wrong[0]}', {suggest(str(wrong[0]), names)}")
    for key, value in keywords.items():
        known = {role: names for role, (_, names) in takers.items()}
        owner, short = owner_of(key, known, "no part of this method", declared.BY_NAME)
        if owner in switches and not switches[owner]:
            what, done = {"locate": ("locating", "located"), "refine": ("refinement", "refined")}[owner]
            if not slots.keys() & ROLES.keys():
                raise ParameterError(f"'{key}' is for featreg.match: given tie points are not {done}")
            raise ParameterError(f"'{key}' does nothing without {what}: leave it out, or ask for it ({owner}=True)")
        if owner == "trust" and short in BLOCK_LIMITS and blocks is False:
            raise ParameterError(f"'{key}' is a limit of scenes in blocks, these are whole images: leave it out")
        takers[owner][0][short] = value
    return (
        Locate(**locating) if switches["locate"] else None,
        Refine(**refinement) if switches["refine"] else None,
        Limits(**trust),
    )


def _matcher(slots: Mapping[str, _Slot], budget: int, features: Mapping[str, Any]) -> Matcher:
    if "matcher" in slots:
        ready: Matcher = slots["matcher"].made
        return ready
    missing = [role for role in ("detector", "nearest") if role not in slots]
    if missing:
        raise ParameterError(f"a feature method needs a {' and a '.join(missing)}")
    descriptor = slots["descriptor"].made if "descriptor" in slots else None
    return FeatureMatcher(slots["detector"].made, descriptor, slots["nearest"].made, budget, **features)
