"""Sensors, heights, transfer and overlap against GDAL, rpcm and a closed-form range-Doppler geometry."""

from __future__ import annotations

import json
import logging
import math
import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio.rpc import RPC
from rasterio.transform import Affine as Geotransform
from rasterio.transform import RPCTransformer, from_origin
from rasterio.warp import transform as through

from featreg.errors import InputError, NoOverlapError
from featreg.geolocation import (
    ConstantHeight,
    DemHeights,
    GcpSensor,
    GeotransformSensor,
    Heights,
    RpcSensor,
    Sensor,
    Transfer,
    find_overlap,
    heights_from_dict,
    sensor_from_dict,
    sensor_of,
)
from featreg.geolocation.overlap import largest_rectangle
from featreg.geolocation.rpc_fit import terms
from featreg.geolocation.sensor import METRES_PER_DEGREE
from featreg.geolocation.transfer import on_ground
from featreg.simulate.orbit import RangeDoppler, Terrain
from featreg.types import FloatArray, Geolocation

SHAPE = (2000, 2200)
PLACE = (12.0, 47.0)
UTM = "EPSG:32633"


def orbit(shape: tuple[int, int] = SHAPE, place: tuple[float, float] = PLACE, **changes: Any) -> RangeDoppler:
    given = {"incidence_deg": 35.0, "heading_deg": -12.0, "pixel": 3.0, "height": 400.0} | changes
    return RangeDoppler.over(place, shape, **given)


@pytest.fixture(scope="module")
def exact() -> RangeDoppler:
    return orbit()


@pytest.fixture(scope="module")
def rpc(exact: RangeDoppler) -> RpcSensor:
    return exact.rpc(SHAPE, -200.0, 1000.0, 15.0)


@pytest.fixture(scope="module")
def cloud() -> tuple[FloatArray, FloatArray]:
    """Image points and heights."""
    rng = np.random.default_rng(5)
    return rng.uniform(0, [SHAPE[1], SHAPE[0]], (3000, 2)), rng.uniform(-100, 900, 3000)


def write_dem(
    path: Path, values: FloatArray, transform: Any, crs: str | None = "EPSG:4326", nodata: float | None = None
) -> str:
    height, width = values.shape
    profile = {"driver": "GTiff", "count": 1, "dtype": "float32", "nodata": nodata}
    with rasterio.open(path, "w", width=width, height=height, crs=crs, transform=transform, **profile) as dataset:
        dataset.write(values.astype(np.float32), 1)
    return str(path)


