"""The picture of a displacement field: length and direction, standard error, and why cells have none."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from featreg.displacement.cells import Reason
from featreg.displacement.field import Offsets
from featreg.pictures.figures import written
from featreg.pictures.sheet import checked_target

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Arrows along the longer side.
ARROWS = 28
#: Of the reasons, in their order.
COLOURS = ("#ffffff", "#999999", "#56b4e9", "#e69f00", "#444444", "#d55e00")


def draw_offsets(field: Offsets, path: str | Path) -> None:
    """Write one PNG of a field.

    Raises
    ------
    InputError
        The folder is missing or the name does not end in .png.
    """
    checked_target(path)
    written(offsets_figure(field), path)


def offsets_figure(field: Offsets) -> Figure:
    """Return the picture of a field as a figure of matplotlib."""
    from matplotlib.colors import BoundaryNorm, ListedColormap
    from matplotlib.figure import Figure

    step = field.grid.step
    extent = (field.x[0] - step / 2, field.x[-1] + step / 2, field.y[-1] + step / 2, field.y[0] - step / 2)
    figure = Figure(figsize=(13, 3.9), dpi=110, layout="constrained")
    length, error, why = figure.subplots(1, 3)
    shown = length.imshow(field.magnitude, extent=extent, cmap="viridis")
    figure.colorbar(shown, ax=length, shrink=0.8)
    length.set_title("displacement (px), arrows not to scale", fontsize=10)
    every = max(1, -(-max(field.grid.cells) // ARROWS))
    some = np.s_[every // 2 :: every, every // 2 :: every]
    good = field.good[some]
    x, y = (axis[some][good] for axis in np.meshgrid(field.x, field.y))
    if good.any():
        length.quiver(x, y, field.dx[some][good], field.dy[some][good], color="white", angles="xy", width=0.004)
    deviation = np.sqrt(np.trace(field.covariance, axis1=2, axis2=3) / 2)
    top = float(np.nanpercentile(deviation[field.good], 98)) if field.good.any() else 1.0
    shown = error.imshow(np.where(field.good, deviation, np.nan), extent=extent, cmap="magma", vmin=0, vmax=top)
    figure.colorbar(shown, ax=error, shrink=0.8)
    error.set_title("standard error along an axis (px)", fontsize=10)
    norm = BoundaryNorm(np.arange(len(Reason) + 1) - 0.5, len(Reason))
    shown = why.imshow(field.reason, extent=extent, cmap=ListedColormap(COLOURS), norm=norm)
    bar = figure.colorbar(shown, ax=why, shrink=0.8, ticks=range(len(Reason)))
    bar.set_ticklabels([reason.name.lower().replace("_", " ") for reason in Reason])
    why.set_title("reason of a cell without displacement", fontsize=10)
    for panel in (length, error, why):
        panel.set_xlabel("column (px)", fontsize=8)
        panel.tick_params(labelsize=8)
    return figure
