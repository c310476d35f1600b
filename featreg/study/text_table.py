"""A table of a comparison for a terminal: aligned columns, as many beside each other as fit, reasons below.

Lines are lists of (text, style) with the styles' names of rich; joined without styles they are plain text.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

from featreg.study.layouts import best_of, title_of

if TYPE_CHECKING:
    from featreg.study.table import Table

Line: TypeAlias = list[tuple[str, str]]

GAP = "  "
STYLES = {"ok": "", "unreliable": "yellow", "failed": "red"}
HEADING, BEST, QUIET = "bold", "bold green", "dim"
#: A name is not cut below so many characters.
NARROWEST = 12


def text_lines(
    table: Table,
    titles: Mapping[str, str],
    parts: Sequence[Sequence[Mapping[str, Any]]],
    judged: Sequence[Mapping[str, Any]],
    intervals: tuple[Sequence[Sequence[str]], str],
    width: int,
) -> list[Line]:
    """Return the lines of a table.

    Parameters
    ----------
    table : the comparison
    titles : column -> title
    parts : the rows to print, the summary apart
    judged : the summary without what flatters a method
    intervals : rows of the means with their intervals, titles first, and what is said below; may be empty
    width : characters of the terminal
    """
    reasons: list[str] = []
    numbers: dict[int, int] = {}
    for row in parts[0]:
        if row["status"] != "ok" and row["reason"]:
            text = f"{row['method']}: {row['reason']}"
            reasons += [] if text in reasons else [text]
            numbers[id(row)] = reasons.index(text) + 1
    names = [name for name in titles if name not in ("pair", "reason")]
    if "status" not in names:  # a layout of others
        names.insert(1, "status")
    heads = {name: title_of(name, titles.get(name, name)) for name in names} | {"status": "Status"}
    trusted = [row for row in table.rows if row["status"] == "ok"]
    rows: list[tuple[str, dict[str, tuple[str, str]]]] = []
    for k, (part, own) in enumerate(zip(parts, [parts[0], judged], strict=False)):
        pair = ""
        for row, fair in zip(part, own, strict=True):
            pair = row["pair"] or pair
            rivals = [other for other in (trusted if k == 0 else judged) if other["pair"] == pair]
            cells = {name: (table.cell(row, name), "") for name in names}
            if k == 0:
                mark = f" ({numbers[id(row)]})" if id(row) in numbers else ""
                cells["status"] = (f"{row['status']}{mark}", STYLES[row["status"]])
            for name, (text, _) in cells.items():
                won = (k > 0 or row["status"] == "ok") and text not in ("", "inf") and best_of(fair, name, rivals)
                cells[name] = (text, BEST) if won else cells[name]
            rows.append((pair, cells))
    fixed = [name for name in names if name in ("method", "status", "seed") or name in table.grid]
    lines = _chunks(rows, heads, fixed, [name for name in names if name not in fixed], width)
    lines += _intervals(*intervals, width)
    if reasons:
        lines += [[], *(_wrapped(f"({i}) {text}", width, STYLES["unreliable"]) for i, text in enumerate(reasons, 1))]
    return [*lines, [], *(_wrapped(f"- {line}", width, QUIET) for line in table.protocol)]


def _chunks(
    rows: Sequence[tuple[str, Mapping[str, tuple[str, str]]]],
    heads: Mapping[str, str],
    fixed: Sequence[str],
    others: Sequence[str],
    width: int,
) -> list[Line]:
    """The table; where it is too wide, one below the other with the `fixed` columns in each."""
    lines: list[Line] = []
    split = {name: _two_lines(head) for name, head in heads.items()}
    wide = {
        name: max([len(cells[name][0]) for _, cells in rows] + [len(part) for part in split[name]]) for name in heads
    }
    left = list(others)
    while True:
        chosen = list(fixed)
        while left and (
            len(chosen) == len(fixed) or sum(wide[n] + len(GAP) for n in [*chosen, left[0]]) - len(GAP) <= width
        ):
            chosen.append(left.pop(0))
        lines += [[]] if lines else []
        for i in (0, 1):
            cells = {name: (split[name][i], HEADING) for name in chosen}
            if any(text for text, _ in cells.values()):
                lines.append(_row(cells, chosen, fixed, wide))
        lines.append([("-" * min(width, sum(wide[n] + len(GAP) for n in chosen) - len(GAP)), QUIET)])
        last = None
        for pair, row in rows:
            if pair != last:
                lines.append([(textwrap.shorten(pair, width, placeholder=" ..."), "bold cyan")])
            lines.append(_row(row, chosen, fixed, wide))
            last = pair
        if not left:
            return lines


def _row(
    cells: Mapping[str, tuple[str, str]], names: Sequence[str], fixed: Sequence[str], wide: Mapping[str, int]
) -> Line:
    line: Line = []
    for name in names:
        text, style = cells[name]
        pad = " " * (wide[name] - len(text))
        words = ("method", "status")
        line += [(text, style), (pad, "")] if name in words else [(pad, ""), (text, style)]
        line.append((GAP, ""))
    return line[:-1]


def _two_lines(head: str) -> tuple[str, str]:
    """The words of a title in two lines, the second no longer than it must be."""
    first, _, last = head.rpartition(" ")
    return (first, last) if first else (last, "")


def _intervals(rows: Sequence[Sequence[str]], note: str, width: int) -> list[Line]:
    """The means with their intervals: a metric a line, since an interval is long."""
    if not rows:
        return [[], _wrapped(note, width, QUIET)] if note else []
    titles, *values = rows
    lines: list[Line] = [[], [(titles[0], HEADING)]]
    label = max(len(row[0]) for row in values)
    for k, name in enumerate(titles[1:], start=1):
        lines.append([(title_of(name, name), "bold cyan")])
        lines += [[(f"{row[0]:<{label}}{GAP}{row[k]}".rstrip(), "")] for row in values]
    return [*lines, _wrapped(note, width, QUIET)]


def _wrapped(text: str, width: int, style: str) -> Line:
    return [("\n".join(textwrap.wrap(text, max(40, width), subsequent_indent="    ")), style)]
