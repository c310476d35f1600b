"""Parquet: every column of the result's tie points, featreg's own pixels (first centre at 0, 0)."""

from __future__ import annotations

from pathlib import Path

from featreg.exports.content import Content
from featreg.results.json_file import parquet_of


def write(content: Content, path: Path) -> None:
    """Write one typed column each; unknown numbers are null."""
    path.write_bytes(parquet_of(content.columns))
