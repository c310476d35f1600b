"""Charts of a comparison: for each metric, the pairs, the mean of every method over them and its interval."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from featreg.errors import ParameterError, suggest
from featreg.pictures.sheet import figure_class
from featreg.study.metrics import metric_of
from featreg.study.table import Table

#: Width and height of one chart and the height of a method in it, inches.
WIDTH, HEAD, LINE = 4.4, 0.75, 0.32
#: Charts beside each other.
ACROSS = 2
MEAN, PAIR = "#0b6bb8", "#9aa4b1"


def comparison(table: Table, metrics: Sequence[str] | None = None) -> Any:
    """Return a figure with one chart per metric.

    Parameters
    ----------
    table : of the comparison
    metrics : to draw; by default those that have a better side and a value

    Raises
    ------
    ParameterError
        A metric that the table does not have.
    """
    names = list(table.metrics) if metrics is None else list(metrics)
    for name in names:
        if name not in table.metrics:
            raise ParameterError(f"the table has no metric '{name}', {suggest(name, table.metrics)}")
    if metrics is None:
        names = [n for n in names if metric_of(n).better and any(row[n] is not None for row in table.rows)]
    methods, found = table.methods, table.intervals()
    rows = max(1, -(-len(names) // ACROSS))
    size = (WIDTH * min(ACROSS, max(1, len(names))), rows * (HEAD + LINE * max(1, len(methods))))
    figure = figure_class()(figsize=size, dpi=110, layout="constrained")
    for k, name in enumerate(names):
        axes = figure.add_subplot(rows, min(ACROSS, len(names)), k + 1)
        better = metric_of(name).better
        note = f" ({better} is better)" if better else ""
        axes.set_title(f"{name}{note}", fontsize=10, loc="left")
        for y, method in enumerate(methods):
            values = [row[name] for row in table.rows if row["method"] == method and row[name] is not None]
            axes.plot(values, np.full(len(values), y), "o", color=PAIR, markersize=4, alpha=0.7)
            spread = found[method][name]
            if spread.mean is not None:
                axes.plot([spread.mean], [y], "D", color=MEAN, markersize=6)
                if spread.told:
                    axes.plot([spread.low, spread.high], [y, y], color=MEAN, linewidth=2)
        axes.set_yticks(range(len(methods)), methods if k % ACROSS == 0 else [""] * len(methods), fontsize=9)
        axes.set_ylim(len(methods) - 0.5, -0.5)
        axes.tick_params(axis="x", labelsize=8)
        axes.locator_params(axis="x", nbins=5)
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(axis="x", color="#e3e7ed", linewidth=0.6)
        axes.set_axisbelow(True)
    return figure
