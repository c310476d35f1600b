"""What a named method consists of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Part:
    """One part of a method: the name of a plugin and the parameters that differ from its defaults."""

    name: str
    parameters: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Preset:
    """A method: either a detector, a descriptor (None where the detector describes) and a nearest, or a matcher.

    Or a choice of methods: `methods` names those that are tried in order until one is trusted, and the other fields say
    nothing. Those of them that are `for_unlike` images come first where the two differ much in their speckle, as an
    optical and a SAR image do.

    `filters` run in order; `locate` and `refine` say whether matches are measured again, and whether refinement is on,
    unless asked otherwise; `common_rotation` is that of `FeatureMatcher`, and so is `pixels_per_feature`, for whole
    images whose matches are measured again; `model` is fitted unless another is asked for (None: the package's
    default); `robust` is that of `Pipeline`; `trust` and `refinement` hold what differs from the defaults of
    `featreg.pipeline.trust.Limits` and `featreg.pipeline.refine.Refine`.
    """

    summary: str
    detector: Part | None = None
    descriptor: Part | None = None
    nearest: Part | None = None
    matcher: Part | None = None
    filters: tuple[Part, ...] = (Part("gms"), Part("fsc"))
    locate: bool = True
    refine: bool = True
    common_rotation: bool = True
    pixels_per_feature: float = 0.0
    model: str | None = None
    robust: bool = True
    trust: Mapping[str, Any] = field(default_factory=dict)
    refinement: Mapping[str, Any] = field(default_factory=dict)
    methods: tuple[str, ...] = ()
    for_unlike: bool = False

    @property
    def parts(self) -> tuple[tuple[str, Part], ...]:
        """(role, part) of those that make the tie points."""
        roles = ("detector", "descriptor", "nearest", "matcher")
        return tuple((role, part) for role in roles if (part := getattr(self, role)) is not None)
