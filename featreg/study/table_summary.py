"""What the rows of a comparison say together: medians and means, intervals, differences, the map of a grid."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from featreg.errors import ParameterError, suggest
from featreg.study.intervals import Interval, interval
from featreg.study.metrics import metric_of

if TYPE_CHECKING:
    from featreg.study.table import Table


def summary_of(table: Table) -> list[dict[str, Any]]:
    """Return `Table.summary`."""
    if len({(row["pair"], row.get("seed")) for row in table.rows}) < 2:
        return []
    found = []
    for statistic, reduce in (("median", np.median), ("mean", np.mean)):
        for method in table.methods:
            rows = [row for row in table.rows if row["method"] == method]
            good = sum(row["status"] == "ok" for row in rows)
            made: dict[str, Any] = dict.fromkeys(table.columns)
            made |= {"pair": statistic, "method": method, "status": f"{good}/{len(rows)} ok", "reason": ""}
            made |= {name: rows[0][name] for name in table.grid}
            for name in table.metrics:
                worst = math.inf if (statistic, name) == ("median", "grid_rmse") else None
                values = [worst if row[name] is None and _has_truth(row) else row[name] for row in rows]
                there = [v for v in values if v is not None]
                made[name] = float(reduce(there)) if there else None
            found.append(made)
    return found


def intervals_of(table: Table) -> dict[str, dict[str, Interval]]:
    """Return `Table.intervals`."""
    return {
        method: {name: _interval(table, name, _values(table, method, name)) for name in table.metrics}
        for method in table.methods
    }


def differences_of(table: Table, baseline: str | None) -> dict[str, dict[str, Interval]]:
    """Return `Table.differences`."""
    first = table.methods[0] if baseline is None else baseline
    if first not in table.methods:
        raise ParameterError(f"no method '{first}' in the table, {suggest(first, table.methods)}")
    found: dict[str, dict[str, Interval]] = {}
    for method in table.methods:
        if method == first:
            continue
        found[method] = {}
        for name in table.metrics:
            base = _values(table, first, name)
            here = _values(table, method, name)
            shared = {key: value - base[key] for key, value in here.items() if key in base}
            found[method][name] = _interval(table, name, shared, difference=True)
    return found


def pivot_of(table: Table, row: str, column: str, metric: str) -> tuple[list[Any], list[Any], list[list[float | None]]]:
    """Return `Table.pivot`."""
    for name in (row, column, metric):
        if name not in table.columns:
            raise ParameterError(f"the table has no column '{name}', {suggest(name, table.columns)}")
    # By their text: 1 and True are equal as keys.
    down = list({repr(r[row]): r[row] for r in table.rows}.values())
    across = list({repr(r[column]): r[column] for r in table.rows}.values())
    cells: list[list[float | None]] = []
    for y in down:
        line: list[float | None] = []
        for x in across:
            here = [r[metric] for r in table.rows if (repr(r[row]), repr(r[column])) == (repr(y), repr(x))]
            there = [float(value) for value in here if value is not None]
            line.append(math.fsum(there) / len(there) if there else None)
        cells.append(line)
    return down, across, cells


def judged_summary(table: Table) -> list[dict[str, Any]]:
    """Return the summary without what flatters a method: times and errors that leave out the rows it gave up."""
    found = summary_of(table)
    for row in found:
        rows = [r for r in table.rows if r["method"] == row["method"]]
        for name in table.metrics:
            counted = (row["pair"], name) == ("median", "grid_rmse")
            if metric_of(name).better == "lower" and not counted and any(r[name] is None for r in rows):
                row[name] = None
    return found


def _values(table: Table, method: str, metric: str) -> dict[tuple[Any, Any], float]:
    """(pair, seed) -> value, where there is one."""
    rows = [row for row in table.rows if row["method"] == method and row[metric] is not None]
    return {(row["pair"], row.get("seed")): float(row[metric]) for row in rows}


def _interval(
    table: Table, metric: str, values: Mapping[tuple[Any, Any], float], *, difference: bool = False
) -> Interval:
    groups: dict[Any, list[float]] = {}
    for (pair, _), value in values.items():
        groups.setdefault(pair, []).append(value)
    low, high = metric_of(metric).bounds
    bounds = (low - high, high - low) if difference else (low, high)
    found = interval(list(groups.values()), table.confidence, bounds=bounds)
    return replace(found, missing=len({row["pair"] for row in table.rows}) - len(groups))


def _has_truth(row: Mapping[str, Any]) -> bool:
    """Whether a grid RMSE that is missing means that the model is."""
    return any(row.get(name) is not None for name in ("precision", "ncm"))
