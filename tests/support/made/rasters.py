"""Raster files of any driver, by a public writer."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


def write_raster(
    path: Path, array: NDArray[Any], driver: str = "GTiff", names: Sequence[str] = (), **profile: Any
) -> Path:
    """Write (H, W) or (B, H, W) with rasterio, under the names of its bands; `profile` as rasterio takes it."""
    import rasterio

    bands = array if array.ndim == 3 else array[np.newaxis]
    count, height, width = bands.shape
    profile = {"dtype": bands.dtype.name, "count": count, "height": height, "width": width, **profile}
    with rasterio.open(path, "w", driver=driver, **profile) as dataset:
        dataset.write(bands)
        for number, name in enumerate(names, start=1):
            dataset.set_band_description(number, name)
    return path
