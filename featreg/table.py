"""The table of a comparison: rows, the protocol under which they were made, and every way to print them."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from featreg.result_file import plain, write_atomic

NUMBERS = ("nm", "ncm", "precision", "rmse", "grid_rmse", "inliers", "rotation_deg", "time_s")
COLUMNS = ("pair", "method", "status", *NUMBERS, "reason")
COUNTS = ("nm", "ncm", "inliers")
#: What is best in a column, for the bold print; NM and rotation have no better and worse.
HIGHEST, LOWEST = ("ncm", "precision", "inliers"), ("rmse", "grid_rmse", "time_s")


@dataclass(frozen=True, eq=False)
class Table:
    """One row for each pair and method, the protocol under which they were made, and how to print them.

    Parameters
    ----------
    rows : dicts with the keys `COLUMNS`; a value that does not exist is None
    protocol : lines that say how the numbers came about
    """

    rows: Sequence[Mapping[str, Any]]
    protocol: Sequence[str] = field(default=())

    @property
    def failed(self) -> int:
        """Number of rows in which a method raised an error."""
        return sum(row["status"] == "failed" for row in self.rows)

    def summary(self) -> list[dict[str, Any]]:
        """Median and mean of each method where there are several pairs, else nothing.

        In a median a missing model counts as infinitely wrong, so that a method cannot win by giving up; a mean is
        over the rows that have the value.
        """
        if len({row["pair"] for row in self.rows}) < 2:
            return []
        found = []
        for statistic, reduce in (("median", np.median), ("mean", np.mean)):
            for method in dict.fromkeys(row["method"] for row in self.rows):
                rows = [row for row in self.rows if row["method"] == method]
                good = sum(row["status"] == "ok" for row in rows)
                made: dict[str, Any] = {"pair": statistic, "method": method, "status": f"{good}/{len(rows)} ok"}
                for name in NUMBERS:
                    worst = math.inf if (statistic, name) == ("median", "grid_rmse") else None
                    values = [
                        worst if row[name] is None and row["precision"] is not None else row[name] for row in rows
                    ]
                    there = [v for v in values if v is not None]
                    made[name] = float(reduce(there)) if there else None
                found.append(made | {"reason": ""})
        return found

    def to_markdown(self, path: str | Path | None = None) -> str:
        """Return (and write, where a path is given) the table, the summary and the protocol as Markdown."""
        columns, lines = self._columns(), []
        for row in (dict(zip(columns, columns, strict=True)), None, *self.rows, *self.summary()):
            cells = ["---"] * len(columns) if row is None else [_text(row, name) for name in columns]
            lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
        return _emit("\n".join([*lines, "", *(f"- {line}" for line in self.protocol)]) + "\n", path)

    def to_csv(self, path: str | Path | None = None) -> str:
        """Return (and write) the rows as CSV, numbers in full, without summary and protocol."""
        out = io.StringIO()
        writer = csv.DictWriter(out, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(self.rows)
        return _emit(out.getvalue(), path)

    def to_latex(self, path: str | Path | None = None) -> str:
        """Return (and write) a LaTeX tabular, the best value of each pair in bold, the protocol underneath."""
        columns, summary = self._columns(), self.summary()
        lines = [rf"\begin{{tabular}}{{{''.join('r' if c in NUMBERS else 'l' for c in columns)}}}", r"\hline"]
        lines += [" & ".join(_escape(c) for c in columns) + r" \\", r"\hline"]
        for part in (list(self.rows), summary):
            for row in part:
                rivals = [other for other in part if other["pair"] == row["pair"]]
                cells = (_escape(_text(row, name)) for name in columns)
                best = (_is_best(row, name, rivals) for name in columns)
                lines.append(
                    " & ".join(rf"\textbf{{{c}}}" if b else c for c, b in zip(cells, best, strict=True)) + r" \\"
                )
            lines += [r"\hline"] if part else []
        lines += [r"\end{tabular}", *(rf"\par{{\footnotesize {_escape(line)}}}" for line in self.protocol)]
        return _emit("\n".join(lines) + "\n", path)

    def to_json(self, path: str | Path | None = None) -> str:
        """Return (and write) one JSON object: rows, summary, protocol, failed."""
        whole = {"rows": self.rows, "summary": self.summary(), "protocol": self.protocol, "failed": self.failed}
        return _emit(json.dumps(plain(whole), indent=2, ensure_ascii=False) + "\n", path)

    def to_dataframe(self) -> Any:
        """Return the rows as a `pandas.DataFrame`."""
        import pandas as pd

        return pd.DataFrame(list(self.rows), columns=list(COLUMNS))

    def __str__(self) -> str:
        return self.to_markdown()

    def _columns(self) -> list[str]:
        return [c for c in COLUMNS if c != "reason" or any(row["reason"] for row in self.rows)]


def _text(row: Mapping[str, Any], name: str) -> str:
    value = row[name]
    if value is None:
        return ""
    if not isinstance(value, float):
        return str(value)
    return f"{value:g}" if name in COUNTS else f"{value:.3f}"


def _is_best(row: Mapping[str, Any], name: str, rivals: Sequence[Mapping[str, Any]]) -> bool:
    if name not in HIGHEST + LOWEST:
        return False
    values = [other[name] for other in rivals if other["status"] != "failed" and other[name] is not None]
    best = max if name in HIGHEST else min
    return len(values) > 1 and row["status"] != "failed" and bool(row[name] == best(values))


def _escape(text: str) -> str:
    for plain_text, latex in (("\\", r"\textbackslash "), ("{", r"\{"), ("}", r"\}")):
        text = text.replace(plain_text, latex)
    for sign in "&%$#_":
        text = text.replace(sign, f"\\{sign}")
    return text.replace("^", r"\^{}").replace("~", r"\~{}")


def _emit(text: str, path: str | Path | None) -> str:
    if path is not None:
        write_atomic(Path(path), text.encode())
    return text
