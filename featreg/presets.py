"""The named methods: frozen data from which a pipeline is built, every part replaceable by a keyword."""

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

    `filters` run in order; `refine` says whether refinement is on unless asked otherwise; `common_rotation` is that of
    `FeatureMatcher`.
    """

    summary: str
    detector: Part | None = None
    descriptor: Part | None = None
    nearest: Part | None = None
    matcher: Part | None = None
    filters: tuple[Part, ...] = (Part("gms"), Part("fsc"))
    refine: bool = True
    common_rotation: bool = True


# Three levels fewer than the paper: no fewer correct matches at scales from 0.6 to 1.4, measured, and less to compute.
_FIVE_LEVELS = {"levels": 5}
_PAPER_OFAST = {
    "alpha": 2.0,
    "floor": 0.01,
    "quota_decay": 1.2,
    "support": 16.0,
    "edge": "eq5",
    "subpixel": "corner",
    "sigma": 2.0,
}
_PAPER_BRIEF = {"bits": 256, "radius": 16.0, "spread": 6.2, "sigma": 2.0}


def _opencv(name: str, *, ratio: float = 1.0) -> Preset:
    """A detector of OpenCV that describes its own points; a ratio below 1 stands for GMS, as is usual for L2 norms."""
    return Preset(
        f"OpenCV's {name.upper()}, detector and descriptor",
        detector=Part(name),
        nearest=Part("brute-force", {"mutual": False, "ratio": ratio}),
        filters=(Part("fsc"),) if ratio < 1 else (Part("gms"), Part("fsc")),
    )


PRESETS: Mapping[str, Preset] = {
    "sar-orb": Preset(
        "SAR-OFAST corners on a ROEWA edge pyramid, BRIEF in one common direction, GMS, FSC",
        detector=Part("sar-ofast", _FIVE_LEVELS),
        descriptor=Part("brief", _FIVE_LEVELS),
        nearest=Part("brute-force"),
    ),
    "sar-orb-paper": Preset(
        "SAR-OFAST, oriented BRIEF, GMS and FSC as in Wang et al. 2022",
        detector=Part("sar-ofast", _PAPER_OFAST),
        descriptor=Part("brief", _PAPER_BRIEF),
        nearest=Part("brute-force", {"mutual": False}),
        refine=False,
        common_rotation=False,
    ),
    "orb": _opencv("orb"),
    "akaze": _opencv("akaze"),
    "brisk": _opencv("brisk"),
    "sift": _opencv("sift", ratio=0.85),
    "kaze": _opencv("kaze", ratio=0.85),
}
