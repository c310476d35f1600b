"""Two passes of one orbit in blocks, and an orbit of another time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import featreg
from featreg.errors import InputError
from featreg.geolocation import (
    RangeDopplerSensor,
    RpcBias,
    SicdSensor,
    sensor_from_dict,
)
from featreg.io import as_image
from featreg.simulate.orbit import RangeDoppler
from featreg.simulate.scene import ScenePair, simulate_scene
from featreg.simulate.sicd import write_sicd
from featreg.types import Geolocation, Image


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> ScenePair:
    """Two passes over hills of 120 m; the secondary lies -2 px of range and 3 px of time off what it states."""
    return simulate_scene(tmp_path_factory.mktemp("pair"), (600, 640), relief=120.0, bias=(-2.0, 3.0), seed=4)


def views(pair: ScenePair) -> list[RangeDoppler]:
    """What both images state; the secondary's knows nothing of its bias."""
    first, second = pair.truth.reference, pair.truth.secondary
    assert isinstance(first, RangeDoppler)
    assert isinstance(second, RangeDoppler)
    middle = second.middle[0] - pair.bias[0], second.middle[1] - pair.bias[1]
    return [first, replace(second, middle=middle)]


@pytest.mark.slow
class TestPairInBlocks:
    """The bias is found to 0.05 px in the middle, with the DEM, from the pixels alone."""

    def test_by_orbit_and_timing(self, pair: ScenePair) -> None:
        images = []
        for path, view in zip((pair.reference, pair.secondary), views(pair), strict=True):
            image = as_image(path)
            place = Geolocation(sensor=view.sensor(image.shape, 260.0).to_dict())
            images.append(Image(image.pixels, image.mask, place, path.name, image.source_dtype, image.scale))
        result = featreg.match(*images, model="rpc-bias", dem=str(pair.dem), block=320, seed=0)
        assert result.status == "ok"
        model = result.model
        assert isinstance(model, RpcBias)
        middle = np.array([[320.0, 300.0]])
        np.testing.assert_allclose((model(middle) - model.transfer(middle))[0], pair.bias, atol=0.05)
        secondary = model.secondary
        assert isinstance(secondary, RangeDopplerSensor)
        metres, seconds = model.timing_bias()
        assert metres == pytest.approx(2.0 * secondary.range_spacing, abs=0.07 * secondary.range_spacing)
        assert seconds == pytest.approx(-3.0 * secondary.line_interval, abs=0.07 * secondary.line_interval)

    @pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of sarkit
    def test_by_the_projections_of_two_sicds(self, pair: ScenePair, tmp_path: Path) -> None:
        pytest.importorskip("sarkit")
        rng = np.random.default_rng(0)
        files = []
        for path, view in zip((pair.reference, pair.secondary), views(pair), strict=True):
            amplitude = as_image(path).amplitude
            samples = (amplitude * np.exp(1j * rng.uniform(0, 2 * np.pi, amplitude.shape))).astype(np.complex64)
            files.append(tmp_path / f"{path.stem}.nitf")
            write_sicd(files[-1], samples, view, 260.0)
        result = featreg.match(*files, model="rpc-bias", dem=str(pair.dem), block=320, seed=0)
        assert result.status == "ok"
        model = result.model
        assert isinstance(model, RpcBias)
        assert isinstance(model.secondary, SicdSensor)
        # Rows of a SICD are range.
        middle = np.array([[300.0, 320.0]])
        np.testing.assert_allclose((model(middle) - model.transfer(middle))[0], pair.bias[::-1], atol=0.05)


def test_an_orbit_of_another_time_locates_nothing() -> None:
    shape = (300, 400)
    way = RangeDoppler.over((12.0, 47.0), shape, incidence_deg=35.0, heading_deg=-12.0, pixel=3.0, height=400.0)
    values = way.sensor(shape, 400.0).to_dict()
    assert sensor_from_dict(values).image_to_ground(np.array([[9.0, 9.0]]), 400.0).shape == (1, 2)
    values["times"] = [time - 400.0 for time in values["times"]]
    with pytest.raises(InputError, match="must cover it"):
        sensor_from_dict(values)
