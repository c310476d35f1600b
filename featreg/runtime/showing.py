"""How objects show themselves in notebooks, though what draws them stands on a higher floor.

The package itself, which alone knows every floor, names the module that draws (`drawn_by`). It is imported when the
first object is to be shown. It has two functions: ``html_of(shown)`` returns a fragment of HTML, ``figure_of(shown,
**options)`` a figure of matplotlib.
"""

from __future__ import annotations

import importlib
from typing import Any

_module = ""


def drawn_by(module: str) -> None:
    """Name the module that draws."""
    global _module  # set once, when the package is imported
    _module = module


def html_of(shown: Any) -> str:
    """Return an object as a fragment of HTML."""
    return str(importlib.import_module(_module).html_of(shown))


def figure_of(shown: Any, **options: Any) -> Any:
    """Return a figure of an object."""
    return importlib.import_module(_module).figure_of(shown, **options)


class Shown:
    """What a notebook shows as HTML."""

    def _repr_html_(self) -> str:
        return html_of(self)
