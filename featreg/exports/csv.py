"""Comma-separated values: every column of the result's tie points, featreg's own pixels (first centre at 0, 0)."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.exports.columns import KNOWN, lines_of, matches_of, matches_of_array, numbers
from featreg.exports.content import Content
from featreg.types import Matches


def write(content: Content, path: Path) -> None:
    """Write a header and one row per tie point; numbers read back to the last bit, unknown ones are empty."""
    columns = [_texts(values) for values in content.columns.values()]
    lines = [",".join(content.columns), *(",".join(row) for row in zip(*columns, strict=True))]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def read(path: Path) -> Matches:
    """Read columns under their names, or four bare ones."""
    names, rows = table_of(path)
    if not names:
        return matches_of_array(numbers(rows))
    wanted = [i for i, name in enumerate(names) if name in KNOWN]
    values = numbers([[row[i] for i in wanted] for row in rows]).reshape(len(rows), len(wanted))
    return matches_of({names[i]: values[:, k] for k, i in enumerate(wanted)})


def table_of(path: Path) -> tuple[list[str], list[list[str]]]:
    """Return the columns' names, none where they are bare, and the rows of a table with commas, semicolons or blanks.

    What follows a # is a comment.
    """
    lines = [line.split("#")[0].strip() for line in lines_of(path)]
    cells = [
        [c.strip() for c in re.split(r"[,;]" if re.search("[,;]", line) else r"\s+", line)] for line in lines if line
    ]
    if not cells:
        raise InputError("is empty")
    named = any(re.search("[A-Za-z_]{3}", cell) and cell.lower() not in ("nan", "inf") for cell in cells[0])
    return (cells[0], cells[1:]) if named else ([], cells)


def _texts(values: NDArray[Any]) -> list[str]:
    if values.dtype.kind == "b":
        return [str(int(v)) for v in values.tolist()]
    return ["" if v != v else repr(v) for v in values.tolist()]
