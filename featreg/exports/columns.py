"""Columns of tie points, as the tables and text files of every format hold them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.types import FloatArray, Matches

COLUMNS = ("reference_x", "reference_y", "secondary_x", "secondary_y")
COVARIANCE = ("cov_xx", "cov_xy", "cov_yy")
#: All columns that are read; a file may hold others.
KNOWN = (*COLUMNS, "score", *COVARIANCE)


def matches_of(columns: Mapping[str, NDArray[Any]]) -> Matches:
    """Return the tie points of named columns (M,); score and covariance where they are.

    Raises
    ------
    InputError
        One of `COLUMNS` is missing.
    """
    missing = [name for name in COLUMNS if name not in columns]
    if missing:
        raise InputError(f"the columns {', '.join(COLUMNS)} are needed, {', '.join(missing)} not found")
    x, y, u, v = (columns[name] for name in COLUMNS)
    score = columns.get("score", np.full(len(x), np.nan))
    covariance = None
    if all(name in columns for name in COVARIANCE):
        xx, xy, yy = (columns[name] for name in COVARIANCE)
        covariance = np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], -2)
    return Matches(np.column_stack([x, y]), np.column_stack([u, v]), score, covariance)


def matches_of_array(values: Any) -> Matches:
    """Return the tie points of an array (M, 4) of reference x, y, secondary x, y; their score is NaN.

    Raises
    ------
    InputError
        Another shape.
    """
    array = np.asarray(values, np.float64)
    if array.ndim != 2 or array.shape[1] != 4:
        raise InputError(f"(M, 4) columns {', '.join(COLUMNS)} are needed, got shape {array.shape}")
    return Matches(array[:, :2], array[:, 2:], np.full(len(array), np.nan))


def lines_of(path: Path) -> list[str]:
    """Return the lines of a text file that hold something, stripped."""
    return [line.strip() for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip()]


def numbers(rows: Sequence[Sequence[str]]) -> FloatArray:
    """Return the cells of text as float64, an empty one as NaN; all rows are equally long."""
    for number, row in enumerate(rows, 1):
        if len(row) != len(rows[0]):
            raise InputError(f"row {number} has {len(row)} columns, the first has {len(rows[0])}")
    return np.array([[float(cell) if cell.strip() else np.nan for cell in row] for row in rows], np.float64)
