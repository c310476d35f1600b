"""GeoTIFFs written and read again: where they lie, every dtype, values without data."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError
from featreg.io import as_image, write_geotiff
from featreg.types import Geolocation

rasterio = pytest.importorskip("rasterio")
pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
GRAY = np.random.default_rng(0).integers(1, 250, (40, 60), dtype=np.uint8)


RPC = {
    **dict.fromkeys(("line_off", "samp_off", "lat_off", "long_off", "height_off"), 5.0),
    **dict.fromkeys(("line_scale", "samp_scale", "lat_scale", "long_scale", "height_scale"), 2.0),
    **{f"{axis}_{part}_coeff": [1.0, *np.linspace(0, 0.1, 19)] for axis in ("line", "samp") for part in ("num", "den")},
    "err_bias": 0.5,
    "err_rand": 0.25,
}


@pytest.mark.parametrize(
    "given",
    [
        Geolocation(transform=(10.0, 0.0, 500000.0, 0.0, -10.0, 4649776.0), crs="EPSG:32633"),
        Geolocation(gcps=np.array([[0.0, 0, 12, 45, 7], [59, 0, 13, 45, 8], [0, 39, 12, 44, 9]]), crs="EPSG:4326"),
        Geolocation(rpcs=RPC),
    ],
    ids=["transform", "gcps", "rpcs"],
)
def test_geolocation_survives_writing_and_reading(tmp_path: Path, given: Geolocation) -> None:
    write_geotiff(tmp_path / "a.tif", GRAY, given, nodata=0)
    read = as_image(tmp_path / "a.tif").geolocation
    assert read is not None
    assert read.transform == given.transform
    assert (read.crs is None) == (given.crs is None)
    if given.crs:
        assert rasterio.crs.CRS.from_wkt(read.crs) == rasterio.crs.CRS.from_string(given.crs)
    if given.gcps is not None:
        np.testing.assert_allclose(read.gcps, given.gcps)  # type: ignore[arg-type]
        with rasterio.open(tmp_path / "a.tif") as dataset:  # GDAL counts from the corner
            assert (dataset.gcps[0][0].col, dataset.gcps[0][0].row) == (0.5, 0.5)
    if given.rpcs is not None:
        assert read.rpcs is not None
        for key, value in given.rpcs.items():
            np.testing.assert_allclose(read.rpcs[key], value)


@pytest.mark.parametrize("dtype", ["bool", "uint8", "int16", "float16", "float32", "float64", "complex64"])
def test_write_geotiff_gives_back_every_dtype(tmp_path: Path, dtype: str) -> None:
    array = np.random.default_rng(4).normal(0, 50, (300, 260)).astype(dtype)
    write_geotiff(tmp_path / "a.tif", array)
    with rasterio.open(tmp_path / "a.tif") as dataset:
        np.testing.assert_array_equal(dataset.read(1), array)
    assert [p.name for p in tmp_path.iterdir()] == ["a.tif"]


def test_write_geotiff_keeps_the_old_file_when_it_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_geotiff(tmp_path / "a.tif", GRAY)
    before = (tmp_path / "a.tif").read_bytes()

    def full(source: Any, target: Any) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(InputError, match="no space left"):
        write_geotiff(tmp_path / "a.tif", GRAY[::-1])
    assert (tmp_path / "a.tif").read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.tif"]
    with pytest.raises(InputError, match="cannot be written"):
        write_geotiff(tmp_path / "no" / "a.tif", GRAY)
    with pytest.raises(InputError, match="non-empty"):
        write_geotiff(tmp_path / "b.tif", GRAY[None])


def test_nan_nodata_of_a_product_is_masked_when_read(tmp_path: Path) -> None:
    product = GRAY.astype(np.float32)
    product[:3] = np.nan
    write_geotiff(tmp_path / "a.tif", product, nodata=np.nan)
    np.testing.assert_array_equal(as_image(tmp_path / "a.tif").mask, np.isfinite(product))
