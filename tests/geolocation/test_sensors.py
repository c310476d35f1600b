"""Geotransforms as sensors, and which sensor an image gets."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pytest
from rasterio.transform import Affine as Geotransform
from rasterio.warp import transform as through

from featreg.errors import InputError
from featreg.geolocation import GcpSensor, GeotransformSensor, RpcSensor, Sensor, sensor_from_dict, sensor_of
from featreg.geolocation.pixel_size import pixel_size
from featreg.geolocation.sensor import METRES_PER_DEGREE
from featreg.types import Geolocation

SHAPE = (2000, 2200)
UTM = "EPSG:32633"


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


class TestSensorOf:
    def test_an_rpc_comes_before_a_geotransform_and_that_before_points(self, rpc: RpcSensor) -> None:
        grid = (10.0, 0.0, 300_000.0, 0.0, -10.0, 5_200_000.0)
        points = np.array([[0.0, 0, 10, 50, 0], [99, 0, 10.1, 50, 0], [0, 99, 10, 49.9, 0], [99, 99, 10.1, 49.9, 0]])
        everything = Geolocation(grid, UTM, rpc.rpcs, points)
        assert isinstance(sensor_of(everything, SHAPE, "a.tif"), RpcSensor)
        assert isinstance(sensor_of(Geolocation(grid, UTM, None, points), SHAPE, "a.tif"), GeotransformSensor)
        assert isinstance(sensor_of(Geolocation(None, "EPSG:4326", None, points), SHAPE, "a.tif"), GcpSensor)

    @pytest.mark.parametrize("nothing", [None, Geolocation(), Geolocation((1.0, 0, 0, 0, 1.0, 0))])
    def test_an_image_without_geolocation_is_named(self, nothing: Geolocation | None) -> None:
        with pytest.raises(InputError, match=r"a\.tif: nothing says where the image lies"):
            sensor_of(nothing, SHAPE, "a.tif")

    def test_control_points_without_a_coordinate_system_are_not_degrees(self) -> None:
        points = np.array([[0.0, 0, 5e5, 4.6e6, 0], [99, 0, 501e3, 4.6e6, 0], [0, 99, 5e5, 4.599e6, 0]])
        place = Geolocation(gcps=np.vstack([points, [99.0, 99, 501e3, 4.599e6, 0]]))
        with pytest.raises(InputError, match=r"its ground control points have no coordinate system"):
            sensor_of(place, SHAPE, "a.tif")
        assert pixel_size(place) is None

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
