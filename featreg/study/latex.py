"""A table of a comparison in LaTeX, ready to be put into a paper: booktabs, units, caption and label, notes below.

The document needs ``\\usepackage{booktabs}``, no more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from featreg.study.layouts import best_of, title_of

if TYPE_CHECKING:
    from featreg.study.table import Table

#: What LaTeX reads as a command, or prints as another sign in its usual font encoding.
SIGNS = str.maketrans(
    {sign: f"\\{sign}" for sign in "{}&%$#_"}
    | {"\\": r"\textbackslash{}", "^": r"\^{}", "~": r"\~{}", "<": r"\textless{}", ">": r"\textgreater{}",
       "|": r"\textbar{}", "°": r"$^{\circ}$", "±": r"$\pm$", "×": r"$\times$", "…": r"\dots{}"}
)  # fmt: skip
#: Columns of a table that still fits on a page in the document's own size.
WIDE = 8
#: Behind a method whose result on the pair is not to be trusted, and one that failed.
MARKS = {"unreliable": r"$^{\dagger}$", "failed": r"$^{\ddagger}$"}


def latex(
    table: Table,
    titles: Mapping[str, str],
    parts: Sequence[Sequence[Mapping[str, Any]]],
    judged: Sequence[Mapping[str, Any]],
    caption: str | None,
    label: str,
) -> str:
    """Return a table environment.

    Parameters
    ----------
    table : the comparison
    titles : column -> title
    parts : the rows to print, the summary apart
    judged : the summary without what flatters a method
    caption : plain text; None says what is compared, and over how many pairs
    label : for references, without "tab:"
    """
    columns = [name for name in titles if name not in ("status", "reason")]
    sides = "".join("r" if name in table.metrics else "l" for name in columns)
    fair: list[Sequence[Mapping[str, Any]]] = [parts[0], judged]
    trusted = [row for row in table.rows if row["status"] == "ok"]
    body: list[str] = []
    for k, (part, own) in enumerate(zip(parts, fair, strict=False)):
        if not part:
            continue
        body += [r"\midrule"]
        pair = ""
        for row, judged_row in zip(part, own, strict=True):
            pair = row["pair"] or pair
            rivals = [other for other in (trusted if k == 0 else judged) if other["pair"] == pair]
            body.append(_row(table, columns, row, judged_row, rivals, summary=k > 0))
    heads = _heads([title_of(name, titles[name]) for name in columns])
    size = [r"\scriptsize", r"\setlength{\tabcolsep}{2pt}"] if len(columns) > WIDE else []
    lines = [
        "% needs \\usepackage{booktabs}",
        r"\begin{table}[htbp]",
        r"\centering",
        rf"\caption{{{escape(default_caption(table) if caption is None else caption)}}}",
        rf"\label{{tab:{label}}}",
        *size,
        rf"\begin{{tabular}}{{{sides}}}",
        r"\toprule",
        *heads,
        *body,
        r"\bottomrule",
        r"\end{tabular}",
        *(rf"\par\vspace{{2pt}}{{\raggedright\footnotesize {note}\par}}" for note in _notes(table, len(trusted))),
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"


def default_caption(table: Table) -> str:
    """Return what a table shows in one sentence."""
    pairs = len({row["pair"] for row in table.rows})
    seeds = len({row.get("seed") for row in table.rows})
    methods = len(table.methods)
    over = f"{pairs} image pair{'s' * (pairs != 1)}" + (f" and {seeds} seeds" if seeds > 1 else "")
    return f"Comparison of {methods} method{'s' * (methods != 1)} over {over}."


def _heads(titles: Sequence[str]) -> list[str]:
    """The line of titles; of a wide table two lines, units and last words in the second."""
    lines = [list(titles)]
    if len(titles) > WIDE:
        halves = [title.rpartition(" ") for title in titles]
        lines = [[first or last for first, _, last in halves], [last if first else "" for first, _, last in halves]]
    return [" & ".join(map(escape, line)) + r" \\" for line in lines]


def _row(
    table: Table,
    columns: Sequence[str],
    row: Mapping[str, Any],
    judged: Mapping[str, Any],
    rivals: Sequence[Mapping[str, Any]],
    *,
    summary: bool,
) -> str:
    cells = []
    for name in columns:
        text = escape(table.cell(row, name))
        if name == "method":
            text += escape(f" ({row['status']})") if summary else MARKS.get(row["status"], "")
        elif not text and name in table.metrics:
            text = "--"
        may_win = (summary or row["status"] == "ok") and text != "inf"
        text = r"$\infty$" if text == "inf" else text
        cells.append(rf"\textbf{{{text}}}" if may_win and best_of(judged, name, rivals) else text)
    return " & ".join(cells) + r" \\"


def _notes(table: Table, trusted: int) -> list[str]:
    """What stands below: marks, what bold means, why results are not trusted, the protocol."""
    notes = []
    untrusted = [row for row in table.rows if row["status"] != "ok"]
    bold = "Bold: best of the pair"
    if untrusted:
        bold += f" among the {trusted} of {len(table.rows)} results that are trusted"
    notes.append(f"{bold}; --: no value.")
    for status, words in (("unreliable", "not to be trusted"), ("failed", "failed")):
        rows = [row for row in untrusted if row["status"] == status]
        if rows:
            listed = "; ".join(f"{row['method']} on {row['pair']}: {row['reason']}" for row in rows)
            notes.append(f"{MARKS[status]} {words}: {escape(listed)}.")
    return [*notes, *(f"{escape(line)}." for line in table.protocol)]


def escape(text: str) -> str:
    """Return plain text as LaTeX."""
    return text.translate(SIGNS)
