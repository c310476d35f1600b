"""Elevation models: cell centres, holes, edges, and their way through names."""

from __future__ import annotations

import json
import logging
import math
import os
import pickle
import shutil
import struct
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from rasterio.transform import from_origin
from rasterio.warp import transform as through

from featreg.errors import InputError
from featreg.geolocation import ConstantHeight, DemHeights, heights_from_dict

UTM = "EPSG:32633"


class TestDemHeights:
    def test_heights_belong_to_cell_centres_and_are_bilinear_between(
        self, tmp_path: Path, write_dem: Callable[..., str]
    ) -> None:
        values = np.random.default_rng(0).uniform(0, 100, (30, 40))
        dem = DemHeights(write_dem(tmp_path / "dem.tif", values, from_origin(10.0, 50.0, 0.01, 0.02)))
        at = np.array([[10.0 + 0.01 * (x + 0.5), 50.0 - 0.02 * (y + 0.5)] for x, y in ((0, 0), (39, 29), (7, 11))])
        assert np.allclose(dem.at(at), [values[0, 0], values[29, 39], values[11, 7]], atol=1e-4)
        middle = np.array([[10.0 + 0.01 * 8.0, 50.0 - 0.02 * 12.0]])
        assert dem.at(middle)[0] == pytest.approx(values[11:13, 7:9].mean(), abs=1e-4)

    def test_any_coordinate_system(self, tmp_path: Path, write_dem: Callable[..., str]) -> None:
        y, x = np.mgrid[0:50, 0:60]
        path = write_dem(tmp_path / "dem.tif", 2.0 * x + 3.0 * y, from_origin(300_000, 5_200_000, 30, 30), UTM)
        east, north = 300_000 + 30 * np.array([10.5, 20.25]), 5_200_000 - 30 * np.array([5.5, 30.75])
        lonlat = np.column_stack(through(UTM, "EPSG:4326", east, north))
        assert np.allclose(DemHeights(path).at(lonlat), [20 + 15, 2 * 19.75 + 3 * 30.25], atol=1e-3)
        assert DemHeights(path, offset=40.0).at(lonlat)[0] == pytest.approx(75.0, abs=1e-3)

    def test_tiles_leave_no_seam_and_stay_few(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, write_dem: Callable[..., str]
    ) -> None:
        monkeypatch.setattr("featreg.geolocation.elevation_model.TILE", 16)
        monkeypatch.setattr("featreg.geolocation.elevation_model.KEPT", 3)
        y, x = np.mgrid[0:70, 0:90]
        dem = DemHeights(write_dem(tmp_path / "dem.tif", 5.0 * x - 7.0 * y, from_origin(10.0, 50.0, 0.01, 0.01)))
        cells = np.random.default_rng(1).uniform(0, [89, 69], (4000, 2))
        lonlat = [10.0, 50.0] + (cells + 0.5) * [0.01, -0.01]
        assert np.allclose(dem.at(lonlat), 5.0 * cells[:, 0] - 7.0 * cells[:, 1], atol=1e-6)
        assert len(dem._state.tiles) == 3

    def test_holes_are_filled_from_around_and_said_once(
        self, tmp_path: Path, caplog: pytest.LogCaptureFixture, write_dem: Callable[..., str]
    ) -> None:
        x = np.tile(np.arange(60.0), (60, 1))
        values = 100.0 + 2.0 * x
        values[20:30, 20:30] = -9999
        path = write_dem(tmp_path / "dem.tif", values, from_origin(10.0, 50.0, 0.01, 0.01), nodata=-9999)
        dem = DemHeights(path)
        with caplog.at_level(logging.WARNING):
            filled = dem.at(np.array([[10.0 + 0.01 * 25, 50.0 - 0.01 * 25]]))
            dem.at(np.array([[10.3, 49.7]]))
        assert filled[0] == pytest.approx(100 + 2 * 24.5, abs=10)
        assert [r.message for r in caplog.records if "holes" in r.message] == [
            f"elevation model {path}: has holes, filled from the cells around (100 in the first such tile)"
        ]

    def test_deep_holes_are_the_sea(self, tmp_path: Path, write_dem: Callable[..., str]) -> None:
        values = np.full((300, 300), np.nan)
        values[:, :20] = 50.0
        dem = DemHeights(write_dem(tmp_path / "dem.tif", values, from_origin(10.0, 50.0, 0.01, 0.01)), offset=7.0)
        lonlat = np.array([[10.0 + 0.01 * 5, 48.0], [10.0 + 0.01 * 290, 48.0]])
        assert np.allclose(dem.at(lonlat), [57.0, 7.0], atol=1e-4)

    def test_beyond_the_edge_it_goes_on_and_can_be_told(self, tmp_path: Path, write_dem: Callable[..., str]) -> None:
        x = np.tile(np.arange(20.0), (20, 1))
        dem = DemHeights(write_dem(tmp_path / "dem.tif", x, from_origin(10.0, 50.0, 0.01, 0.01)))
        lonlat = np.array([[9.0, 49.9], [12.0, 49.9], [10.1, 49.9], [370.1, 49.9], [np.nan, 49.9]])
        assert np.allclose(dem.at(lonlat)[:4], [0.0, 19.0, 9.5, 9.5], atol=1e-6)
        assert np.isnan(dem.at(lonlat)[4])
        assert dem.covers(lonlat).tolist() == [False, False, True, True, False]

    def test_it_travels_by_name_and_knows_its_file(self, tmp_path: Path, write_dem: Callable[..., str]) -> None:
        path = write_dem(tmp_path / "dem.tif", np.full((20, 20), 5.0), from_origin(10.0, 50.0, 0.01, 0.01))
        at = np.array([[10.1, 49.9]])
        dem = DemHeights(path)
        assert dem.at(at) == pytest.approx(5.0)
        assert len(pickle.dumps(dem)) < 1000
        assert pickle.loads(pickle.dumps(dem)).at(at) == pytest.approx(5.0)
        record = json.loads(json.dumps(dem.to_dict()))
        assert heights_from_dict(record).at(at) == pytest.approx(5.0)
        write_dem(tmp_path / "dem.tif", np.full((20, 20), 6.0), from_origin(10.0, 50.0, 0.01, 0.01))
        with pytest.raises(InputError, match="not the elevation model that was used before"):
            heights_from_dict(record).at(at)

    def test_threads_share_it(self, tmp_path: Path, write_dem: Callable[..., str]) -> None:
        y, x = np.mgrid[0:1300, 0:1300]
        dem = DemHeights(write_dem(tmp_path / "dem.tif", 0.1 * x + y, from_origin(10.0, 50.0, 0.001, 0.001)))
        cells = np.random.default_rng(1).uniform(0, 1299, (2000, 2))
        lonlat = [10.0, 50.0] + (cells + 0.5) * [0.001, -0.001]
        with ThreadPoolExecutor(8) as pool:
            found = list(pool.map(lambda _: dem.at(lonlat), range(16)))
        assert all(np.array_equal(one, found[0]) for one in found)
        assert np.allclose(found[0], 0.1 * cells[:, 0] + cells[:, 1], atol=1e-3)

    def test_unusable_files_are_named(self, tmp_path: Path, write_dem: Callable[..., str]) -> None:
        at = np.array([[10.1, 49.9]])
        with pytest.raises(InputError, match=r"none.tif: no such elevation model"):
            DemHeights(str(tmp_path / "none.tif")).at(at)
        (tmp_path / "text.tif").write_text("no image")
        with pytest.raises(InputError, match=r"text.tif: cannot be read as an elevation model"):
            DemHeights(str(tmp_path / "text.tif")).at(at)
        bare = write_dem(tmp_path / "bare.tif", np.zeros((20, 20)), from_origin(10.0, 50.0, 0.01, 0.01), crs=None)
        with pytest.raises(InputError, match=r"bare.tif: has no geotransform with a coordinate system"):
            DemHeights(bare).at(at)
        for wrong in (math.nan, math.inf):
            with pytest.raises(InputError, match="finite"):
                DemHeights(bare, offset=wrong)
            with pytest.raises(InputError, match="finite"):
                ConstantHeight(wrong)
        with pytest.raises(InputError, match="type of heights"):
            heights_from_dict({"type": "sea"})


