"""Ground control points as a sensor."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from rasterio.warp import transform as through

from featreg.errors import InputError
from featreg.geolocation import ConstantHeight, GcpSensor, Heights
from featreg.geolocation.transfer import on_ground
from featreg.simulate.orbit import RangeDoppler, Terrain

PLACE = (12.0, 47.0)


@pytest.fixture(scope="module")
def wide(orbit: Callable[..., RangeDoppler]) -> RangeDoppler:
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

    def test_very_many_points_are_all_used(self, wide: RangeDoppler) -> None:
        xy = np.random.default_rng(4).uniform(0, [25_000, 16_500], (5000, 2))
        ground = wide.image_to_ground(xy, 300.0)
        noisy = GcpSensor(
            np.column_stack([xy, ground + np.random.default_rng(5).normal(0, 1e-4, (5000, 2)), xy[:, 0] * 0])
        )
        at = xy[:500] * [0.9, 0.9] + [1000, 700]
        error = np.linalg.norm(noisy.image_to_ground(at, 0.0) - wide.image_to_ground(at, 300.0), axis=1)
        # At most 66 coefficients share the noise of 5000 points; of 1000 points alone they would be off twice as far.
        assert np.sqrt((error**2).mean()) < 1.4e-4 * np.sqrt(66 / 5000)

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
