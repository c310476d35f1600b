"""The named methods: frozen data from which a pipeline is built, every part replaceable by a keyword."""

from __future__ import annotations

from featreg.presets.libraries import LIBRARIES
from featreg.presets.preset import Part, Preset
from featreg.presets.sar import SAR
from featreg.presets.targets import TARGETS

__all__ = ["DEFAULT_METHOD", "PRESETS", "Part", "Preset"]

#: What `featreg.match` takes where nothing is said.
DEFAULT_METHOD = "sar-orb"

#: Every method by name; `featreg.register_preset` adds to it.
PRESETS: dict[str, Preset] = {**SAR, **TARGETS, **LIBRARIES}
