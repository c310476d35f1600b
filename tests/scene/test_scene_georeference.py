"""Scenes whose georeference is far off, or that lie high: found, or said."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg.errors import NoOverlapError
from featreg.io import as_image
from featreg.io.raster_source import ImageSource
from featreg.scene.run import SEARCH_PX, SceneOptions
from featreg.simulate.orbit import RangeDoppler
from featreg.types import Geolocation

SIDE, SHIFT = 700, (7, 4)
BLOCKS: dict[str, Any] = {"block": 240, "workers": 1, "executor": "serial"}


@pytest.fixture(scope="module")
def scenes(sar_texture: Callable[..., NDArray[np.float32]]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    ground = sar_texture(SIDE + 20, SIDE + 20, 4, 1e4)
    rng = np.random.default_rng(0)
    a, b = (np.asarray(ground * np.sqrt(rng.gamma(4.0, 0.25, ground.shape)), np.float32) for _ in range(2))
    return a[:SIDE, :SIDE], b[SHIFT[1] : SHIFT[1] + SIDE, SHIFT[0] : SHIFT[0] + SIDE]


def located(pixels: NDArray[np.float32], dx: float, dy: float) -> Any:
    place = Geolocation((10.0, 0.0, 5e5 + 10 * dx, 0.0, -10.0, 5e6 - 10 * dy), "EPSG:32633")
    return replace(as_image(np.ascontiguousarray(pixels)), geolocation=place)


@pytest.mark.parametrize("bias", [(0, 0), (60, 0), (-80, 50), (0, 140), (250, 0)])
def test_a_georeference_that_is_far_off_is_found(scenes: Any, bias: tuple[int, int]) -> None:
    dx, dy = SHIFT[0] + bias[0], SHIFT[1] + bias[1]
    result = featreg.match(located(scenes[0], 0, 0), located(scenes[1], dx, dy), **BLOCKS)
    assert result.status == "ok", result.reason
    at = np.array([[350.0, 350.0], [200, 500], [500, 200]])
    assert np.abs(result.model(at) - (at - SHIFT)).max() < 0.4


def test_beyond_the_limit_the_reason_names_the_search(scenes: Any) -> None:
    other = np.ascontiguousarray(scenes[1][::-1, ::-1])
    result = featreg.match(located(scenes[0], 0, 0), located(other, *SHIFT), **BLOCKS)
    assert result.status == "unreliable"
    assert f"no agreement within {SEARCH_PX[-1]:.0f} px of where both geolocations say" in result.reason
    assert result.provenance["prior"]["searched_px"] == SEARCH_PX[-1]


@functools.cache
def places_of(shape: tuple[int, int], offset: float) -> list[Geolocation]:
    view: dict[str, Any] = {"incidence_deg": 35.0, "pixel": 3.0, "height": offset}
    orbits = [RangeDoppler.over((90.0, 32.0), shape, heading_deg=heading, **view) for heading in (-12.0, 192.0)]
    return [Geolocation(rpcs=dict(o.rpc(shape, offset - 100, offset + 100, 15.0).rpcs)) for o in orbits]


def high(pixels: NDArray[np.float32], offset: float = 4200.0) -> tuple[Any, Any]:
    """High ground from an ascending and a descending orbit; the RPCs hold within 100 m of `offset`."""
    places = places_of((pixels.shape[0], pixels.shape[1]), offset)
    image = as_image(np.ascontiguousarray(pixels))
    return replace(image, geolocation=places[0]), replace(image, geolocation=places[1])


def test_the_ground_lies_at_the_height_of_the_rpc(scenes: Any) -> None:
    pair = [ImageSource(image) for image in high(scenes[0])]
    heights, whence = SceneOptions(240).heights(*pair)
    assert heights.to_dict() == {"type": "constant", "metres": pytest.approx(4200.0, abs=1.0)}
    assert whence == "height offset of the RPC"
    stated, how = SceneOptions(240, height=12.0).heights(*pair)
    assert (stated.to_dict()["metres"], how) == (12.0, "stated")
    assert SceneOptions(240).heights(ImageSource(located(scenes[0], 0, 0)))[0].to_dict()["metres"] == 0.0


def test_high_ground_overlaps_and_the_result_says_at_which_height(scenes: Any) -> None:
    result = featreg.match(*high(scenes[0]), **BLOCKS)
    assert result.provenance["heights"]["metres"] == pytest.approx(4200.0, abs=1.0)
    assert result.provenance["heights"]["source"] == "height offset of the RPC"


def test_without_overlap_the_height_is_named(scenes: Any) -> None:
    first, second = high(scenes[0])
    with pytest.raises(NoOverlapError, match="with the ground at 0 m"):
        featreg.match(first, second, height=0.0, **BLOCKS)
