"""Ground control points of GDAL: heights, options, and the file that they belong to."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

from featreg.errors import InputError
from featreg.exports.formats import export
from featreg.io import write_geotiff
from featreg.types import Geolocation
from made.exported import MODEL, registration_in

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


def one() -> list[float]:
    return [1.0] + [0.0] * 19


RPCS: dict[str, Any] = {
    "line_off": 45.0, "samp_off": 60.0, "line_scale": 45.0, "samp_scale": 60.0, "lat_off": 41.0, "lat_scale": 0.05,
    "long_off": 15.0, "long_scale": 0.05, "height_off": 120.0, "height_scale": 100.0,
    "line_num_coeff": [0, 0, -1.0] + [0.0] * 17, "line_den_coeff": one(),
    "samp_num_coeff": [0, 1.0] + [0.0] * 18, "samp_den_coeff": one(), "err_bias": 1.0, "err_rand": 1.0,
}  # fmt: skip


@pytest.mark.parametrize("name", ["t.vrt", "t.tif"])
def test_gdal_gcps_give_the_reference_ground_at_the_secondary_pixels(tmp_path: Path, name: str) -> None:
    export(registration_in(tmp_path), tmp_path / name, to="gdal")
    with rasterio.open(tmp_path / name) as dataset:
        gcps, crs = dataset.gcps
        assert crs == rasterio.crs.CRS.from_epsg(32632)
        assert (gcps[0].col, gcps[0].row, gcps[0].x, gcps[0].y) == (0.5, 0.5, 500005.0, 5999995.0)
        assert len(gcps) == 10
        # GDAL's own transformer takes a pixel centre of the secondary to the ground of the reference's pixel.
        with rasterio.transform.GCPTransformer(gcps[1:]) as transformer:
            at = np.array([[30.0, 20.0]])
            u, v = MODEL(at)[0]
            x, y = transformer.xy(v, u, offset="center")
            assert np.allclose([x, y], [500000 + 10 * 30.5, 6000000 - 10 * 20.5], atol=1e-3)
        with rasterio.open(tmp_path / "sec.tif") as source:
            np.testing.assert_array_equal(dataset.read(1), source.read(1))
            assert dataset.nodata == 0


def test_gdal_gcps_of_a_reference_with_rpcs_lie_at_the_height_offset(tmp_path: Path) -> None:
    export(registration_in(tmp_path, Geolocation(rpcs=RPCS)), tmp_path / "t.vrt", to="gdal")
    with rasterio.open(tmp_path / "t.vrt") as dataset:
        gcps, crs = dataset.gcps
    assert crs == rasterio.crs.CRS.from_epsg(4326)
    assert gcps[0].z == 120
    assert np.allclose([gcps[0].x, gcps[0].y], [15 - 0.05, 41 + 0.05])  # column 0 is samp_off - samp_scale


def test_gdal_options_and_image_to_image(tmp_path: Path) -> None:
    export(registration_in(tmp_path, None), tmp_path / "t.txt", to="gdal")
    first = (tmp_path / "t.txt").read_text().splitlines()[0]
    assert first == "-gcp 0.5 0.5 0.5 -0.5 0.0"


def test_gdal_needs_the_secondarys_file(tmp_path: Path) -> None:
    reg = registration_in(tmp_path)
    (tmp_path / "sec.tif").rename(tmp_path / "moved.tif")
    with pytest.raises(InputError, match=r"need the secondary's file.*sec\.tif"):
        export(reg, tmp_path / "t.vrt", to="gdal")
    assert not (tmp_path / "t.vrt").exists()
    assert export(reg, tmp_path / "t.vrt", to="gdal", secondary=tmp_path / "moved.tif") == 10
    write_geotiff(tmp_path / "small.tif", np.ones((20, 20)))
    with pytest.raises(InputError, match="20 x 20 pixels, but the secondary of the result was 120 x 90"):
        export(reg, tmp_path / "t.vrt", to="gdal", secondary=tmp_path / "small.tif")
