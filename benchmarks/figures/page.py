"""A figure with its caption, and the page that holds them all: one file, without anything from elsewhere."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.runtime.files import write_atomic

STYLE = """
:root { color-scheme: light dark; --line: #8886; }
body { max-width: 68rem; margin: 2rem auto; padding: 0 1rem; font: 16px/1.5 system-ui, sans-serif; }
h2 { margin-top: 3rem; border-bottom: 1px solid var(--line); }
figure { margin: 2rem 0; }
img { max-width: 100%; background: white; border: 1px solid var(--line); }
figcaption { margin-top: .5rem; }
.paper { font-weight: 600; }
.note { opacity: .8; }
""".strip()


@dataclass(frozen=True, eq=False)
class Figure:
    """One drawn figure.

    Parameters
    ----------
    number : of the figure in its paper, as "Figure 5"
    title : what it shows
    shown : what is drawn here, from which data
    beside : how it compares with the paper's
    png : the picture
    """

    number: str
    title: str
    shown: str
    beside: str
    png: bytes

    @classmethod
    def of(cls, number: str, title: str, shown: str, beside: str, drawn: Any) -> Figure:
        """Of a figure of matplotlib, which is closed."""
        import matplotlib.pyplot as plt

        out = io.BytesIO()
        drawn.savefig(out, format="png", dpi=100)
        plt.close(drawn)
        return cls(number, title, shown, beside, out.getvalue())


def axes(rows: int, columns: int, size: tuple[float, float]) -> tuple[Any, NDArray[Any]]:
    """A figure of matplotlib and its (rows, columns) axes."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    drawn, made = plt.subplots(rows, columns, figsize=size, layout="constrained", squeeze=False)
    return drawn, np.asarray(made)


def show(place: Any, image: NDArray[Any], title: str = "", decibels: float = 40.0) -> None:
    """An amplitude image in decibels below its brightest 0.1 %."""
    amplitude = np.abs(image).astype(np.float64)
    top = max(float(np.quantile(amplitude, 0.999)), 1e-30)
    level = 20 * np.log10(np.maximum(amplitude, 1e-30) / top)
    place.imshow(level, cmap="gray", vmin=-decibels, vmax=0, interpolation="none")
    place.set(xticks=[], yticks=[], title=title)


def ranked(values: Mapping[str, float], unit: str = "", digits: int = 0) -> str:
    """Names and their values, to so many digits behind the point, from the largest to the smallest, in words."""
    order = sorted(values, key=lambda name: -values[name])
    return ", ".join(f"{name} {values[name]:.{digits}f}{unit}" for name in order)


def write_page(path: Path, parts: Sequence[tuple[str, str, Sequence[Figure]]], head: str) -> None:
    """Write (paper, what is said of it, its figures) of every paper, below one line of text."""
    lines = [
        "<!doctype html>", '<html lang="en">', '<meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        "<title>Figures of three papers, drawn by featreg</title>", f"<style>{STYLE}</style>",
        "<h1>Figures of three papers, drawn by featreg</h1>", f"<p>{html.escape(head)}</p>",
    ]  # fmt: skip
    for paper, said, figures in parts:
        lines += [f"<h2>{html.escape(paper)}</h2>", f"<p>{html.escape(said)}</p>"]
        for figure in figures:
            picture = base64.b64encode(figure.png).decode("ascii")
            name = f"{figure.number}: {figure.title}"
            lines += [
                f'<figure><img alt="{html.escape(name, quote=True)}" src="data:image/png;base64,{picture}">',
                f'<figcaption><span class="paper">{html.escape(name)}.</span> {html.escape(figure.shown)} '
                f'<span class="note">{html.escape(figure.beside)}</span></figcaption></figure>',
            ]
    write_atomic(path, ("\n".join(lines) + "\n").encode())