class TestRpcSensor:
    def test_the_sample_of_an_rpc_counts_from_the_centre_of_the_first_pixel(self, rpc: RpcSensor) -> None:
        # GDAL's own coordinates count from the corner: half a pixel more.
        at = np.array([[rpc.rpcs["long_off"], rpc.rpcs["lat_off"]]])
        ours = rpc.ground_to_image(at, rpc.rpcs["height_off"])[0]
        with RPCTransformer(RPC(**rpc.rpcs)) as gdal:
            rows, columns = gdal.rowcol(*at.T, zs=[rpc.rpcs["height_off"]], op=float)
        assert np.allclose(ours + 0.5, [columns[0], rows[0]], atol=1e-7)
        constant = [
            rpc.rpcs[f"{n}_num_coeff"][0] * rpc.rpcs[f"{n}_scale"] + rpc.rpcs[f"{n}_off"] for n in ("samp", "line")
        ]
        assert np.allclose(ours, constant, atol=1e-9)

    def test_projection_agrees_with_gdal(self, rpc: RpcSensor, cloud: tuple[FloatArray, FloatArray]) -> None:
        ground = rpc.image_to_ground(*cloud)
        with RPCTransformer(RPC(**rpc.rpcs)) as gdal:
            rows, columns = gdal.rowcol(*ground.T, zs=cloud[1], op=lambda v: v)
        ours = rpc.ground_to_image(ground, cloud[1])
        assert np.abs(ours + 0.5 - np.column_stack([columns, rows])).max() < 1e-7

    def test_projection_and_location_agree_with_rpcm(
        self, rpc: RpcSensor, cloud: tuple[FloatArray, FloatArray]
    ) -> None:
        rpcm = pytest.importorskip("rpcm")
        names = {"long_off": "LONG_OFF", "samp_off": "SAMP_OFF"}
        text = {names.get(k, k.upper()): v for k, v in rpc.rpcs.items() if not isinstance(v, list)}
        text |= {k.upper(): " ".join(map(repr, v)) for k, v in rpc.rpcs.items() if isinstance(v, list)}
        oracle = rpcm.RPCModel(text)
        ground = rpc.image_to_ground(*cloud)
        assert np.abs(np.column_stack(oracle.projection(*ground.T, cloud[1])) - cloud[0]).max() < 1e-6
        located = np.column_stack(oracle.localization(*cloud[0].T, cloud[1]))
        assert np.abs(located - ground).max() * METRES_PER_DEGREE < 0.01

    def test_projection_is_the_quotient_of_the_twenty_terms(
        self, rpc: RpcSensor, cloud: tuple[FloatArray, FloatArray]
    ) -> None:
        rng = np.random.default_rng(3)
        wild = dict(rpc.rpcs)
        for name in ("samp", "line"):
            wild[f"{name}_num_coeff"] = rng.normal(size=20)
            wild[f"{name}_den_coeff"] = np.r_[1.0, rng.normal(scale=0.01, size=19)]
        unit = rng.uniform(-1, 1, (500, 3))
        scale = np.array([wild[f"{n}_scale"] for n in ("long", "lat", "height")])
        ground = unit * scale + [wild[f"{n}_off"] for n in ("long", "lat", "height")]
        found = RpcSensor(wild).ground_to_image(ground[:, :2], ground[:, 2])
        for axis, name in enumerate(("samp", "line")):
            value = (terms(unit) @ wild[f"{name}_num_coeff"]) / (terms(unit) @ wild[f"{name}_den_coeff"])
            assert np.allclose(found[:, axis], value * wild[f"{name}_scale"] + wild[f"{name}_off"], rtol=0, atol=1e-7)

    def test_there_and_back_is_exact(self, rpc: RpcSensor, cloud: tuple[FloatArray, FloatArray]) -> None:
        back = rpc.ground_to_image(rpc.image_to_ground(*cloud), cloud[1])
        assert np.abs(back - cloud[0]).max() < 1e-6

    def test_a_point_does_not_depend_on_the_others(self, rpc: RpcSensor, cloud: tuple[FloatArray, FloatArray]) -> None:
        whole = rpc.image_to_ground(*cloud)
        parts = [rpc.image_to_ground(cloud[0][i : i + 7], cloud[1][i : i + 7]) for i in range(0, 700, 7)]
        assert np.array_equal(np.concatenate(parts), whole[:700])
        with ThreadPoolExecutor(4) as pool:
            again = list(pool.map(lambda _: rpc.image_to_ground(*cloud), range(4)))
        assert all(np.array_equal(other, whole) for other in again)

    def test_it_is_the_range_doppler_geometry(
        self, rpc: RpcSensor, exact: RangeDoppler, cloud: tuple[FloatArray, FloatArray]
    ) -> None:
        ground = exact.image_to_ground(*cloud)
        assert np.abs(rpc.ground_to_image(ground, cloud[1]) - cloud[0]).max() < 1e-3

    def test_no_points_and_no_numbers(self, rpc: RpcSensor) -> None:
        assert rpc.image_to_ground(np.zeros((0, 2)), 0.0).shape == (0, 2)
        assert rpc.ground_to_image(np.zeros((0, 2)), 0.0).shape == (0, 2)
        holes = np.array([[100.0, np.nan], [100.0, 100.0]])
        assert np.isnan(rpc.image_to_ground(holes, 0.0)).any(axis=1).tolist() == [True, False]
        assert np.isnan(rpc.image_to_ground(holes[1:], np.nan)).all()

    def test_a_scene_may_lie_across_the_antimeridian(self) -> None:
        there = orbit(place=(179.999, -17.0)).rpc(SHAPE, -200.0, 1000.0, 15.0)
        xy = np.array([[10.0, 10.0], [2190.0, 1990.0]])
        ground = there.image_to_ground(xy, 100.0)
        assert (np.abs(ground[:, 0]) <= 180).all()
        assert ground[:, 0].min() < 0 < ground[:, 0].max()
        assert np.abs(there.ground_to_image(ground, 100.0) - xy).max() < 1e-6

    def test_uncertainty_is_three_standard_errors_in_pixels(self, rpc: RpcSensor) -> None:
        assert rpc.uncertainty_px == pytest.approx(3 * math.hypot(15, 1) / 3, rel=0.02)
        unknown = {**rpc.rpcs, "err_bias": None, "err_rand": -1.0}
        assert RpcSensor(unknown).uncertainty_px == 20.0

    @pytest.mark.parametrize(
        ("change", "says"),
        [
            ({"samp_scale": 0.0}, "'samp_scale' must be > 0"),
            ({"lat_off": "north"}, "'lat_off' must be a number"),
            ({"lat_off": math.inf}, "'lat_off' must be finite"),
            ({"line_num_coeff": [1.0] * 19}, "'line_num_coeff' must be 20"),
            ({"line_den_coeff": "?"}, "'line_den_coeff' must be 20"),
        ],
    )
    def test_a_broken_rpc_is_refused(self, rpc: RpcSensor, change: dict[str, Any], says: str) -> None:
        with pytest.raises(InputError, match=says):
            RpcSensor({**rpc.rpcs, **change})

    @pytest.mark.parametrize("name", ["samp_off", "line_num_coeff"])
    def test_an_incomplete_rpc_is_refused(self, rpc: RpcSensor, name: str) -> None:
        with pytest.raises(InputError, match=f"lacks '{name}'"):
            RpcSensor({k: v for k, v in rpc.rpcs.items() if k != name})


