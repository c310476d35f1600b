"""Parquet: every column of the result's tie points, featreg's own pixels (first centre at 0, 0)."""

from __future__ import annotations

from pathlib import Path

from featreg.exports.content import Content


def write(content: Content, path: Path) -> None:
    """Write one typed column each; unknown numbers are null."""
    import numpy as np
    import pyarrow as pa
    import pyarrow.parquet as pq

    arrays = {
        name: pa.array(values, mask=~np.isfinite(values) if values.dtype.kind == "f" else None)
        for name, values in content.columns.items()
    }
    pq.write_table(pa.table(arrays), path, compression="zstd")
