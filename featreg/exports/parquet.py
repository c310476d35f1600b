"""Parquet: every column of the result's tie points, featreg's own pixels (first centre at 0, 0)."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from featreg.errors import InputError
from featreg.exports.columns import KNOWN, matches_of
from featreg.exports.content import Content
from featreg.results.tie_point_table import parquet_of
from featreg.types import Matches


def write(content: Content, path: Path) -> None:
    """Write one typed column each; unknown numbers are null."""
    path.write_bytes(parquet_of(content.columns))


def read(path: Path) -> Matches:
    """Read the columns under their names."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.ParquetFile(io.BytesIO(path.read_bytes())).read()
    except pa.ArrowException as error:
        raise InputError(f"is not a whole Parquet file: {error}") from error
    names = [name for name in table.column_names if name in KNOWN]
    return matches_of({name: np.asarray(table[name].to_numpy(), np.float64) for name in names})