class TestGeotransformSensor:
    def test_pixel_centres_are_half_a_pixel_from_the_corner(self) -> None:
        sensor = GeotransformSensor((10.0, 0.0, 300_000.0, 0.0, -10.0, 5_200_000.0), UTM, (100, 200))
        lon, lat = through(UTM, "EPSG:4326", [300_005.0], [5_199_995.0])
        assert np.allclose(sensor.image_to_ground(np.zeros((1, 2)), 0.0), [[lon[0], lat[0]]], atol=1e-9)

    @pytest.mark.parametrize("crs", ["EPSG:4326", UTM, "EPSG:3035", "EPSG:3857"])
    def test_it_agrees_with_gdal_and_with_itself(self, crs: str) -> None:
        (x,), (y,) = through("EPSG:4326", crs, [12.0], [47.0])
        step = 1e-4 if crs == "EPSG:4326" else 10.0
        grid = Geotransform(step, 0.1 * step, x, 0.05 * step, -step, y)
        sensor = GeotransformSensor(tuple(grid)[:6], crs, (900, 1000))
        xy = np.random.default_rng(0).uniform(-50, 1000, (2000, 2))
        ground = sensor.image_to_ground(xy, 500.0)
        ours = np.column_stack(through(crs, "EPSG:4326", *(np.array(grid @ tuple((xy + 0.5).T)))))
        assert np.abs(ground - ours).max() * METRES_PER_DEGREE / 10 < 1e-6
        assert np.abs(sensor.ground_to_image(ground, 0.0) - xy).max() < 1e-6

    def test_nonsense_is_refused(self) -> None:
        with pytest.raises(InputError, match="invertible"):
            GeotransformSensor((1.0, 1.0, 0.0, 1.0, 1.0, 0.0), UTM, (10, 10))
        with pytest.raises(InputError, match="unknown coordinate system"):
            GeotransformSensor((1.0, 0.0, 0.0, 0.0, 1.0, 0.0), "EPSG:1", (10, 10))


@pytest.fixture(scope="module")
def wide() -> RangeDoppler:
    return orbit(TestGcpSensor.shape, pixel=7.0, incidence_deg=38.0)


