"""What a result says of its images is written whole and read back equal."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rasterio.rpc import RPC

from featreg.errors import InputError
from featreg.geometry import Translation
from featreg.results.input_image import InputImage
from featreg.results.json_file import plain
from featreg.results.registration import Registration
from featreg.types import Geolocation, Matches, PixelSize

ONE = [1.0] + [0.0] * 19
THIRD = 1 / 3
RPCS = RPC(
    height_off=100.0, height_scale=500.0, lat_off=45.1 + 1e-13, lat_scale=0.1, line_den_coeff=ONE,
    line_num_coeff=[0, 0, -1.0, *[THIRD] * 17], line_off=4000.0, line_scale=4000.0, long_off=9.3, long_scale=0.1,
    samp_den_coeff=ONE, samp_num_coeff=[0, 1.0] + [0.0] * 18, samp_off=5000.0, samp_scale=5000.0, err_bias=None,
    err_rand=0.5,
).to_dict()  # fmt: skip
GCPS = np.random.default_rng(0).uniform(-180, 180, (210, 5))
PLACES = {
    "geotransform": Geolocation((10.0, 0.1, 500000.0 + THIRD, 0.0, -10.0, 5e6), "EPSG:32633"),
    "rpc": Geolocation(rpcs=RPCS),
    "gcps": Geolocation(crs="EPSG:4326", gcps=GCPS),
    "all": Geolocation((1.0, 0.0, 0.0, 0.0, -1.0, 0.0), "EPSG:4326", RPCS, GCPS[:4]),
}


def registration(reference: InputImage | None = None, secondary: InputImage | None = None) -> Registration:
    return Registration(
        Matches.empty(), {}, np.zeros(0, np.bool_), Translation(1.0, 2.0), "ok",
        provenance={"method": "m"}, reference=reference, secondary=secondary,
    )  # fmt: skip


def assert_same(a: InputImage | None, b: InputImage | None) -> None:
    assert a is not None
    assert b is not None
    names = ("path", "shape", "scale", "dtype", "valid_pixels", "pixel_size")
    assert [getattr(a, n) for n in names] == [getattr(b, n) for n in names]
    assert (a.geolocation is None) == (b.geolocation is None)
    if a.geolocation is not None and b.geolocation is not None:
        assert a.geolocation.transform == b.geolocation.transform
        assert (a.geolocation.crs, a.geolocation.rpcs) == (b.geolocation.crs, b.geolocation.rpcs)
        assert (a.geolocation.gcps is None) == (b.geolocation.gcps is None)
        if a.geolocation.gcps is not None:
            np.testing.assert_array_equal(a.geolocation.gcps, b.geolocation.gcps)


@pytest.mark.parametrize("place", PLACES)
def test_everything_comes_back_equal(place: str, tmp_path: Path) -> None:
    size = PixelSize(10.0, THIRD, "metre")
    image = InputImage("a.tif", (500, 612), "intensity", "uint16", 305_999, size, PLACES[place])
    registration(reference=image, secondary=InputImage("array", (3, 4))).to_json(tmp_path / "r.json")
    found = Registration.from_json(tmp_path / "r.json")
    assert_same(found.reference, image)
    assert_same(found.secondary, InputImage("array", (3, 4)))
    found.to_json(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "r.json").read_bytes()


def test_the_file_begins_with_the_contracted_keys_and_holds_only_what_is_known(tmp_path: Path) -> None:
    image = InputImage(
        "a.tif", (500, 612), "db", "float32", None, PixelSize(2.0, 3.0, "degree"), PLACES["geotransform"]
    )
    registration(reference=image, secondary=InputImage("b.tif", (3, 4))).to_json(tmp_path / "r.json")
    data = json.loads((tmp_path / "r.json").read_text())
    assert list(data["reference"]) == ["path", "width", "height", "scale", "dtype", "pixel_size", "geolocation"]
    assert (data["reference"]["width"], data["reference"]["height"]) == (612, 500)
    assert data["reference"]["pixel_size"] == {"x": 2.0, "y": 3.0, "unit": "degree"}
    assert list(data["reference"]["geolocation"]) == ["transform", "crs"]
    assert data["secondary"] == {"path": "b.tif", "width": 4, "height": 3}
    assert "inputs" not in data["provenance"]


def test_a_result_without_images(tmp_path: Path) -> None:
    registration().to_json(tmp_path / "r.json")
    nothing = {"path": None, "width": None, "height": None}
    assert json.loads((tmp_path / "r.json").read_text())["reference"] == nothing
    found = Registration.from_json(tmp_path / "r.json")
    assert found.reference is None
    assert found.secondary is None


def test_a_number_that_is_not_finite_is_null_in_the_file(tmp_path: Path) -> None:
    gcps = GCPS[:5].copy()
    gcps[2, 4] = np.nan
    image = InputImage("a.tif", (5, 6), geolocation=Geolocation(gcps=gcps))
    registration(reference=image).to_json(tmp_path / "r.json")
    assert "NaN" not in (tmp_path / "r.json").read_text()
    assert_same(Registration.from_json(tmp_path / "r.json").reference, image)


@pytest.mark.parametrize(
    "spoiled",
    [
        None,
        {"path": "a.tif", "width": 4},
        {"path": "a.tif", "width": 4, "height": 0},
        {"path": "a.tif", "width": "wide", "height": 3},
        {"path": None, "width": 4, "height": 3},
        {"path": "a.tif", "width": 4, "height": 3, "pixel_size": {"x": 1.0}},
        {"path": "a.tif", "width": 4, "height": 3, "geolocation": {"transform": [1, 2, 3]}},
        {"path": "a.tif", "width": 4, "height": 3, "geolocation": {"gcps": [[1, 2, 3]]}},
        {"path": "a.tif", "width": 4, "height": 3, "geolocation": {"colour": 1}},
    ],
)
def test_a_spoiled_image_is_refused_in_one_line(spoiled: Any, tmp_path: Path) -> None:
    file = tmp_path / "r.json"
    registration(reference=InputImage("a.tif", (3, 4))).to_json(file)
    file.write_text(json.dumps({**json.loads(file.read_text()), "reference": spoiled}))
    with pytest.raises(InputError, match=r"r\.json") as caught:
        Registration.from_json(file)
    assert "\n" not in str(caught.value)


def test_only_path_width_and_height_are_needed() -> None:
    made = InputImage.from_dict({"path": "a.tif", "width": 4, "height": 3})
    assert_same(made, InputImage("a.tif", (3, 4)))


def test_numpy_numbers_are_made_plain() -> None:
    image = InputImage("a.tif", (np.int64(3), np.int32(4)), valid_pixels=np.int64(7))  # type: ignore[arg-type]
    assert image.shape == (3, 4)
    json.dumps(plain(image.to_dict()))
