"""What a lower floor may ask of a higher one: functions by a name of their own, imported when first asked for.

A type cannot draw or warp itself, for what draws and warps knows the type and stands above it. The package itself,
which alone knows every floor, names the functions (`declare`); whoever calls one (`job`) knows no more than its name.
"""

from __future__ import annotations

import importlib
from typing import Any

_places: dict[str, str] = {}


def declare(**places: str) -> None:
    """Name functions: ``name="module:function"``."""
    _places.update(places)


def job(name: str) -> Any:
    """Return the function of a name."""
    module, _, function = _places[name].partition(":")
    return getattr(importlib.import_module(module), function)
