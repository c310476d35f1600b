"""The table of a comparison: rows, the protocol under which they were made, and every way to print them."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from featreg.errors import InputError, ParameterError, suggest
from featreg.results.json_file import plain
from featreg.runtime.files import check_ending, write_atomic
from featreg.runtime.optional import import_pandas
from featreg.runtime.showing import Shown, figure_of
from featreg.study.intervals import FEWEST, Interval
from featreg.study.latex import latex
from featreg.study.layouts import LAYOUTS, columns_of
from featreg.study.metrics import STANDARD, metric_of
from featreg.study.table_summary import differences_of, intervals_of, judged_summary, pivot_of, summary_of
from featreg.study.text_table import text_lines

COLUMNS = ("pair", "method", "status", *STANDARD, "reason")
#: Columns that are no metric.
HEAD, TAIL = ("pair", "method", "seed"), ("status", "reason")


@dataclass(frozen=True, eq=False)
class Table(Shown):
    """One row for each pair, method and seed, the protocol under which they were made, and how to print them.

    Parameters
    ----------
    rows : dicts with the keys `COLUMNS`, or with other metrics in place of the standard ones, a "seed" where there are
        several, and the parameters of a grid after "method"; a value that does not exist is None
    protocol : lines that say how the numbers came about
    confidence : of the intervals
    """

    rows: Sequence[Mapping[str, Any]]
    protocol: Sequence[str] = field(default=())
    confidence: float = 0.95

    @property
    def columns(self) -> tuple[str, ...]:
        """The keys of the rows."""
        return tuple(self.rows[0]) if self.rows else COLUMNS

    @property
    def metrics(self) -> tuple[str, ...]:
        """The columns that hold metrics."""
        columns = self.columns
        return columns[columns.index("status") + 1 : columns.index("reason")]

    @property
    def grid(self) -> tuple[str, ...]:
        """The columns that hold parameters of a grid."""
        columns = self.columns
        return tuple(c for c in columns[: columns.index("status")] if c not in HEAD)

    @property
    def methods(self) -> tuple[str, ...]:
        """The labels of the methods, in order."""
        return tuple(dict.fromkeys(row["method"] for row in self.rows))

    @property
    def failed(self) -> int:
        """Number of rows in which a method raised an error, hung or died."""
        return sum(row["status"] == "failed" for row in self.rows)

    def summary(self) -> list[dict[str, Any]]:
        """Median and mean of each method where there are several rows of it, else nothing.

        In a median a missing model counts as infinitely wrong, so that a method cannot win by giving up; a mean is
        over the rows that have the value.
        """
        return summary_of(self)

    def intervals(self) -> dict[str, dict[str, Interval]]:
        """Method -> metric -> mean over the pairs with its bootstrap interval (see `featreg.study.intervals`)."""
        return intervals_of(self)

    def differences(self, baseline: str | None = None) -> dict[str, dict[str, Interval]]:
        """Method -> metric -> mean difference from a baseline, over what both have, with its interval.

        Parameters
        ----------
        baseline : a method's label, by default the first

        Raises
        ------
        ParameterError
            No method of that label.

        Notes
        -----
        Paired: each pair and seed is compared with itself, so that what makes an image pair hard for both drops out.
        """
        return differences_of(self, baseline)

    def pivot(self, row: str, column: str, metric: str) -> tuple[list[Any], list[Any], list[list[float | None]]]:
        """(row values, column values, mean of a metric at each of their combinations): the data of a heat map.

        Raises
        ------
        ParameterError
            A column that the table does not have.
        """
        return pivot_of(self, row, column, metric)

    def to_markdown(self, path: str | Path | None = None, *, layout: str | None = None) -> str:
        """Return (and write, where a path is given) the table, the summary and the protocol as Markdown.

        `layout` is "table2" or "table3" for those of the SAR-ORB paper.
        """
        columns, parts = self._shown(layout)
        lines = [_line(columns.values()), _line(["---"] * len(columns))]
        lines += [_line(_text(row, name) for name in columns) for part in parts for row in part]
        if layout is None:
            lines += self._interval_lines()
        return _emit("\n".join([*lines, "", *(f"- {line}" for line in self.protocol)]) + "\n", path, ".md")

    def to_text(self, *, layout: str | None = None, width: int = 100) -> str:
        """Return the table as aligned plain text of at most `width` characters a line, names that are longer apart."""
        return "\n".join("".join(text for text, _ in line) for line in self.styled_lines(layout, width)) + "\n"

    def styled_lines(self, layout: str | None = None, width: int = 100) -> list[list[tuple[str, str]]]:
        """Return the lines of `to_text` as lists of (text, style), styles as rich names them."""
        columns, parts = self._shown(layout)
        told = any(one.told for found in self.intervals().values() for one in found.values())
        intervals = self._interval_rows()
        if not told:  # means without intervals stand in the summary
            intervals = [], intervals[1]
        return text_lines(
            self,
            columns,
            parts,
            judged_summary(self) if layout is None else [],
            intervals if layout is None else ([], ""),
            width,
        )

    def to_csv(self, path: str | Path | None = None, *, layout: str | None = None) -> str:
        """Return (and write) the rows as CSV, numbers in full, without summary and protocol."""
        columns, parts = self._shown(layout)
        names = list(self.columns) if layout is None else list(columns)
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(names if layout is None else columns.values())
        writer.writerows([row.get(name) for name in names] for row in (self.rows if layout is None else parts[0]))
        return _emit(out.getvalue(), path, ".csv")

    def to_latex(
        self,
        path: str | Path | None = None,
        *,
        layout: str | None = None,
        caption: str | None = None,
        label: str = "featreg",
    ) -> str:
        """Return (and write) a LaTeX table for ``booktabs``.

        Parameters
        ----------
        path : file to write
        layout : "table2" or "table3" for those of the SAR-ORB paper
        caption : plain text; by default what is compared, over how many pairs
        label : the table is ``\\ref{tab:label}``

        Notes
        -----
        The best value of each pair is bold, among trusted results only. Refused and failed results are marked, and
        their reasons stand below with the protocol.
        """
        columns, parts = self._shown(layout)
        return _emit(
            latex(self, columns, parts, judged_summary(self) if layout is None else [], caption, label), path, ".tex"
        )

    def to_json(self, path: str | Path | None = None) -> str:
        """Return (and write) one JSON object: rows, summary, intervals, differences, protocol, failed."""
        whole = {
            "rows": self.rows,
            "summary": self.summary(),
            "intervals": self.intervals(),
            "differences": self.differences() if len(self.methods) > 1 else {},
            "confidence": self.confidence,
            "protocol": self.protocol,
            "failed": self.failed,
        }
        return _emit(json.dumps(plain(whole), indent=2, ensure_ascii=False) + "\n", path, ".json")

    def to_dataframe(self) -> Any:
        """Return the rows as a `pandas.DataFrame`."""
        return import_pandas().DataFrame([dict(row) for row in self.rows], columns=list(self.columns))

    def to_parquet(self, path: str | Path) -> None:
        """Write the rows as Parquet, the protocol in the file's metadata under "featreg".

        Raises
        ------
        InputError
            The file cannot be written, or a column mixes kinds of values.
        """
        check_ending(path, ".parquet")
        import pyarrow as pa
        import pyarrow.parquet as pq

        try:
            arrow = pa.table({name: [plain(row[name]) for row in self.rows] for name in self.columns})
        except pa.ArrowException as error:
            raise InputError(f"the table cannot be written as Parquet: {error}") from error
        note = json.dumps({"protocol": list(self.protocol), "confidence": self.confidence})
        sink = pa.BufferOutputStream()
        pq.write_table(arrow.replace_schema_metadata({"featreg": note}), sink, compression="zstd")
        write_atomic(Path(path), sink.getvalue().to_pybytes())

    def cell(self, row: Mapping[str, Any], name: str) -> str:
        """Return the value of a column as it is printed, empty where there is none."""
        return _text(row, name)

    def plot(self, metrics: Sequence[str] | None = None) -> Any:
        """Return a `matplotlib.figure.Figure`: for each metric the pairs, the mean of each method and its interval.

        Parameters
        ----------
        metrics : by default those of which more or less is better
        """
        return figure_of(self, metrics=metrics)

    def __repr__(self) -> str:
        pairs = len({row["pair"] for row in self.rows})
        failed = f", {self.failed} failed" if self.failed else ""
        return f"Table({len(self.rows)} rows: {pairs} pairs by {len(self.methods)} methods{failed})"

    def __str__(self) -> str:
        return self.to_markdown()

    def _shown(self, layout: str | None) -> tuple[dict[str, str], list[list[Mapping[str, Any]]]]:
        """Column -> title, and the rows to print, the summary apart."""
        if layout is None:
            kept = [c for c in self.columns if c != "reason" or any(row["reason"] for row in self.rows)]
            return dict(zip(kept, kept, strict=True)), [list(self.rows), list(self.summary())]
        if layout not in LAYOUTS:
            raise ParameterError(f"unknown layout '{layout}', {suggest(layout, LAYOUTS)}")
        return columns_of(layout, self.columns, self.rows)

    def _interval_rows(self) -> tuple[list[list[str]], str]:
        """The means with their intervals, titles first, and what is said of them; nothing where there are none."""
        found = self.intervals()
        named = [n for n in self.metrics if metric_of(n).better]
        names = [n for n in named if any(f[n].low is not None for f in found.values())]
        if not names:
            return [], ""
        rest = self.differences() if len(found) > 1 else {}
        title = f"{self.confidence:.0%} intervals".replace("%", " %")
        rows = [[f"mean [{title}]", *names], *([method, *(str(f[n]) for n in names)] for method, f in found.items())]
        rows += [[f"{method} minus {self.methods[0]}", *(_signed(f[n]) for n in names)] for method, f in rest.items()]
        unit = " and ".join(sorted({f[n].over for f in found.values() for n in names}))
        count = max(f[n].count for f in found.values() for n in names)
        note = f"n = {count} {unit}; studentised bootstrap over them; * a difference whose interval leaves out zero"
        if unit == "pairs" and count < FEWEST:
            note = f"n = {count} pairs: too few for an interval (from {FEWEST} on)"
        if any(f[n].missing for f in [*found.values(), *rest.values()] for n in names):
            note += "; 'without N': N pairs have no value, and a mean that leaves them out flatters the method"
        return rows, f"{note}."

    def _interval_lines(self) -> list[str]:
        """The means with their intervals as Markdown."""
        rows, note = self._interval_rows()
        if not rows:
            return []
        titles, *values = map(_line, rows)
        return ["", titles, _line(["---"] * len(rows[0])), *values, "", note]


def _line(cells: Any) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _signed(found: Interval) -> str:
    if found.mean is None:
        return ""
    text = str(found)
    return f"{text if text.startswith('-') else '+' + text}{' *' if found.told and found.excludes_zero else ''}"


def _text(row: Mapping[str, Any], name: str) -> str:
    value = row.get(name)
    if value is None:
        return ""
    if isinstance(value, bool) or not isinstance(value, float):
        return str(value)
    if name in HEAD + TAIL:
        return str(value)
    try:
        count = metric_of(name).count
    except LookupError:
        return f"{value:g}"
    return f"{value:g}" if count else f"{value:.3f}"


def _emit(text: str, path: str | Path | None, ending: str) -> str:
    if path is not None:
        check_ending(path, ending)
        write_atomic(Path(path), text.encode())
    return text
