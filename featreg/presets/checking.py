"""What a method must be before it is listed."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from featreg.errors import PluginError
from featreg.presets import PRESETS
from featreg.presets.preset import Part, Preset


def checked_preset(name: str, preset: Preset) -> Preset:
    """Return a preset that is to be called `name`, lists in it made tuples.

    Raises
    ------
    PluginError
        The name cannot be written on a command line, or `preset` is none, holds nothing or two things that make tie
        points, or values of the wrong kind.
    """
    if not isinstance(name, str) or not re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", name):
        raise PluginError(f"a method's name is small letters, digits and hyphens, got {name!r}")
    if not isinstance(preset, Preset):
        raise PluginError(f"method '{name}' must be a featreg.Preset, got {type(preset).__name__}")
    preset = replace(preset, filters=_tuple(name, preset, "filters"), methods=_tuple(name, preset, "methods"))
    _hold_together(name, preset)
    return preset


def _tuple(name: str, preset: Preset, field_name: str) -> tuple[Any, ...]:
    """The items of a field of a preset; one alone, or a text, would be taken apart or not found."""
    given = getattr(preset, field_name)
    if not isinstance(given, tuple | list):
        raise PluginError(f"method '{name}': {field_name} must be a tuple, got {given!r}")
    return tuple(given)


def _hold_together(name: str, preset: Preset) -> None:
    """Raise `PluginError` where a preset says nothing, or two things, of what makes the tie points."""
    for part in (*(part for _, part in preset.parts), *preset.filters):
        if not isinstance(part, Part):
            raise PluginError(f"method '{name}': its parts must be featreg.Part, got {part!r}")
        if not isinstance(part.parameters, Mapping):
            raise PluginError(
                f"method '{name}': parameters of '{part.name}' must be a mapping, got {part.parameters!r}"
            )
    for field_name, kind, words in (
        *(
            (switch, bool, "True or False")
            for switch in ("locate", "refine", "common_rotation", "robust", "for_unlike")
        ),
        *((values, Mapping, "a mapping") for values in ("trust", "refinement")),
        ("summary", str, "a line of text"),
    ):
        if not isinstance(getattr(preset, field_name), kind):
            raise PluginError(f"method '{name}': {field_name} must be {words}, got {getattr(preset, field_name)!r}")
    pixels = preset.pixels_per_feature
    if isinstance(pixels, bool) or not isinstance(pixels, int | float) or not 0 <= pixels < math.inf:
        raise PluginError(f"method '{name}': pixels_per_feature must be a finite number from 0 on, got {pixels!r}")
    own = [role for role, _ in preset.parts]
    if preset.methods:
        choices = [one for one in preset.methods if one == name or (one in PRESETS and PRESETS[one].methods)]
        if own or choices:
            what = f"the choice '{choices[0]}' in it" if choices else f"a {own[0]} of its own"
            raise PluginError(f"method '{name}' is a choice of methods and cannot have {what}")
    elif "matcher" in own and len(own) > 1:
        raise PluginError(f"method '{name}' has a matcher, beside which a {own[0]} does nothing: leave one of them out")
    elif "matcher" not in own and not {"detector", "nearest"} <= {*own}:
        raise PluginError(f"method '{name}' needs a matcher, or a detector and a nearest, that make tie points")