class TestGcpSensor:
    """A grid like that of Sentinel-1: 21 x 10 points over 25 000 x 16 500 pixels of 7 m, on hilly terrain."""

    shape = (16_500, 25_000)

    def grid(self, wide: RangeDoppler, heights: Heights, crs: str = "EPSG:4326") -> GcpSensor:
        x, y = np.meshgrid(np.linspace(0, self.shape[1] - 1, 21), np.linspace(0, self.shape[0] - 1, 10))
        xy = np.column_stack([x.ravel(), y.ravel()])
        ground, level = on_ground(wide, xy, heights)
        if crs != "EPSG:4326":
            ground = np.column_stack(through("EPSG:4326", crs, *ground.T))
        return GcpSensor(np.column_stack([xy, ground, level]), crs)

    @pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:3035"])
    def test_hilly_points_tell_how_a_height_moves_a_pixel(self, wide: RangeDoppler, crs: str) -> None:
        hills = Terrain.made(PLACE, 600.0, 1200.0, 60_000.0, np.random.default_rng(1))
        sensor = self.grid(wide, hills, crs)
        rng = np.random.default_rng(2)
        xy, level = rng.uniform(0, [25_000, 16_500], (2000, 2)), rng.uniform(0, 1200, 2000)
        ground = wide.image_to_ground(xy, level)
        assert sensor.sees_height
        error = np.abs(sensor.ground_to_image(ground, level) - xy)
        assert np.sqrt((error**2).mean()) < 0.1
        # At the lowest and highest ground; a height is taken to move a pixel in proportion.
        assert error.max() < 0.8
        assert np.abs(sensor.ground_to_image(sensor.image_to_ground(xy, level), level) - xy).max() < 1e-6

    def test_flat_points_serve_their_own_height(self, wide: RangeDoppler) -> None:
        sensor = self.grid(wide, ConstantHeight(300.0))
        xy = np.random.default_rng(2).uniform(0, [25_000, 16_500], (2000, 2))
        ground = wide.image_to_ground(xy, 300.0)
        assert not sensor.sees_height
        assert np.abs(sensor.ground_to_image(ground, 300.0) - xy).max() < 0.05
        assert sensor.uncertainty_px >= 5.0

    def test_four_corners_make_an_affine_map(self) -> None:
        corners = np.array([[0.0, 0, 10, 50, 0], [99, 0, 10.1, 50, 0], [0, 99, 10, 49.9, 0], [99, 99, 10.1, 49.9, 0]])
        sensor = GcpSensor(corners)
        assert np.allclose(sensor.image_to_ground(corners[:, :2], 0.0), corners[:, 2:4], atol=1e-12)
        assert np.allclose(sensor.image_to_ground(np.array([[49.5, 49.5]]), 0.0), [[10.05, 49.95]])

    def test_what_cannot_be_used_is_refused(self) -> None:
        with pytest.raises(InputError, match="at least 4"):
            GcpSensor(np.zeros((3, 5)))
        line = np.column_stack([np.arange(9.0), np.arange(9.0), *np.zeros((3, 9))])
        with pytest.raises(InputError, match="on a line"):
            GcpSensor(line)


class TestSensorOf:
    def test_an_rpc_comes_before_a_geotransform_and_that_before_points(self, rpc: RpcSensor) -> None:
        grid = (10.0, 0.0, 300_000.0, 0.0, -10.0, 5_200_000.0)
        points = np.array([[0.0, 0, 10, 50, 0], [99, 0, 10.1, 50, 0], [0, 99, 10, 49.9, 0], [99, 99, 10.1, 49.9, 0]])
        everything = Geolocation(grid, UTM, rpc.rpcs, points)
        assert isinstance(sensor_of(everything, SHAPE, "a.tif"), RpcSensor)
        assert isinstance(sensor_of(Geolocation(grid, UTM, None, points), SHAPE, "a.tif"), GeotransformSensor)
        assert isinstance(sensor_of(Geolocation(grid, None, None, points), SHAPE, "a.tif"), GcpSensor)

    @pytest.mark.parametrize("nothing", [None, Geolocation(), Geolocation((1.0, 0, 0, 0, 1.0, 0))])
    def test_an_image_without_geolocation_is_named(self, nothing: Geolocation | None) -> None:
        with pytest.raises(InputError, match=r"a\.tif: nothing says where the image lies"):
            sensor_of(nothing, SHAPE, "a.tif")

    def test_a_broken_one_is_named(self) -> None:
        with pytest.raises(InputError, match=r"a\.tif: the RPC lacks"):
            sensor_of(Geolocation(rpcs={}), SHAPE, "a.tif")

    def test_sensors_survive_json_and_pickle(self, rpc: RpcSensor) -> None:
        points = np.array([[0.0, 0, 10, 50, 0], [99, 0, 10.1, 50, 0], [0, 99, 10, 49.9, 0], [99, 99, 10.1, 49.9, 0]])
        sensors: list[Sensor] = [
            rpc,
            GeotransformSensor((10.0, 0.0, 300_000.0, 0.0, -10.0, 5_200_000.0), UTM, (100, 200)),
            GcpSensor(points),
        ]
        xy = np.array([[3.0, 4.0], [90.0, 80.0]])
        for sensor in sensors:
            want = sensor.image_to_ground(xy, 10.0)
            assert np.array_equal(
                sensor_from_dict(json.loads(json.dumps(sensor.to_dict()))).image_to_ground(xy, 10.0), want
            )
            assert np.array_equal(pickle.loads(pickle.dumps(sensor)).image_to_ground(xy, 10.0), want)

    def test_an_unknown_type_is_refused(self) -> None:
        with pytest.raises(InputError, match="a sensor's type"):
            sensor_from_dict({"type": "lidar"})


