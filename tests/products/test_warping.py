"""Products from file to file: the same pixels as in memory, the user's own values."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio

import featreg
from featreg.errors import InputError
from featreg.geometry import Affine
from featreg.io import as_image, write_geotiff
from featreg.products.files import WINDOW
from featreg.products.resample import resample
from featreg.products.warping import Product, warp_file
from featreg.types import Geolocation
from made.rasters import write_raster
from made.warped_files import MOVE, PLACE, SHAPE, files, read, registration, texture

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


@pytest.mark.parametrize("resampling", ["nearest", "bilinear", "cubic", "lanczos"])
def test_the_file_holds_what_warp_returns(tmp_path: Path, resampling: str) -> None:
    shape = (WINDOW + 70, 200)
    files(tmp_path, texture(*shape))
    reg = registration(tmp_path, size=shape)
    made = warp_file(reg, tmp_path / "sec.tif", tmp_path / "out.tif", resampling=resampling)
    assert isinstance(made, Product)
    assert (made.shape, made.dtype, made.bands, made.georeferenced) == (shape, "float32", (1,), True)
    whole = featreg.warp(reg, tmp_path / "sec.tif", resampling=resampling)
    written = read(tmp_path / "out.tif")[0][0]
    # Positions in a window are counted from its own origin: the same but for rounding, which half a pixel feels.
    same = np.isclose(written, whole, rtol=2e-5, equal_nan=True)
    assert same.all() if resampling != "nearest" else same.mean() > 0.999
    assert made.valid == pytest.approx(np.isfinite(whole).mean())


def test_it_is_a_cloud_optimised_geotiff_in_the_references_place(tmp_path: Path) -> None:
    files(tmp_path, texture(1200, 1100).astype(np.uint16), nodata=0)
    made = warp_file(registration(tmp_path, size=(1200, 1100)), tmp_path / "sec.tif", tmp_path / "out.tif")
    written, profile = read(tmp_path / "out.tif")
    assert profile["image"]["LAYOUT"] == "COG"
    assert profile["tiled"]
    assert profile["crs"].to_epsg() == 32632
    assert tuple(profile["transform"])[:6] == PLACE.transform
    assert (made.dtype, profile["dtype"], profile["nodata"], made.nodata) == ("uint16", "uint16", 0, 0)
    assert profile["tags"]["FEATREG_STATUS"] == "ok"
    with rasterio.open(tmp_path / "out.tif") as dataset:
        assert dataset.overviews(1) == [2, 4]
    valid = resample(as_image(tmp_path / "sec.tif"), MOVE, (1200, 1100)).mask
    np.testing.assert_array_equal(written[0] != 0, valid)
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize(
    "place",
    [
        Geolocation(gcps=np.array([[0, 0, 10, 50, 5], [339, 0, 11, 50, 5], [0, 299, 10, 49, 5.0]]), crs="EPSG:4326"),
        Geolocation(
            rpcs={
                "line_off": 1.0, "samp_off": 2.0, "line_scale": 3.0, "samp_scale": 4.0, "lat_off": 5.0,
                "lat_scale": 1.0, "long_off": 7.0, "long_scale": 1.0, "height_off": 9.0, "height_scale": 1.0,
                "line_num_coeff": [0.0, 0, 1] + [0.0] * 17, "line_den_coeff": [1.0] + [0.0] * 19,
                "samp_num_coeff": [0.0, 1] + [0.0] * 18, "samp_den_coeff": [1.0] + [0.0] * 19,
                "err_bias": 1.0, "err_rand": 1.0,
            }
        ),
    ],
    ids=["gcps", "rpcs"],
)  # fmt: skip
def test_rpcs_and_gcps_of_the_reference_go_along(tmp_path: Path, place: Geolocation) -> None:
    files(tmp_path, texture(*SHAPE), place=place)
    warp_file(registration(tmp_path), tmp_path / "sec.tif", tmp_path / "out.tif")
    found = as_image(tmp_path / "out.tif").geolocation
    assert found is not None
    if place.gcps is not None:
        assert found.gcps is not None
        np.testing.assert_allclose(found.gcps, place.gcps)
    else:
        assert found.rpcs is not None
        assert found.rpcs["samp_off"] == 2.0
        assert list(found.rpcs["samp_num_coeff"])[:3] == [0, 1, 0]


@pytest.mark.parametrize(
    ("dtype", "nodata", "expected"),
    [
        ("uint8", None, ("uint8", 0)), ("uint16", 7, ("uint16", 7)), ("int16", None, ("int16", -32768)),
        ("int32", 0, ("int32", 0)), ("float32", -99, ("float32", -99)), ("float64", None, ("float32", None)),
        ("uint64", None, ("float32", None)), ("float64", -1.7976931348623157e308, ("float32", None)),
    ],
)  # fmt: skip
def test_samples_keep_dtype_and_nodata(
    tmp_path: Path, dtype: str, nodata: float | None, expected: tuple[str, float | None]
) -> None:
    samples = np.clip(texture(*SHAPE) - 90, 8, 250).astype(dtype)
    files(tmp_path, samples, nodata=nodata)
    made = warp_file(registration(tmp_path, Affine(np.eye(3)[:2])), tmp_path / "sec.tif", tmp_path / "out.tif")
    written, profile = read(tmp_path / "out.tif")
    assert profile["dtype"] == made.dtype == expected[0]
    np.testing.assert_array_equal(written[0], samples.astype(expected[0]))
    assert np.isnan(profile["nodata"]) if expected[1] is None else profile["nodata"] == expected[1]


def test_a_valid_sample_never_becomes_nodata(tmp_path: Path) -> None:
    samples = np.full(SHAPE, 40, np.uint8)
    samples[100:200, 100:200] = 0  # data: the file names no value for none
    samples[150, 150] = 255
    files(tmp_path, samples)
    made = warp_file(registration(tmp_path), tmp_path / "sec.tif", tmp_path / "out.tif")
    valid = resample(as_image(tmp_path / "sec.tif"), MOVE, SHAPE).mask
    np.testing.assert_array_equal(read(tmp_path / "out.tif")[0][0] != made.nodata, valid)


@pytest.mark.parametrize("scale", ["intensity", "db"])
def test_intensity_and_decibels_come_back_as_they_were(tmp_path: Path, scale: str) -> None:
    amplitude = texture(*SHAPE)
    samples = amplitude**2 if scale == "intensity" else 20 * np.log10(amplitude) - 70
    files(tmp_path, samples.astype(np.float32))
    warp_file(registration(tmp_path, scale=scale), tmp_path / "sec.tif", tmp_path / "out.tif", resampling="cubic")
    written = read(tmp_path / "out.tif")[0][0]
    image = resample(as_image(tmp_path / "sec.tif", scale=scale), MOVE, SHAPE, resampling="cubic")
    wanted = image.pixels**2 if scale == "intensity" else 20 * np.log10(np.where(image.mask, image.pixels, 1))
    np.testing.assert_allclose(written[image.mask], wanted[image.mask], rtol=1e-4)
    assert np.isnan(written[~image.mask]).all()


def test_the_files_own_scale_and_offset_stay(tmp_path: Path) -> None:
    raw = texture(*SHAPE).astype(np.uint16)
    write_geotiff(tmp_path / "ref.tif", raw)
    path = write_raster(tmp_path / "sec.tif", raw[None], nodata=0)
    with rasterio.open(path, "r+") as dataset:
        dataset.scales, dataset.offsets = [0.5], [3.0]
    warp_file(registration(tmp_path, Affine(np.eye(3)[:2])), path, tmp_path / "out.tif")
    with rasterio.open(tmp_path / "out.tif") as dataset:
        assert (dataset.scales, dataset.offsets) == ((0.5,), (3.0,))
        np.testing.assert_array_equal(dataset.read(1), raw)


def test_bands(tmp_path: Path) -> None:
    bands = np.stack([texture(*SHAPE, seed=k) for k in (0, 1, 2)]).astype(np.uint16)
    write_geotiff(tmp_path / "ref.tif", texture(*SHAPE))
    path = write_raster(tmp_path / "sec.tif", bands, nodata=0)
    made = warp_file(registration(tmp_path), path, tmp_path / "all.tif")
    assert made.bands == (1, 2, 3)
    every = read(tmp_path / "all.tif")[0]
    assert every.shape == (3, *SHAPE)
    for number in (1, 3):
        assert warp_file(registration(tmp_path), path, tmp_path / "one.tif", band=number).bands == (number,)
        np.testing.assert_array_equal(read(tmp_path / "one.tif")[0][0], every[number - 1])
    with pytest.raises(InputError, match="has 3 bands, band 4 was asked for"):
        warp_file(registration(tmp_path), path, tmp_path / "one.tif", band=4)
