"""The way over the ground, from one image to the other."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike
from rasterio.transform import from_origin

from featreg.errors import InputError
from featreg.geolocation import DemHeights, Heights, RpcSensor, Transfer
from featreg.geolocation.sensor import METRES_PER_DEGREE, Sensor
from featreg.geolocation.transfer import CLOSE_M, by_rounds, on_ground
from featreg.simulate.orbit import RangeDoppler, Terrain
from featreg.types import FloatArray

SHAPE = (2000, 2200)
PLACE = (12.0, 47.0)


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
    def test_it_is_the_exact_geometry(
        self, rpc: RpcSensor, exact: RangeDoppler, orbit: Callable[..., RangeDoppler]
    ) -> None:
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

    def test_there_and_back(self, rpc: RpcSensor, orbit: Callable[..., RangeDoppler]) -> None:
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


@pytest.fixture(scope="module")
def dem(tmp_path_factory: pytest.TempPathFactory, write_dem: Callable[..., str]) -> DemHeights:
    """Gentle hills, with a cliff steeper than the line of sight, over several tiles."""
    y, x = np.mgrid[0:600, 0:1100] / 40.0
    hills = 400 + 60 * np.sin(x) * np.cos(0.7 * y) + 150 * (x > 20)
    corner = from_origin(PLACE[0] - 0.055, PLACE[1] + 0.03, 1e-4, 1e-4)
    return DemHeights(write_dem(tmp_path_factory.mktemp("dem") / "dem.tif", hills, corner))


class TestSecants:
    def test_they_find_what_rounds_find(self, rpc: RpcSensor, dem: DemHeights) -> None:
        xy = np.random.default_rng(3).uniform(0, 2000, (3000, 2))
        xy[7, 0] = np.nan
        lonlat, level = on_ground(rpc, xy, dem)
        other, plain = by_rounds(rpc, xy, dem, 400.0)
        single = np.isfinite(plain) & (np.abs(plain - level) < 1)
        assert np.isnan(level[7])
        assert single.sum() > 2900
        assert np.abs(level[single] - plain[single]).max() < 3 * CLOSE_M
        assert np.abs(lonlat[single] - other[single]).max() < 1e-9
        # On the cliff lines of sight meet the ground more than once.
        known = np.isfinite(level)
        assert known.sum() == 2999
        assert np.abs(dem.at(lonlat[known]) - level[known]).max() < 1e-3
        assert np.abs(rpc.ground_to_image(lonlat[known], level[known]) - xy[known]).max() < 1e-6

    def test_a_point_does_not_depend_on_the_others(
        self, rpc: RpcSensor, dem: DemHeights, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        xy = np.random.default_rng(4).uniform(0, 2000, (400, 2))
        together = on_ground(rpc, xy, dem)[1]
        assert np.array_equal(
            np.concatenate([on_ground(rpc, xy[k : k + 7], dem)[1] for k in range(0, 400, 7)]), together
        )
        monkeypatch.setattr("featreg.geolocation.elevation_model.KEPT_PATCH", 1)
        assert np.abs(on_ground(rpc, xy, dem)[1] - together).max() < 3 * CLOSE_M

    def test_which_crossing_is_found_does_not_depend_on_the_way(
        self, rpc: RpcSensor, write_dem: Callable[..., str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """On rough ground half of the lines of sight cross it more than once; secants or rounds, they take the same."""
        import cv2

        rough = cv2.GaussianBlur(np.random.default_rng(0).normal(size=(600, 1100)), (0, 0), 4.0)
        corner = from_origin(PLACE[0] - 0.055, PLACE[1] + 0.03, 1e-4, 1e-4)
        dem = DemHeights(write_dem(tmp_path / "rough.tif", 400 + 75 * rough / rough.std(), corner))
        xy = np.random.default_rng(4).uniform(0, 2000, (20_000, 2))
        level = on_ground(rpc, xy, dem)[1]
        assert np.isfinite(level).all()
        monkeypatch.setattr("featreg.geolocation.elevation_model.KEPT_PATCH", 0)
        assert np.abs(on_ground(rpc, xy, dem)[1] - level).max() < 1e-3
        scanned = np.arange(100.0, 800.0, 10.0)
        gaps = np.array([dem.at(rpc.image_to_ground(xy[:500], np.full(500, h))) - h for h in scanned])
        assert ((np.diff(np.sign(gaps), axis=0) != 0).sum(axis=0) > 1).mean() > 0.3

    def test_far_off_the_image_heights_are_those_of_the_places(self, rpc: RpcSensor, dem: DemHeights) -> None:
        lonlat, level = on_ground(rpc, np.random.default_rng(7).uniform(-1e7, 1e7, (2000, 2)), dem)
        known = np.isfinite(level)
        assert known.any()
        assert np.abs(dem.at(lonlat[known]) - level[known]).max() < 1e-3

    def test_few_points_far_apart_are_not_halved_to_single_ones(
        self, rpc: RpcSensor, dem: DemHeights, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        counts: list[int] = []

        def counted(sensor: Any, xy: FloatArray, heights: Heights, start: float) -> tuple[FloatArray, FloatArray]:
            counts.append(len(xy))
            return by_rounds(sensor, xy, heights, start)

        monkeypatch.setattr("featreg.geolocation.elevation_model.KEPT_PATCH", 0)
        monkeypatch.setattr("featreg.geolocation.transfer.by_rounds", counted)
        xy = np.random.default_rng(5).uniform(0, 2000, (400, 2))
        assert np.isfinite(on_ground(rpc, xy, dem)[1]).all()
        assert sum(counts) == 400
        assert len(counts) < 40

    def test_a_sensor_of_another_package_need_not_be_hashable(self, rpc: RpcSensor, dem: DemHeights) -> None:
        @dataclass
        class Own(Sensor):
            rpc: RpcSensor

            def ground_to_image(self, lonlat: FloatArray, heights: ArrayLike) -> FloatArray:
                return self.rpc.ground_to_image(lonlat, heights)

            def image_to_ground(self, xy: FloatArray, heights: ArrayLike) -> FloatArray:
                return self.rpc.image_to_ground(xy, heights)

            @property
            def centre(self) -> tuple[float, float]:
                return self.rpc.centre

            @property
            def uncertainty_px(self) -> float:
                return 0.0

            def to_dict(self) -> dict[str, Any]:
                return self.rpc.to_dict()

        xy = np.random.default_rng(6).uniform(0, 2000, (20, 2))
        assert np.abs(on_ground(Own(rpc), xy, dem)[1] - on_ground(rpc, xy, dem)[1]).max() < 3 * CLOSE_M
