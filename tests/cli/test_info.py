"""`featreg info` says of a file what was written into it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from featreg.cli.info import describe
from featreg.cli.main import main
from featreg.io import write_geotiff
from featreg.types import Geolocation

SHAPE = (300, 400)
UTM = Geolocation(transform=(10.0, 0.0, 500000.0, 0.0, -10.0, 4200000.0), crs="EPSG:32611")


def speckle(looks: float) -> np.ndarray:
    return np.random.default_rng(1).gamma(looks, 100 / looks, SHAPE)


@pytest.mark.parametrize("looks", [1.0, 4.0, 10.0])
def test_looks_of_speckle_are_told(looks: float, tmp_path: Path) -> None:
    write_geotiff(tmp_path / "a.tif", np.sqrt(speckle(looks)).astype(np.float32))
    found = describe(str(tmp_path / "a.tif"))["looks"]
    # The calmest windows of 81 samples lie above the mean of all.
    assert looks < found < 2.2 * looks


def test_geography_mask_and_scale(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    db = (10 * np.log10(speckle(4.0) / 1000)).astype(np.float32)
    db[:30] = np.nan
    write_geotiff(tmp_path / "a.tif", db, UTM, nodata=np.nan)
    assert main(["info", str(tmp_path / "a.tif"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["format"] == "GTiff"
    assert found["size"] == {"width": 400, "height": 300}
    assert found["samples"] == {"dtype": "float32", "scale": "db", "told_by": "its samples"}
    assert found["without_data"] == pytest.approx(0.1)
    place = found["place"]
    assert (place["kind"], place["pixel_x"], place["unit"], place["crs"]) == ("geotransform", 10, "metre", "EPSG:32611")
    assert place["centre_lat"] == pytest.approx(37.934, abs=0.01)
    assert place["centre_lon"] == pytest.approx(-116.977, abs=0.01)
    assert found["will"].startswith("take amplitudes from its decibels and match it whole")
    assert main(["info", str(tmp_path / "a.tif"), "--scale", "db"]) == 0
    text = capsys.readouterr().out
    for line in (
        "format       GTiff",
        "size         width 400, height 300",
        "looks ",
        "place        kind geotransform",
    ):
        assert line in text


def test_a_file_of_several_bands_is_described_without_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rasterio = pytest.importorskip("rasterio")
    profile = {"driver": "GTiff", "height": 60, "width": 80, "count": 2, "dtype": "float32", "crs": "EPSG:32611"}
    with rasterio.open(
        tmp_path / "a.tif", "w", transform=rasterio.transform.from_origin(500000, 4200000, 10, 10), **profile
    ) as dataset:
        dataset.write(np.random.default_rng(0).random((2, 60, 80), np.float32))
        dataset.set_band_description(1, "Sigma0_VV")
        dataset.set_band_description(2, "Sigma0_VH_db")
    found = describe(str(tmp_path / "a.tif"))
    assert [band["name"] for band in found["bands"]] == ["Sigma0_VV", "Sigma0_VH_db"]
    assert [band["states"] for band in found["bands"]] == ["intensity", "db"]
    assert found["read"] is None
    assert "state which one as band" in found["will"]
    assert describe(str(tmp_path / "a.tif"), band="vh")["read"] == "Sigma0_VH_db"
    assert main(["info", str(tmp_path / "a.tif"), "--band", "HH"]) == 2
    assert "has no band 'HH'" in capsys.readouterr().err


def test_matching_pictures_imports_no_library_of_another_format(tmp_path: Path) -> None:
    import cv2

    rng = np.random.default_rng(0)
    for name in ("a.png", "b.png"):
        cv2.imwrite(str(tmp_path / name), rng.integers(0, 255, (120, 120)).astype(np.uint8))
    code = (
        "import sys\nfrom featreg.cli.main import main\n"
        f"code = main(['match', r'{tmp_path / 'a.png'}', r'{tmp_path / 'b.png'}'])\n"
        "heavy = {'h5py', 'h5netcdf', 'xarray', 'rioxarray', 'geopandas', 'sarkit', 'lxml'}\n"
        "print(code, sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip().splitlines()[-1] == "3 []", done.stderr
