"""Comma-separated values: every column of the result's tie points, featreg's own pixels (first centre at 0, 0)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from featreg.exports.content import Content


def write(content: Content, path: Path) -> None:
    """Write a header and one row per tie point; numbers read back to the last bit, unknown ones are empty."""
    columns = [_texts(values) for values in content.columns.values()]
    lines = [",".join(content.columns), *(",".join(row) for row in zip(*columns, strict=True))]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _texts(values: NDArray[Any]) -> list[str]:
    if values.dtype.kind == "b":
        return [str(int(v)) for v in values.tolist()]
    return ["" if v != v else repr(v) for v in values.tolist()]
