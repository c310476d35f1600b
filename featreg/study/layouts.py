"""Tables as others have printed them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from featreg.errors import ParameterError, UnknownNameError
from featreg.study.metrics import metric_of

#: Layout -> column -> title, as in Tables 2 and 3 of the SAR-ORB paper, and the time of a scene beside that of its
#: blocks.
LAYOUTS: Mapping[str, Mapping[str, str]] = {
    "table2": {
        "pair": "Image pair", "method": "Method", "ncm": "NCM", "rmse": "RMSE", "time_s": "Computational time (s)",
    },
    "table3": {
        "pair": "Image pair", "method": "Method", "blocks": "Blocks", "nm": "NM", "ncm": "NCM",
        "precision": "Precision", "rmse": "RMSE", "act": "ACT (s)", "around_s": "Around (s)",
    },
}  # fmt: skip
#: Metrics that a layout needs.
NEEDS: Mapping[str, tuple[str, ...]] = {
    name: tuple(column for column in columns if column not in ("pair", "method")) for name, columns in LAYOUTS.items()
}


#: Column -> title with its unit, where a table is set for a reader who does not know the names of the columns.
TITLES: Mapping[str, str] = {
    "pair": "Image pair", "method": "Method", "seed": "Seed", "nm": "NM", "ncm": "NCM", "precision": "Precision",
    "rmse": "RMSE (px)", "grid_rmse": "Grid RMSE (px)", "inliers": "Tie points", "rotation_deg": "Rotation (°)",
    "time_s": "Time (s)", "act": "ACT (s)", "around_s": "Around (s)", "blocks": "Blocks", "spread": "Spread",
    "mma": "MMA", "repeatability": "Repeatability", "recall": "Recall", "matching_score": "Matching score",
    "failed": "Failed", "refused": "Refused",
}  # fmt: skip
#: The same of metrics of a number of pixels.
FAMILY_TITLES: Mapping[str, str] = {"mma": "MMA", "success": "Success", "auc": "AUC", "wrong": "Wrong"}


def title_of(name: str, title: str) -> str:
    """Return what a column is called in a paper: its title of a layout, else the field's name with its unit."""
    if title != name:
        return {"RMSE": "RMSE (px)"}.get(title, title)
    if name in TITLES:
        return TITLES[name]
    word, _, pixels = name.partition("@")
    if pixels and word in FAMILY_TITLES:
        return f"{FAMILY_TITLES[word]} at {pixels} px"
    if name.startswith("act."):
        return f"{name.removeprefix('act.')} (s)"
    return name


def columns_of(
    layout: str, columns: Sequence[str], rows: Sequence[Mapping[str, Any]]
) -> tuple[dict[str, str], list[list[Mapping[str, Any]]]]:
    """Column -> title, and the rows of a layout: the name of a pair stands in its first row only.

    Raises
    ------
    ParameterError
        The table lacks a metric that the layout shows.
    """
    optional = ("blocks", "around_s")
    missing = [name for name in NEEDS[layout] if name not in columns and name not in optional]
    if missing:
        raise ParameterError(f"layout '{layout}' needs the metrics {', '.join(NEEDS[layout])}; {missing[0]} is missing")
    titles = {name: title for name, title in LAYOUTS[layout].items() if name in columns or name not in optional}
    if "seed" in columns:
        titles = {"pair": titles.pop("pair"), "method": titles.pop("method"), "seed": "Seed", **titles}
    shown: list[Mapping[str, Any]] = []
    last = None
    for row in sorted(rows, key=lambda row: [r["pair"] for r in rows].index(row["pair"])):
        shown.append({**row, "pair": "" if row["pair"] == last else row["pair"]})
        last = row["pair"]
    return titles, [shown]


def best_of(row: Mapping[str, Any], name: str, rivals: Sequence[Mapping[str, Any]]) -> bool:
    """Whether a row has the best value of a column among its rivals, which must be more than one."""
    try:
        better = metric_of(name).better
    except (UnknownNameError, ParameterError):
        return False
    values = [other[name] for other in rivals if other["status"] != "failed" and other[name] is not None]
    if not better or len(values) < 2 or row["status"] == "failed":
        return False
    return bool(row[name] == (max if better == "higher" else min)(values))
