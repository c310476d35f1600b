"""A product reads its image as the match did: scale, band and stated value for no data stand in the result."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import featreg
from featreg.io.raster_source import open_source
from featreg.pipeline.inputs import input_image
from featreg.results.input_image import InputImage
from featreg.results.summary import image_words
from made.rasters import write_raster

rasterio = pytest.importorskip("rasterio")
pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

H, W = 40, 50
#: Intensities with a frame of -7 that no tag of the file speaks of.
INTENSITY = np.random.default_rng(0).gamma(2, 30, (H, W)).astype(np.float32) + 1
INTENSITY[:6] = -7
INSIDE = (np.arange(H) >= 6)[:, None] & np.ones((H, W), np.bool_)
READING: dict[str, Any] = {"scale": "intensity", "nodata": -7}


def result(secondary: InputImage) -> featreg.Registration:
    """A registration by the identity between two images of one size."""
    xy = np.random.default_rng(1).uniform(0, 40, (60, 2))
    made = featreg.fit(featreg.Matches(xy, xy, np.ones(60)), model="translation")
    return replace(made, reference=InputImage("array", (H, W)), secondary=secondary)


@pytest.mark.parametrize("windows", [False, True])
def test_a_result_keeps_how_its_images_were_read(windows: bool, tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.tif", np.stack([INTENSITY * 2, INTENSITY]))
    reading = READING | {"band": 2}
    opened: Any = open_source(path, **reading) if windows else featreg.as_image(path, **reading)
    known = input_image(opened)
    assert known.reading == reading | {"band": "2", "calibrate": None}
    again = InputImage.from_dict(json.loads(json.dumps(known.to_dict())))
    assert again is not None
    assert again.reading == known.reading
    np.testing.assert_array_equal(featreg.as_image(path, **again.reading).mask, INSIDE)


def test_values_for_no_data_are_kept_as_json_holds_them() -> None:
    for given, wanted in ((0, 0.0), (2.5, 2.5), (1 - 2j, 1 - 2j), (np.nan, np.nan), (np.inf, np.nan), (None, None)):
        image = InputImage("a", (20, 20), "complex", nodata=given)
        again = InputImage.from_dict(json.loads(json.dumps(image.to_dict(), allow_nan=False)))
        assert again is not None
        for one in (image, again):
            assert one.nodata == wanted or (one.nodata != one.nodata and wanted != wanted)  # NaN equals nothing


def test_a_value_of_a_file_that_was_overridden_by_none_stays_so(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    samples = np.arange(400, dtype=np.float32).reshape(20, 20)
    with rasterio.open(path, "w", driver="GTiff", dtype="float32", height=20, width=20, count=1, nodata=7) as dataset:
        dataset.write(samples, 1)
    assert not featreg.as_image(path).mask[0, 7]
    known = input_image(featreg.as_image(path, nodata=np.nan))
    again = InputImage.from_dict(json.loads(json.dumps(known.to_dict(), allow_nan=False)))
    assert again is not None
    assert featreg.as_image(path, **again.reading).mask.all()
    assert "no value stands for no data" in image_words(again)


def test_products_of_files_follow(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.tif", INTENSITY)
    made = result(InputImage(str(path), (H, W), **READING))
    warped = featreg.warp(made, path, resampling="nearest")
    np.testing.assert_array_equal(np.isfinite(warped), INSIDE)
    np.testing.assert_allclose(warped[INSIDE], np.sqrt(INTENSITY[INSIDE]), rtol=1e-6)
    made.to_json(tmp_path / "r.json")
    other = float(INTENSITY[9, 9])
    for name, nodata, shown in (("o.tif", None, INSIDE), ("p.tif", other, other != INTENSITY)):
        featreg.warp_file(tmp_path / "r.json", path, tmp_path / name, like=(H, W), resampling="nearest", nodata=nodata)
        with rasterio.open(tmp_path / name) as dataset:
            # What is stated now counts before what was.
            np.testing.assert_array_equal(dataset.read_masks(1) > 0, shown)


def test_products_of_arrays_follow() -> None:
    made = result(InputImage("array", (H, W), **READING))
    warped = featreg.warp(made, INTENSITY, resampling="nearest")
    np.testing.assert_array_equal(np.isfinite(warped), INSIDE)
    xr = pytest.importorskip("xarray")
    again = featreg.warp(made, xr.DataArray(INTENSITY, dims=("y", "x")), resampling="nearest")
    np.testing.assert_array_equal(again.values, warped)
    # An image is what it is.
    image = featreg.as_image(np.abs(INTENSITY))
    np.testing.assert_array_equal(featreg.warp(made, image, resampling="nearest"), image.pixels)


def test_reports_and_pictures_read_the_same(tmp_path: Path) -> None:
    from featreg.pictures.interactive import _images
    from featreg.report.from_registration import _image

    path = write_raster(tmp_path / "a.tif", np.stack([INTENSITY * 2, INTENSITY]))
    known = InputImage(str(path), (H, W), band="2", **READING)
    shown = _image("secondary", None, known)()
    np.testing.assert_allclose(shown.pixels[INSIDE], np.sqrt(INTENSITY[INSIDE]), rtol=1e-6)
    both = _images(replace(result(known), reference=known), None, None)
    assert both is not None
    np.testing.assert_array_equal(both[1].mask, INSIDE)
