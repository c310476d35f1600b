"""Sensors and elevation models that the tests of this folder share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

from featreg.geolocation import RpcSensor
from featreg.simulate.orbit import RangeDoppler
from featreg.types import FloatArray

SHAPE = (2000, 2200)
PLACE = (12.0, 47.0)


def _orbit(shape: tuple[int, int] = SHAPE, place: tuple[float, float] = PLACE, **changes: Any) -> RangeDoppler:
    given = {"incidence_deg": 35.0, "heading_deg": -12.0, "pixel": 3.0, "height": 400.0} | changes
    return RangeDoppler.over(place, shape, **given)


@pytest.fixture(scope="session")
def orbit() -> Callable[..., RangeDoppler]:
    return _orbit


@pytest.fixture(scope="session")
def exact() -> RangeDoppler:
    return _orbit()


@pytest.fixture(scope="session")
def rpc(exact: RangeDoppler) -> RpcSensor:
    return exact.rpc(SHAPE, -200.0, 1000.0, 15.0)


def _write_dem(
    path: Path, values: FloatArray, transform: Any, crs: str | None = "EPSG:4326", nodata: float | None = None
) -> str:
    height, width = values.shape
    profile = {"driver": "GTiff", "count": 1, "dtype": "float32", "nodata": nodata}
    with rasterio.open(path, "w", width=width, height=height, crs=crs, transform=transform, **profile) as dataset:
        dataset.write(values.astype(np.float32), 1)
    return str(path)


@pytest.fixture(scope="session")
def write_dem() -> Callable[..., str]:
    return _write_dem
