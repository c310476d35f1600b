"""The picture of a stack: position, rotation and closure of every date over time, jumps marked and said in words."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from featreg.pictures.figures import written
from featreg.pictures.sheet import checked_target
from featreg.stacks.stack import Stack

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Blue and vermillion, told apart by colour-blind eyes, and gray.
ALONG_X, ALONG_Y, FAINT = "#0072b2", "#d55e00", "#888888"


def draw_stack(stack: Stack, path: str | Path) -> None:
    """Write one PNG of a stack.

    Raises
    ------
    InputError
        The folder is missing or the name does not end in .png.
    """
    checked_target(path)
    written(stack_figure(stack), path)


def stack_figure(stack: Stack) -> Figure:
    """Return the picture of a stack as a figure of matplotlib."""
    from matplotlib.figure import Figure

    rows = stack.rows()
    names = ("dx", "dy", "standard_error", "rotation_deg", "closure")
    table = {name: np.array([row[name] for row in rows], np.float64) for name in names}
    at = np.arange(len(rows))
    figure = Figure(figsize=(9, 6.5), dpi=110, layout="constrained")
    top, middle, bottom = figure.subplots(3, 1, sharex=True, height_ratios=[3, 1.2, 1.4])
    for name, colour, label in (("dx", ALONG_X, "along x"), ("dy", ALONG_Y, "along y")):
        top.errorbar(
            at, table[name], yerr=2 * table["standard_error"], color=colour, label=label, marker="o", capsize=2
        )
    for jump in stack.jumps:
        for panel in (top, middle, bottom):
            panel.axvline(jump.image - 0.5, color="black", linestyle="--", linewidth=1)
        top.annotate(
            f"jump ({jump.dx:+.2f}, {jump.dy:+.2f}) px", (jump.image - 0.5, 1), (4, -12),
            xycoords=("data", "axes fraction"), textcoords="offset points", fontsize=9, fontweight="bold",
        )  # fmt: skip
    for i, status in enumerate(stack.status):
        if status != "ok":
            for panel in (top, middle, bottom):
                panel.axvspan(i - 0.5, i + 0.5, color="#eeeeee")
            top.text(i, 0.02, "left out", rotation=90, ha="center", va="bottom", color=FAINT,
                     transform=top.get_xaxis_transform())  # fmt: skip
    top.axhline(0, color=FAINT, linewidth=0.6)
    top.set_ylabel("shift of the centre (px)\n± 2 standard errors")
    top.legend(loc="best", frameon=False)
    middle.plot(at, table["rotation_deg"], color=ALONG_X, marker="o")
    middle.set_ylabel("rotation (deg)")
    bottom.bar(at, table["closure"], color=FAINT)
    bottom.set_ylabel("closure (px)")
    bottom.set_xticks(at, [Path(name).stem for name in stack.names], rotation=45, ha="right", fontsize=8)
    kept = sum(status == "ok" for status in stack.status)
    words = f"{kept} of {len(stack.names)} images on the grid of {Path(stack.names[stack.reference]).stem}"
    words += f", pairs thrown out: {len(stack.rejected)}, jumps: {len(stack.jumps)}"
    figure.suptitle(words, fontsize=11)
    return figure
