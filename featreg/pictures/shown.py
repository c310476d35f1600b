"""What notebooks show of stacks and displacement fields, beside what `featreg.pictures.interactive` shows."""

from __future__ import annotations

from typing import Any

import numpy as np

from featreg.displacement.cells import MEANINGS, Reason
from featreg.displacement.field import Offsets
from featreg.pictures.cards import card, folded, picture, table
from featreg.pictures.displacement import offsets_figure
from featreg.pictures.interactive import MOST_ROWS, figure_of, html_of, none_but
from featreg.pictures.stack import stack_figure
from featreg.stacks.stack import Stack

__all__ = ["figure_of", "html_of"]


@html_of.register
def _(stack: Stack) -> str:
    kept = sum(status == "ok" for status in stack.status)
    facts = [
        ("images", f"{kept} of {len(stack.names)} on the grid of {stack.names[stack.reference]}"),
        ("pairs", f"{len(stack.pairs)}, of which {len(stack.rejected)} contradict the others"),
        ("jumps", "; ".join(f"before image {j.image}: {j.dx:+.2f}, {j.dy:+.2f} px" for j in stack.jumps) or "none"),
    ]
    numbers = ("dx", "dy", "rotation_deg", "scale", "standard_error", "closure")
    titles = ("image", *numbers, "status", "reason")
    rows = [
        [row["image"], *(_number(row[name]) for name in numbers), row["status"], row["reason"]]
        for row in stack.rows()[:MOST_ROWS]
    ]
    kinds = [["", *["number"] * len(numbers), "ok" if row[-2] == "ok" else "failed", "words"] for row in rows]
    left = len(stack.names) - len(rows)
    more = f"<p>{left} further images are not shown</p>" if left > 0 else ""
    words = folded("What was left out, and why", stack.explain().splitlines())
    figures = [_drawn(stack_figure(stack), "shift, rotation and closure over time")]
    return card("Stack", facts, figures=figures, body=table(titles, rows, kinds) + more + words)


@html_of.register
def _(field: Offsets) -> str:
    rows, cols = field.grid.cells
    facts = [
        ("cells", f"{rows} x {cols} of {field.grid.step} px"),
        ("windows", f"{field.grid.window} px"),
        ("measured", f"{100 * float(field.good.mean()):.1f} %"),
    ]
    if field.good.any():
        facts.append(("displacement", f"median {np.nanmedian(field.magnitude):.2f} px, largest "
                                      f"{np.nanmax(field.magnitude):.2f} px"))  # fmt: skip
    counts = [(reason, int((field.reason == reason).sum())) for reason in Reason]
    lines = [(reason.name.lower().replace("_", " "), str(count), MEANINGS[reason]) for reason, count in counts if count]
    kinds = [["", "number", "words"] for _ in lines]
    figures = [_drawn(offsets_figure(field), "length and direction, standard error, reasons")]
    return card("Offsets", facts, figures=figures, body=table(("reason", "cells", "meaning"), lines, kinds))


@figure_of.register
def _(stack: Stack, **options: Any) -> Any:
    none_but(options)
    return stack_figure(stack)


@figure_of.register
def _(field: Offsets, **options: Any) -> Any:
    none_but(options)
    return offsets_figure(field)


def _number(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.4g}"


def _drawn(figure: Any, caption: str) -> str:
    """A figure of matplotlib as a picture of a card."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    return picture(np.asarray(canvas.buffer_rgba())[..., :3], caption)
