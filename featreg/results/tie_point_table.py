"""The table of tie points of a result: its columns, as rows of JSON or as Parquet, and back."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.runtime.digests import digest_bytes
from featreg.types import BoolArray, IntArray

if TYPE_CHECKING:
    from featreg.results.registration import Registration


def stage_of(registration: Registration) -> IntArray:
    """Return (M,) how many filters, from the first on, each tie point survived."""
    alive = np.ones(len(registration.matches), dtype=np.bool_)
    stage = np.zeros(len(alive), dtype=np.int64)
    for mask in registration.stages.values():
        alive &= mask
        stage += alive
    return stage


def packed_masks(registration: Registration, stage: IntArray) -> dict[str, str]:
    """Return the stages that do not follow from `stage`, packed."""
    return {
        name: base64.b64encode(np.packbits(mask).tobytes()).decode()
        for k, (name, mask) in enumerate(registration.stages.items())
        if not np.array_equal(mask, stage > k)
    }


def tie_point_columns(registration: Registration) -> dict[str, NDArray[Any]]:
    """Return the columns (M,) of the tie-point table by name, in its order."""
    return columns_of(registration, stage_of(registration))


def columns_of(registration: Registration, stage: IntArray) -> dict[str, NDArray[Any]]:
    """Return the columns (M,) by name where `stage` is what `stage_of` gives."""
    matches = registration.matches
    blocks = registration.provenance.get("tie_point_blocks")
    columns: dict[str, NDArray[Any]] = {
        "reference_x": matches.reference_xy[:, 0],
        "reference_y": matches.reference_xy[:, 1],
        "secondary_x": matches.secondary_xy[:, 0],
        "secondary_y": matches.secondary_xy[:, 1],
        "score": matches.score,
        "residual": registration.residuals(),
        "inlier": registration.inliers,
        "stage": stage,
        "origin": matches.origin,
        "block": np.full(len(matches), -1) if blocks is None else np.asarray(blocks, dtype=np.int64),
    }
    if matches.covariance is not None:
        for name, (i, j) in {"cov_xx": (0, 0), "cov_xy": (0, 1), "cov_yy": (1, 1)}.items():
            columns[name] = matches.covariance[:, i, j]
    if matches.rotation is not None:
        columns["rotation"] = matches.rotation
    if matches.scale_ratio is not None:
        columns["scale_ratio"] = matches.scale_ratio
    return columns


def rows_of(columns: Mapping[str, NDArray[Any]]) -> list[list[Any]]:
    """Return the rows of a table as lists; None stands for numbers that are not finite."""
    return [list(row) for row in tuples_of(columns)]


def tuples_of(columns: Mapping[str, NDArray[Any]]) -> list[tuple[Any, ...]]:
    """Return the rows of a table; None stands for numbers that are not finite."""

    def values(array: NDArray[Any]) -> list[Any]:
        finite = np.isfinite(array)
        if finite.all():
            return list(array.tolist())
        some = array.astype(object)
        some[~finite] = None
        return list(some.tolist())

    return list(zip(*(values(c) for c in columns.values()), strict=True))


def table_of(columns: Mapping[str, Any], masks: Mapping[str, str], rows: Any) -> dict[str, Any]:
    """Return a table as it stands in the JSON; `rows` are taken as they are."""
    return {"columns": list(columns), **({"masks": dict(masks)} if masks else {}), "rows": rows}


def parquet_of(columns: Mapping[str, NDArray[Any]]) -> bytes:
    """Return a Parquet file of columns (M,); numbers that are not finite are null."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    sink = pa.BufferOutputStream()
    table = pa.Table.from_arrays([_arrow_column(values) for values in columns.values()], names=list(columns))
    pq.write_table(table, sink, compression="zstd")
    content: bytes = sink.getvalue().to_pybytes()
    return content


def _arrow_column(values: NDArray[Any]) -> Any:
    """A column of numbers or truth values as Arrow holds it, over the same memory where it can.

    Arrow's own conversion imports pandas where it is installed, half a second for nothing.
    """
    import pyarrow as pa

    def bits(good: NDArray[Any]) -> Any:
        return pa.py_buffer(np.packbits(good, bitorder="little"))

    finite = np.isfinite(values) if values.dtype.kind == "f" else None
    known = None if finite is None or finite.all() else bits(finite)
    # Arrow takes the type of the other byte order, and its bytes for those of this one.
    kind = values.dtype.newbyteorder("=")
    held = bits(values) if kind.kind == "b" else pa.py_buffer(np.ascontiguousarray(values, kind))
    return pa.Array.from_buffers(pa.from_numpy_dtype(kind), len(values), [known, held])


def no_columns(table: Mapping[str, Any]) -> dict[str, NDArray[np.float64]]:
    """Return the columns of a table that stands in a file of its own, without its rows."""
    return {name: np.zeros(0) for name in table["columns"]}


def read_columns(table: Mapping[str, Any], folder: Path) -> dict[str, NDArray[np.float64]]:
    """Return the columns (M,) of the table of a result in `folder`; NaN stands for null.

    Raises
    ------
    InputError
        The file of the tie points lies elsewhere, or is not the one that was written with the result.
    """
    names = table["columns"]
    if "file" not in table:
        rows = np.array(table["rows"], dtype=np.float64).reshape(len(table["rows"]), len(names))
        return {name: rows[:, i] for i, name in enumerate(names)}
    if Path(table["file"]).name != table["file"]:
        raise InputError(f"its tie-point file must be a name in the same folder, got '{table['file']}'")
    import pyarrow.parquet as pq

    content = (folder / table["file"]).read_bytes()
    if digest_bytes(content) != table["sha256"]:
        raise InputError(f"'{table['file']}' is not the tie-point file that was written with it")
    read = pq.ParquetFile(io.BytesIO(content)).read(columns=names)
    return {name: np.asarray(read[name].to_numpy(), dtype=np.float64) for name in names}


def read_stages(names: list[str], stage: IntArray, masks: Mapping[str, str]) -> dict[str, BoolArray]:
    """Return the masks (M,) of the stages of these names, in the order in which they ran."""
    stages = {}
    for k, name in enumerate(names):
        if name in masks:
            packed = np.frombuffer(base64.b64decode(masks[name], validate=True), dtype=np.uint8)
            stages[name] = np.unpackbits(packed, count=len(stage)).astype(np.bool_)
        else:
            stages[name] = stage > k
    return stages


def whole_numbers(values: NDArray[np.float64]) -> IntArray:
    """Return a column of whole numbers, or raise `InputError` where it holds null."""
    if not np.isfinite(values).all():
        raise InputError("a column of whole numbers holds null")
    return values.astype(np.int64)
