"""Images, scenes in files and tie points are recorded alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import featreg
from featreg.errors import InputError
from featreg.io import as_image, write_geotiff
from featreg.io.raster_source import ImageSource, open_source
from featreg.pipeline.inputs import input_image
from featreg.results.registration import Registration
from featreg.simulate import SimulatedPair
from featreg.types import Geolocation, PixelSize

PLACE = Geolocation((20.0, 0.0, 5e5, 0.0, -10.0, 5e6), "EPSG:32633")


@pytest.fixture
def file(tmp_path: Path) -> str:
    samples = np.arange(1, 1201, dtype=np.uint16).reshape(30, 40)
    samples[:2] = 0
    write_geotiff(tmp_path / "a.tif", samples, PLACE, nodata=0)
    return str(tmp_path / "a.tif")


def test_an_image_and_a_scene_of_one_file(file: str) -> None:
    image, scene = input_image(as_image(file)), input_image(open_source(file))
    for found in (image, scene):
        assert (found.path, found.shape, found.scale, found.dtype) == (file, (30, 40), "amplitude", "uint16")
        assert found.pixel_size == PixelSize(20.0, 10.0, "metre")
        assert found.geolocation is not None
        assert found.geolocation.transform == PLACE.transform
    assert image.valid_pixels == 28 * 40
    assert scene.valid_pixels is None
    assert input_image(ImageSource(as_image(file))).valid_pixels == 28 * 40


def test_a_match_records_its_images_whole_and_in_blocks(pair: SimulatedPair, tmp_path: Path) -> None:
    write_geotiff(tmp_path / "a.tif", pair.reference, PLACE)
    height, width = pair.reference.shape
    for block in (False, 160):
        found = featreg.match(tmp_path / "a.tif", pair.secondary, block=block)
        found.to_json(tmp_path / "r.json")
        for result in (found, Registration.from_json(tmp_path / "r.json")):
            assert result.reference is not None
            assert result.secondary is not None
            assert (result.reference.path, result.reference.shape) == (str(tmp_path / "a.tif"), (height, width))
            assert result.reference.pixel_size == PixelSize(20.0, 10.0, "metre")
            assert (result.secondary.path, result.secondary.shape) == ("array", pair.secondary.shape)
            assert result.secondary.geolocation is None
            assert "inputs" not in result.provenance
        assert found.secondary is not None
        assert found.secondary.valid_pixels == pair.secondary.size


def test_a_scene_without_a_prior_records_its_images_too(pair: SimulatedPair) -> None:
    other = np.random.default_rng(0).rayleigh(1.0, (200, 180)).astype(np.float32)
    found = featreg.match(pair.reference, other, block=128)
    assert found.status == "unreliable"
    assert not found.model
    assert found.reference is not None
    assert found.secondary is not None
    assert (found.reference.shape, found.secondary.shape) == (pair.reference.shape, (200, 180))


def test_tie_points_of_the_user_come_from_no_file() -> None:
    here = np.random.default_rng(0).uniform(0, 99, (40, 2))
    found = featreg.fit(np.column_stack([here, here + 3.0]), reference_shape=(100, 110))
    assert found.reference is not None
    assert found.secondary is not None
    assert (found.reference.path, found.reference.shape) == ("tie points", (100, 110))
    assert found.secondary.path == "tie points"
    assert max(found.secondary.shape) <= 103
    with pytest.raises(InputError, match="at least 1 x 1"):
        featreg.fit(np.column_stack([here, here]), reference_shape=(0, 10))