class TestDemHeights:
    def test_heights_belong_to_cell_centres_and_are_bilinear_between(self, tmp_path: Path) -> None:
        values = np.random.default_rng(0).uniform(0, 100, (30, 40))
        dem = DemHeights(write_dem(tmp_path / "dem.tif", values, from_origin(10.0, 50.0, 0.01, 0.02)))
        at = np.array([[10.0 + 0.01 * (x + 0.5), 50.0 - 0.02 * (y + 0.5)] for x, y in ((0, 0), (39, 29), (7, 11))])
        assert np.allclose(dem.at(at), [values[0, 0], values[29, 39], values[11, 7]], atol=1e-4)
        middle = np.array([[10.0 + 0.01 * 8.0, 50.0 - 0.02 * 12.0]])
        assert dem.at(middle)[0] == pytest.approx(values[11:13, 7:9].mean(), abs=1e-4)

    def test_any_coordinate_system(self, tmp_path: Path) -> None:
        y, x = np.mgrid[0:50, 0:60]
        path = write_dem(tmp_path / "dem.tif", 2.0 * x + 3.0 * y, from_origin(300_000, 5_200_000, 30, 30), UTM)
        east, north = 300_000 + 30 * np.array([10.5, 20.25]), 5_200_000 - 30 * np.array([5.5, 30.75])
        lonlat = np.column_stack(through(UTM, "EPSG:4326", east, north))
        assert np.allclose(DemHeights(path).at(lonlat), [20 + 15, 2 * 19.75 + 3 * 30.25], atol=1e-3)
        assert DemHeights(path, offset=40.0).at(lonlat)[0] == pytest.approx(75.0, abs=1e-3)

    def test_tiles_leave_no_seam_and_stay_few(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("featreg.geolocation.heights.TILE", 16)
        monkeypatch.setattr("featreg.geolocation.heights.KEPT", 3)
        y, x = np.mgrid[0:70, 0:90]
        dem = DemHeights(write_dem(tmp_path / "dem.tif", 5.0 * x - 7.0 * y, from_origin(10.0, 50.0, 0.01, 0.01)))
        cells = np.random.default_rng(1).uniform(0, [89, 69], (4000, 2))
        lonlat = [10.0, 50.0] + (cells + 0.5) * [0.01, -0.01]
        assert np.allclose(dem.at(lonlat), 5.0 * cells[:, 0] - 7.0 * cells[:, 1], atol=1e-6)
        assert len(dem._state.tiles) == 3

    def test_holes_are_filled_from_around_and_said_once(self, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
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

    def test_deep_holes_are_the_sea(self, tmp_path: Path) -> None:
        values = np.full((300, 300), np.nan)
        values[:, :20] = 50.0
        dem = DemHeights(write_dem(tmp_path / "dem.tif", values, from_origin(10.0, 50.0, 0.01, 0.01)), offset=7.0)
        lonlat = np.array([[10.0 + 0.01 * 5, 48.0], [10.0 + 0.01 * 290, 48.0]])
        assert np.allclose(dem.at(lonlat), [57.0, 7.0], atol=1e-4)

    def test_beyond_the_edge_it_goes_on_and_can_be_told(self, tmp_path: Path) -> None:
        x = np.tile(np.arange(20.0), (20, 1))
        dem = DemHeights(write_dem(tmp_path / "dem.tif", x, from_origin(10.0, 50.0, 0.01, 0.01)))
        lonlat = np.array([[9.0, 49.9], [12.0, 49.9], [10.1, 49.9], [370.1, 49.9], [np.nan, 49.9]])
        assert np.allclose(dem.at(lonlat)[:4], [0.0, 19.0, 9.5, 9.5], atol=1e-6)
        assert np.isnan(dem.at(lonlat)[4])
        assert dem.covers(lonlat).tolist() == [False, False, True, True, False]

    def test_it_travels_by_name_and_knows_its_file(self, tmp_path: Path) -> None:
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

    def test_threads_share_it(self, tmp_path: Path) -> None:
        y, x = np.mgrid[0:1300, 0:1300]
        dem = DemHeights(write_dem(tmp_path / "dem.tif", 0.1 * x + y, from_origin(10.0, 50.0, 0.001, 0.001)))
        cells = np.random.default_rng(1).uniform(0, 1299, (2000, 2))
        lonlat = [10.0, 50.0] + (cells + 0.5) * [0.001, -0.001]
        with ThreadPoolExecutor(8) as pool:
            found = list(pool.map(lambda _: dem.at(lonlat), range(16)))
        assert all(np.array_equal(one, found[0]) for one in found)
        assert np.allclose(found[0], 0.1 * cells[:, 0] + cells[:, 1], atol=1e-3)

    def test_unusable_files_are_named(self, tmp_path: Path) -> None:
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


@dataclass(frozen=True)
class Ramp(Heights):
    """Hills of the given slope along the parallel, as saw teeth."""

    slope: float

    def at(self, lonlat: FloatArray) -> FloatArray:
        east = (lonlat[:, 0] - PLACE[0]) * METRES_PER_DEGREE * math.cos(math.radians(PLACE[1]))
        return np.asarray(400.0 + self.slope * np.abs((east % 800.0) - 400.0))

    def to_dict(self) -> dict[str, Any]:
        return {"type": "ramp"}


class TestTransfer:
    def test_it_is_the_exact_geometry(self, rpc: RpcSensor, exact: RangeDoppler) -> None:
        other = orbit(incidence_deg=42.0, heading_deg=-10.0)
        hills = Terrain.made(PLACE, 400.0, 500.0, 5000.0, np.random.default_rng(0))
        xy = np.random.default_rng(1).uniform(200, 1800, (2000, 2))
        by_rpc = Transfer(rpc, other.rpc(SHAPE, -200.0, 1000.0, 15.0), hills)(xy)
        truth = Transfer(exact, other, hills)(xy)
        assert np.abs(by_rpc - truth).max() < 1e-3
        # The displacement is really not affine.
        plane = np.column_stack([np.ones(len(xy)), xy])
        assert np.abs(truth - plane @ np.linalg.lstsq(plane, truth)[0]).max() > 5

    @pytest.mark.parametrize("slope", [0.2, 0.69, 0.75, 1.5, 4.0])
    def test_the_ground_is_found_on_any_slope(self, rpc: RpcSensor, slope: float) -> None:
        # Incidence 35 degrees: from a slope of tan 35 = 0.70 on, the ground lies over and the plain iteration diverges.
        xy = np.random.default_rng(1).uniform(200, 1800, (2000, 2))
        lonlat, level = on_ground(rpc, xy, Ramp(slope))
        assert np.isfinite(level).all()
        assert np.abs(Ramp(slope).at(lonlat) - level).max() < 1e-3
        assert np.abs(rpc.ground_to_image(lonlat, level) - xy).max() < 1e-6

    def test_there_and_back(self, rpc: RpcSensor) -> None:
        other = orbit(incidence_deg=42.0).rpc(SHAPE, -200.0, 1000.0, 15.0)
        transfer = Transfer(rpc, other, Terrain.made(PLACE, 400.0, 300.0, 5000.0, np.random.default_rng(0)))
        xy = np.random.default_rng(1).uniform(0, 2000, (1000, 2))
        assert np.abs(transfer.inverse(transfer(xy)) - xy).max() < 1e-4
        assert transfer(xy.reshape(10, 100, 2)).shape == (10, 100, 2)
        assert np.isnan(transfer(np.array([[np.nan, 3.0]]))).all()
        assert transfer(np.zeros((0, 2))).shape == (0, 2)

    def test_it_is_not_fitted(self) -> None:
        with pytest.raises(InputError, match="RpcBias"):
            Transfer.from_estimate(np.zeros((3, 2)), np.zeros((3, 2)))


class TestOverlap:
    def grid(self, x: float, y: float, step: float = 10.0, turn: float = 0.0) -> GeotransformSensor:
        c, s = step * math.cos(turn), step * math.sin(turn)
        return GeotransformSensor((c, s, 300_000 + x, s, -c, 5_200_000 - y), UTM, (100, 100))

    def test_shifted_grids_share_the_expected_windows(self) -> None:
        found = find_overlap(self.grid(0, 0), self.grid(200, 300), (100, 120), (90, 110), ConstantHeight())
        here, there = found.reference, found.secondary
        assert (here.x, here.y, here.width, here.height) == (20, 30, 100, 70)
        assert (there.x, there.y, there.width, there.height) == (0, 0, 100, 70)
        assert np.allclose(found.transfer(np.array([[20.0, 30.0]])), [[0, 0]], atol=1e-6)
        assert found.uncertainty_px == pytest.approx(5 * math.sqrt(2))

    def test_an_image_inside_the_other_is_kept_whole(self) -> None:
        found = find_overlap(self.grid(0, 0), self.grid(-1000, -1000), (100, 120), (900, 900), ConstantHeight())
        here, there = found.reference, found.secondary
        assert (here.x, here.y, here.width, here.height) == (0, 0, 120, 100)
        assert (there.x, there.y, there.width, there.height) == (100, 100, 120, 100)

    def test_every_pixel_of_a_turned_overlap_lies_in_both_images(self) -> None:
        shape = (400, 400)
        found = find_overlap(self.grid(0, 0), self.grid(300, 500, turn=0.1), shape, shape, ConstantHeight())
        w = found.reference
        x, y = np.meshgrid(np.arange(w.x, w.x + w.width), np.arange(w.y, w.y + w.height))
        mapped = found.transfer(np.column_stack([x.ravel(), y.ravel()]).astype(float))
        assert ((mapped > -0.51) & (mapped < 399.51)).all()
        low, high = mapped.min(axis=0), mapped.max(axis=0)
        s = found.secondary
        assert s.x - 1 <= low[0] + 1e-6
        assert s.x + s.width >= high[0]
        assert w.width * w.height > 0.6 * 400 * 400

    def test_no_overlap_says_where_each_image_lies(self, rpc: RpcSensor) -> None:
        far = orbit(place=(13.0, 47.0)).rpc(SHAPE, -200.0, 1000.0, 15.0)
        with pytest.raises(NoOverlapError) as caught:
            find_overlap(rpc, far, SHAPE, SHAPE, ConstantHeight(400.0), names=("a.tif", "b.tif"))
        text = str(caught.value)
        assert "a.tif spans longitude 11.9" in text
        assert "b.tif spans longitude 12.9" in text
        assert "75.9 km apart" in text

    def test_an_elevation_model_elsewhere_is_refused(self, rpc: RpcSensor, tmp_path: Path) -> None:
        dem = DemHeights(write_dem(tmp_path / "dem.tif", np.zeros((20, 20)), from_origin(80.0, 10.0, 0.01, 0.01)))
        with pytest.raises(InputError, match=r"dem.tif: covers none of the overlap; it spans longitude 80\.0000"):
            find_overlap(rpc, rpc, SHAPE, SHAPE, dem)

    def test_the_largest_rectangle_is_the_largest(self) -> None:
        rng = np.random.default_rng(0)
        for _ in range(60):
            cells = rng.random(rng.integers(1, 9, 2)) < 0.7
            rows, columns = cells.shape
            best = max(
                (
                    (b - t) * (r - left)
                    for t in range(rows)
                    for b in range(t + 1, rows + 1)
                    for left in range(columns)
                    for r in range(left + 1, columns + 1)
                    if cells[t:b, left:r].all()
                ),
                default=0,
            )
            found = largest_rectangle(cells)
            if found is None:
                assert best == 0
            else:
                top, left, bottom, right = found
                assert cells[top:bottom, left:right].all()
                assert (bottom - top) * (right - left) == best
