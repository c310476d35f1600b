"""The size of a pixel from each form of geolocation, against the sensors themselves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from featreg.geolocation import sensor_of
from featreg.geolocation.pixel_size import pixel_size
from featreg.io import read_image
from featreg.simulate.scene import simulate_scene
from featreg.types import Geolocation

TURNED = (8.0, 3.0, 5e5, 6.0, -4.0, 5e6)


def test_a_geotransform_gives_its_own_size_in_its_unit() -> None:
    assert pixel_size(Geolocation((10.0, 0.0, 5e5, 0.0, -20.0, 5e6), "EPSG:32633")) == (10.0, 20.0, "metre")
    assert pixel_size(Geolocation(TURNED, "EPSG:32633")) == (10.0, 5.0, "metre")
    assert pixel_size(Geolocation((1e-4, 0.0, 9.0, 0.0, -2e-4, 45.0), "EPSG:4326")) == (1e-4, 2e-4, "degree")
    feet = pixel_size(Geolocation((100.0, 0.0, 6e6, 0.0, -100.0, 2e6), "EPSG:2225"))
    assert feet is not None
    assert feet.unit == "metre"
    assert feet[:2] == pytest.approx((30.48006, 30.48006), abs=1e-5)


@pytest.mark.parametrize(
    "place",
    [
        Geolocation(),
        Geolocation(TURNED),
        Geolocation(TURNED, "no such system"),
        Geolocation((0.0, 0.0, 5e5, 0.0, 0.0, 5e6), "EPSG:32633"),
        Geolocation(rpcs={"samp_off": 1.0}),
        Geolocation(gcps=np.zeros((4, 5))),
        Geolocation(gcps=np.array([[i, i, 9.0 + i, 45.0 + i, 0.0] for i in range(5)])),
        Geolocation(gcps=np.full((4, 5), np.nan)),
        Geolocation(gcps=np.zeros((0, 5))),
    ],
)
def test_where_nothing_tells_it_there_is_none(place: Geolocation) -> None:
    assert pixel_size(place) is None


def test_rpc_and_control_points_agree_with_the_sensor(tmp_path: Path) -> None:
    image = read_image(simulate_scene(tmp_path, (256, 320), relief=16.0, seed=4).reference)
    place = image.geolocation
    assert place is not None
    assert place.rpcs is not None
    sensor = sensor_of(place, image.shape, "reference")
    height = float(place.rpcs["height_off"])
    found = pixel_size(place)
    assert found is not None
    assert found.unit == "metre"
    assert found[:2] == pytest.approx(sensor.pixel_size(height), rel=1e-3)

    x, y = (grid.ravel() for grid in np.meshgrid(np.linspace(0, 319, 7), np.linspace(0, 255, 5)))
    lonlat = sensor.image_to_ground(np.column_stack([x, y]), height)
    gcps = np.column_stack([x, y, lonlat, np.full(len(x), height)])
    mean = pixel_size(Geolocation(crs="EPSG:4326", gcps=gcps))
    assert mean is not None
    assert mean.unit == "metre"
    assert mean[:2] == pytest.approx(found[:2], rel=1e-2)
    # An RPC goes before a geotransform, as for the sensor.
    assert pixel_size(replace(place, transform=TURNED, crs="EPSG:32633")) == found
