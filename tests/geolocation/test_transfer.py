"""The way over the ground, from one image to the other."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError
from featreg.geolocation import Heights, RpcSensor, Transfer
from featreg.geolocation.sensor import METRES_PER_DEGREE
from featreg.geolocation.transfer import on_ground
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
