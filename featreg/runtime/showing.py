"""What interactive Python shows of an object: HTML and figures, drawn by a higher floor."""

from __future__ import annotations

from typing import Any

from featreg.runtime.deferred import job


def html_of(shown: Any) -> str:
    """Return an object as a fragment of HTML."""
    return str(job("html")(shown))


def figure_of(shown: Any, **options: Any) -> Any:
    """Return a `matplotlib.figure.Figure` of an object."""
    return job("figure")(shown, **options)


class Shown:
    """What a notebook shows as HTML."""

    def _repr_html_(self) -> str:
        return html_of(self)