class TestUndeclared:
    @pytest.mark.parametrize("fill", [-32768.0, -9999.0, 32767.0, 1e20, -3.4e38])
    def test_a_height_that_no_ground_has_is_a_hole(
        self, fill: float, tmp_path: Path, write_dem: Callable[..., str], caplog: pytest.LogCaptureFixture
    ) -> None:
        row, column = np.mgrid[0:60, 0:60]
        true = 500.0 + 2.0 * column + row
        samples = true.copy()
        samples[20:26, 30:36] = fill
        dem = DemHeights(write_dem(tmp_path / "dem.tif", samples, from_origin(12.0, 47.0, 0.001, 0.001)))
        at = np.column_stack([12.0 + 0.001 * (column.ravel() + 0.5), 47.0 - 0.001 * (row.ravel() + 0.5)])
        found = dem.at(at).reshape(60, 60)
        hole = samples == fill
        assert np.abs(found - true)[~hole].max() < 1e-3
        assert np.abs(found - true)[hole].max() < 12.0
        assert "36 hold no possible height, such as" in caplog.text


class TestGeoid:
    def test_heights_above_a_geoid_that_proj_lacks_are_said(
        self, tmp_path: Path, write_dem: Callable[..., str], caplog: pytest.LogCaptureFixture
    ) -> None:
        place = from_origin(12.0, 47.0, 0.001, 0.001)
        dem = DemHeights(write_dem(tmp_path / "dem.tif", np.full((30, 30), 100.0), place, crs="EPSG:4326+5773"))
        height = float(dem.at(np.array([[12.01, 46.99]]))[0])
        # 46 to 50 m there, in every issue of the geoid.
        assert 140 < height < 155 or (height == 100 and "counts its heights from a geoid" in caplog.text)

    def test_the_grid_of_proj_is_applied(self, tmp_path: Path) -> None:
        """In a process of its own, whose PROJ finds a geoid of 40 m + longitude + 2 latitude written here."""
        import rasterio

        data = Path(rasterio.__file__).parent / "proj_data"
        if not (data / "proj.db").is_file():
            pytest.skip("PROJ's data are not rasterio's own")
        folder = tmp_path / "proj"
        shutil.copytree(data, folder)
        latitude, longitude = np.mgrid[-90:90.1:1.0, -180:180:1.0]
        head = struct.pack(">4d2i", -90.0, -180.0, 1.0, 1.0, *latitude.shape)
        (folder / "egm96_15.gtx").write_bytes(head + (40 + longitude + 2 * latitude).astype(">f4").tobytes())
        code = (
            "import numpy as np, rasterio, sys\n"
            "from rasterio.transform import from_origin\n"
            "from featreg.geolocation import DemHeights\n"
            "profile = dict(driver='GTiff', width=700, height=600, count=1, dtype='float32', crs='EPSG:4326+5773')\n"
            "with rasterio.open('dem.tif', 'w', **profile, transform=from_origin(12.0, 47.0, 1e-3, 1e-3)) as dataset:\n"
            "    dataset.write(np.full((600, 700), 100, np.float32), 1)\n"
            "at = np.column_stack([np.linspace(12.05, 12.65, 50), np.linspace(46.95, 46.45, 50)])\n"
            "print(np.abs(DemHeights('dem.tif').at(at) - (140 + at[:, 0] + 2 * at[:, 1])).max())\n"
        )
        environment = {**os.environ, "PROJ_DATA": str(folder), "PROJ_LIB": str(folder)}
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120
        )
        assert float(done.stdout) < 0.05, done.stderr
