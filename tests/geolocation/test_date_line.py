"""Longitudes count on any turn: 200 E is 160 W, and a grid may lie across the date line."""

from __future__ import annotations

import numpy as np
import pytest

from featreg.errors import NoOverlapError
from featreg.geolocation import ConstantHeight, GeotransformSensor, Sensor, find_overlap

SHAPE = (100, 400)
DEGREES = "EPSG:4326"


def grid(west: float, crs: str = DEGREES, north: float = 10.0) -> GeotransformSensor:
    return GeotransformSensor((1e-4, 0.0, west, 0.0, -1e-4, north), crs, SHAPE)


@pytest.mark.parametrize("crs", [DEGREES, "EPSG:4269", "EPSG:4258"])
@pytest.mark.parametrize("west", [200.0, -160.0, 560.0, 179.98, -180.02, 539.98])
def test_ground_on_any_turn_is_found(west: float, crs: str) -> None:
    sensor = grid(west, crs)
    xy = np.array([[0.0, 0.0], [399, 99], [10, 20], [250, 50]])
    ground = sensor.image_to_ground(xy, 0.0)
    assert (np.abs(ground[:, 0]) <= 180).all()
    for turns in (-360, 0, 360):
        assert np.abs(sensor.ground_to_image(ground + np.array([turns, 0]), 0.0) - xy).max() < 1e-6


def test_ground_where_it_was_is_not_touched() -> None:
    sensor = grid(12.0)
    xy = np.random.default_rng(0).uniform(0, 400, (100, 2))
    a, _, c, _, e, f = sensor.transform
    want = np.column_stack([a * (xy[:, 0] + 0.5) + c, e * (xy[:, 1] + 0.5) + f])
    assert np.abs(sensor.image_to_ground(xy, 0.0) - want).max() < 1e-13


@pytest.mark.parametrize(
    ("first", "second"),
    [(200.0, -160.01), (179.98, -180.03), (-180.02, 179.97), (179.98, 179.97), (-160.0, 199.99)],
)
def test_overlap_and_shift_are_those_on_the_ground(first: float, second: float) -> None:
    found = find_overlap(grid(first), grid(second), SHAPE, SHAPE, ConstantHeight())
    assert (found.reference.x, found.reference.width) == (0, 300)
    assert np.abs(found.transfer(np.array([[20.0, 30.0]])) - [[120, 30]]).max() < 1e-5


def test_utm_60_against_degrees_across_the_date_line() -> None:
    from rasterio.warp import transform

    (east,), (north,) = transform(DEGREES, "EPSG:32660", [179.98], [10.0])
    utm = GeotransformSensor((10.0, 0.0, east, 0.0, -10.0, north), "EPSG:32660", (100, 440))
    for west in (179.98, -180.02):
        found = find_overlap(utm, grid(west), (100, 440), SHAPE, ConstantHeight())
        assert found.reference.width > 390
        at = found.transfer(np.array([[400.0, 50.0]]))
        ground = utm.image_to_ground(np.array([[400.0, 50.0]]), 0.0)
        assert ground[0, 0] < -179.9
        assert np.abs(at - [[(ground[0, 0] + 180.02) / 1e-4 - 0.5, (10.0 - ground[0, 1]) / 1e-4 - 0.5]]).max() < 1e-3


def test_images_apart_say_so_across_the_date_line() -> None:
    sensors: list[Sensor] = [grid(179.98), grid(179.98, north=11.0)]
    with pytest.raises(NoOverlapError, match=r"longitude 179.9800 to 180.0200 .* 111\.3 km apart; .* at 0 m"):
        find_overlap(sensors[0], sensors[1], SHAPE, SHAPE, ConstantHeight())
