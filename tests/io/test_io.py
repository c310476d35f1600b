"""Reading: every format gives back its samples, the scale is right, and what is not data is masked."""

from __future__ import annotations

import logging
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError, ParameterError
from featreg.io import as_image, read_image
from featreg.io.masks import inside_polygons
from featreg.types import Image
from made.rasters import write_raster

rasterio = pytest.importorskip("rasterio")
# of the files these tests write; that the package itself is quiet is tested in test_bad_input.py
pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
GRAY = np.random.default_rng(0).integers(1, 250, (40, 60), dtype=np.uint8)


@pytest.mark.parametrize("dtype", ["uint8", "int16", "uint16", "int32", "float32", "float64", "uint64"])
def test_tiff_of_every_depth_keeps_its_range(tmp_path: Path, dtype: str) -> None:
    samples = GRAY.astype(dtype) * (1 if dtype == "uint8" else 100)
    image = as_image(write_raster(tmp_path / "a.tif", samples))
    assert image.pixels.dtype == np.float32
    np.testing.assert_array_equal(image.pixels, samples)
    assert (image.source_dtype, image.scale, image.name) == (dtype, "amplitude", str(tmp_path / "a.tif"))
    assert image.all_valid
    assert image.geolocation is None


@pytest.mark.parametrize("dtype", ["complex_int16", "complex64", "complex128"])
def test_complex_tiff(tmp_path: Path, dtype: str) -> None:
    samples = GRAY.astype(np.complex64) - 1j * GRAY[::-1]
    written = samples if dtype == "complex_int16" else samples.astype(dtype)
    image = as_image(write_raster(tmp_path / "a.tif", written, dtype=dtype))
    assert image.pixels.dtype == np.complex64
    np.testing.assert_array_equal(image.pixels, samples)
    np.testing.assert_allclose(image.amplitude, np.hypot(GRAY.astype(float), GRAY[::-1]), rtol=1e-6)
    assert (image.source_dtype, image.scale) == (dtype, "complex")


@pytest.mark.parametrize("suffix", ["png", "bmp", "tif", "PNG"])
def test_lossless_pictures(tmp_path: Path, suffix: str) -> None:
    import cv2

    path = str(tmp_path / f"a.{suffix}")
    cv2.imwrite(path, GRAY)
    image = as_image(path)
    np.testing.assert_array_equal(image.pixels, GRAY)
    assert image.source_dtype == "uint8"


def test_jpeg_and_16_bit_png(tmp_path: Path) -> None:
    import cv2

    smooth = np.add.outer(np.arange(64), np.arange(80)).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "a.jpg"), smooth)
    assert np.abs(as_image(tmp_path / "a.jpg").pixels - smooth).max() < 6
    wide = smooth.astype(np.uint16) * 300
    cv2.imwrite(str(tmp_path / "a.png"), wide)
    np.testing.assert_array_equal(as_image(tmp_path / "a.png").pixels, wide)


def test_three_equal_channels_are_gray_and_alpha_is_no_band(tmp_path: Path) -> None:
    import cv2

    cv2.imwrite(str(tmp_path / "rgb.png"), np.dstack([GRAY] * 3))
    np.testing.assert_array_equal(as_image(tmp_path / "rgb.png").pixels, GRAY)
    alpha = np.full_like(GRAY, 255)
    alpha[:5] = 0
    cv2.imwrite(str(tmp_path / "rgba.png"), np.dstack([GRAY, GRAY, GRAY, alpha]))
    image = as_image(tmp_path / "rgba.png")
    np.testing.assert_array_equal(image.mask, alpha > 0)
    assert not image.pixels[:5].any()


def test_npy_in_any_byte_order(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", GRAY.astype(">f4"))
    image = read_image(tmp_path / "a.npy")
    np.testing.assert_array_equal(image.pixels, GRAY)
    assert image.pixels.dtype == np.dtype("=f4")


def test_matlab_variables(tmp_path: Path) -> None:
    from scipy.io import savemat

    complex_samples = GRAY + 1j * GRAY[:, ::-1]
    savemat(tmp_path / "one.mat", {"slc": complex_samples, "looks": 3.0, "axis": np.arange(9.0), "title": "x"})
    np.testing.assert_array_equal(as_image(tmp_path / "one.mat").pixels, complex_samples.astype(np.complex64))
    savemat(tmp_path / "two.mat", {"a": GRAY.astype(float), "b": GRAY})
    image = as_image(f"{tmp_path / 'two.mat'}:a")
    np.testing.assert_array_equal(image.pixels, GRAY)
    assert image.source_dtype == "float64"
    with pytest.raises(InputError, match=r"2 bands, state which.*1 'a' \(float64\), 2 'b'"):
        as_image(tmp_path / "two.mat")
    with pytest.raises(InputError, match="no band 'c'"):
        as_image(f"{tmp_path / 'two.mat'}:c")
    with pytest.raises(InputError, match="no band 'title'"):
        as_image(f"{tmp_path / 'one.mat'}:title")


def test_a_plain_array_is_copied_and_zero_is_data() -> None:
    samples = np.random.default_rng(1).random((20, 30), dtype=np.float32)
    samples[0, 0] = 0
    image = as_image(samples)
    assert image.all_valid
    assert not np.shares_memory(image.pixels, samples)
    samples[1, 1] = 9
    assert image.pixels[1, 1] < 1
    assert samples.flags.writeable


def test_array_kinds() -> None:
    fortran = np.asfortranarray(GRAY.astype(np.float32))
    assert as_image(fortran).pixels.flags.c_contiguous
    np.testing.assert_array_equal(as_image(fortran[::-1, ::2]).pixels, GRAY[::-1, ::2])
    hidden = np.ma.MaskedArray(GRAY.astype(np.float32), mask=GRAY < 20)
    np.testing.assert_array_equal(as_image(hidden).mask, GRAY >= 20)
    frozen = GRAY.astype(np.float32)
    frozen.flags.writeable = False
    np.testing.assert_array_equal(as_image(frozen, nodata=GRAY[0, 0]).mask, GRAY[0, 0] != GRAY)
    np.testing.assert_array_equal(as_image(GRAY.astype(np.float16)).pixels, GRAY)


def test_what_is_not_finite_is_masked() -> None:
    samples = GRAY.astype(np.float64)
    samples[3, 4], samples[5, 6], samples[7, 8], samples[9, 9] = np.nan, np.inf, -np.inf, 1e300
    image = as_image(samples)
    assert np.argwhere(~image.mask).tolist() == [[3, 4], [5, 6], [7, 8], [9, 9]]
    assert not image.pixels[~image.mask].any()
    image = as_image(np.where(np.isfinite(samples), GRAY + 1j, complex(1, np.nan)))
    assert (~image.mask).sum() == 3


def test_stated_scales() -> None:
    amplitude = GRAY.astype(np.float64)
    for samples, scale in ((amplitude**2, "intensity"), (20 * np.log10(amplitude), "db"), (amplitude, "amplitude")):
        image = as_image(samples, scale=scale)
        np.testing.assert_allclose(image.pixels, amplitude, rtol=1e-5)
        assert image.scale == scale
    # numpy takes the root of 8 bits in half precision; it must not come through here
    np.testing.assert_allclose(as_image(GRAY, scale="intensity").pixels, np.sqrt(amplitude), rtol=1e-6)


def test_decibels_that_cannot_be_are_refused() -> None:
    linear = np.random.default_rng(3).gamma(4, 50, (40, 40)).astype(np.float32)
    with pytest.raises(InputError, match=r"scale 'db' cannot be: \d+ % of the samples lie outside -90 to 60 dB"):
        as_image(linear, scale="db")
    low = np.random.default_rng(3).normal(-12, 4, (40, 40)).astype(np.float32)
    low[:5] = -9999.0  # an undeclared fill is no reason
    assert as_image(low, scale="db").scale == "db"


def test_decibels_are_recognised_with_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    backscatter = np.random.default_rng(2).normal(-12, 6, (50, 50)).astype(np.float32)
    backscatter[0, 0] = -np.inf
    with caplog.at_level(logging.WARNING):
        image = as_image(backscatter)
    assert "decibels" in caplog.text
    assert image.scale == "db"
    assert not image.mask[0, 0]
    np.testing.assert_allclose(image.pixels[1:], 10 ** (backscatter[1:] / 20), rtol=1e-5)
    caplog.clear()
    assert as_image(np.round(backscatter[1:]).astype(np.int16)).scale == "db"
    as_image(backscatter, scale="db")
    assert caplog.text.count("decibels") == 1


def test_nodata_goes_before_the_scale() -> None:
    backscatter = np.random.default_rng(3).normal(-12, 6, (50, 50)).astype(np.float32)
    backscatter[:9] = -9999
    image = as_image(backscatter, nodata=-9999)
    assert image.scale == "db"
    np.testing.assert_array_equal(image.mask[:, 0], np.arange(50) >= 9)


@pytest.mark.parametrize("dtype", ["int16", "float32"])
def test_negative_samples_without_a_scale_are_an_error(dtype: str) -> None:
    samples = GRAY.astype(dtype) * 10
    samples[2, 3] = samples[4, 5] = -7
    with pytest.raises(InputError, match=r"2 samples are negative.*scale="):
        as_image(samples)


def test_negative_samples_of_a_stated_amplitude_are_masked(caplog: pytest.LogCaptureFixture) -> None:
    samples = GRAY.astype(np.float32)
    samples[2, 3] = -0.5
    with caplog.at_level(logging.WARNING):
        image = as_image(samples, scale="amplitude")
    assert np.argwhere(~image.mask).tolist() == [[2, 3]]
    assert "1 negative samples" in caplog.text


def test_scale_against_kind() -> None:
    with pytest.raises(InputError, match="complex samples"):
        as_image(GRAY + 1j, scale="db")
    with pytest.raises(InputError, match="real uint8 samples"):
        as_image(GRAY, scale="complex")
    with pytest.raises(ParameterError, match="did you mean 'intensity'"):
        as_image(GRAY, scale="intensty")


def test_file_nodata_counts_and_an_explicit_one_overrides(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.tif", GRAY, nodata=int(GRAY[0, 0]))
    np.testing.assert_array_equal(as_image(path).mask, GRAY[0, 0] != GRAY)
    other = GRAY[GRAY[0, 0] != GRAY][0]
    np.testing.assert_array_equal(as_image(path, nodata=other).mask, other != GRAY)
    single = GRAY.astype(np.float32) / 10
    path = write_raster(tmp_path / "b.tif", single, nodata=float(single[0, 0]))
    np.testing.assert_array_equal(as_image(path).mask, single != single[0, 0])


def test_nodata_that_cannot_occur_and_complex_nodata() -> None:
    assert as_image(GRAY, nodata=-9999).all_valid
    assert as_image(GRAY, nodata=0.5).all_valid
    single = GRAY.astype(np.float32)
    np.testing.assert_array_equal(as_image(single, nodata=complex(single[0, 0])).mask, single != single[0, 0])
    largest = np.iinfo(np.int64).max  # no double is this number
    long = GRAY.astype(np.int64)
    long[3, 4] = largest
    assert not as_image(long, nodata=largest).mask[3, 4]
    assert as_image(GRAY, nodata=np.nan).all_valid
    samples = GRAY + 1j * GRAY[::-1]
    samples[0, 0], samples[1, 1], samples[2, 2], samples[3, 3] = 0, -99, -99 - 99j, 5j
    assert np.argwhere(~as_image(samples, nodata=0).mask).tolist() == [[0, 0]]
    assert np.argwhere(~as_image(samples, nodata=-99).mask).tolist() == [[1, 1], [2, 2]]
    with pytest.raises(ParameterError, match="nodata must be one number"):
        as_image(GRAY, nodata="0")  # type: ignore[arg-type]


@pytest.mark.parametrize("dtype", [np.float32, np.uint8, np.complex64])
@pytest.mark.parametrize("nodata", [10**400, -(10**309)])
def test_a_nodata_value_beyond_all_floats_is_refused(dtype: Any, nodata: int) -> None:
    with pytest.raises(ParameterError, match="that float64 can hold"):
        as_image(np.arange(400).reshape(20, 20).astype(dtype), nodata=nodata)


def test_mask_band_of_a_file_stays_with_an_explicit_nodata(tmp_path: Path) -> None:
    inside = np.full(GRAY.shape, 255, np.uint8)
    inside[:7] = 0
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True),
        rasterio.open(tmp_path / "a.tif", "w", driver="GTiff", height=40, width=60, count=1, dtype="uint8") as dataset,
    ):
        dataset.write(GRAY, 1)
        dataset.write_mask(inside)
    np.testing.assert_array_equal(as_image(tmp_path / "a.tif").mask, inside > 0)
    image = as_image(tmp_path / "a.tif", nodata=GRAY[20, 20])
    np.testing.assert_array_equal(image.mask, (inside > 0) & (GRAY[20, 20] != GRAY))


def test_scale_and_offset_of_a_file_are_applied(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.tif", GRAY)
    with rasterio.open(path, "r+") as dataset:
        dataset.scales, dataset.offsets = (0.5,), (3.0,)
    np.testing.assert_array_equal(as_image(path).pixels, GRAY * 0.5 + 3)


def test_masks_from_arrays_and_files(tmp_path: Path) -> None:
    keep = GRAY > 100
    np.testing.assert_array_equal(as_image(GRAY, mask=keep).mask, keep)
    np.testing.assert_array_equal(as_image(GRAY, mask=keep * 7.0).mask, keep)
    np.testing.assert_array_equal(as_image(GRAY, mask=np.where(keep, 1.0, np.nan)).mask, keep)
    path = write_raster(tmp_path / "mask.png", keep * np.uint8(255), driver="PNG")
    np.testing.assert_array_equal(as_image(GRAY, mask=path).mask, keep)
    np.save(tmp_path / "mask.npy", keep)
    image = as_image(GRAY, mask=str(tmp_path / "mask.npy"), nodata=GRAY[keep][0])
    np.testing.assert_array_equal(image.mask, keep & (GRAY[keep][0] != GRAY))
    with pytest.raises(InputError, match=r"mask.npy of array: is 60 x 40 pixels .*the image is 59 x 40"):
        as_image(GRAY[:, :-1], mask=tmp_path / "mask.npy")


def test_masks_from_polygons() -> None:
    square = np.array([[9.5, 4.5], [19.5, 4.5], [19.5, 14.5], [9.5, 14.5]])
    wanted = np.zeros(GRAY.shape, bool)
    wanted[5:15, 10:20] = True
    for mask in (square, square.tolist(), [square], [square, square], square[::-1]):
        np.testing.assert_array_equal(as_image(GRAY, mask=mask).mask, wanted)
    other = as_image(GRAY, mask=[square, square + np.array([20, 5])])
    assert other.mask.sum() == 200
    with pytest.raises(InputError, match=r"polygon of shape \(2, 2\)"):
        as_image(GRAY, mask=square[:2])
    with pytest.raises(InputError, match="a mask is an"):
        as_image(GRAY, mask=3)  # type: ignore[arg-type]


def test_polygons_against_a_circle_and_shared_edges() -> None:
    angle = np.linspace(0, 2 * np.pi, 721)[:-1]
    circle = np.column_stack([30.2 + 15 * np.cos(angle), 3.3 + 15 * np.sin(angle)])  # leaves the image at the top
    y, x = np.mgrid[:40, :60]
    distance = np.hypot(x - 30.2, y - 3.3)
    inside = inside_polygons([circle], (40, 60))
    assert inside[distance < 14.99].all()
    assert not inside[distance > 15].any()
    left, right = np.array([[0, 0], [30, 0], [20, 40], [0, 40]]), np.array([[30, 0], [60, 0], [60, 40], [20, 40]])
    halves = [inside_polygons([p.astype(float)], (40, 60)) for p in (left, right)]
    assert (halves[0] ^ halves[1]).all()


def test_what_an_image_hides_where_it_has_no_data_is_taken_out() -> None:
    pixels = np.random.default_rng(1).gamma(4, 0.25, (30, 40)).astype(np.float32)
    mask = np.ones(pixels.shape, np.bool_)
    mask[5:9, 3:20] = False
    for hidden in (77.0, np.nan):
        made = as_image(Image(np.where(mask, pixels, np.float32(hidden)).astype(np.float32), mask))
        np.testing.assert_array_equal(made.pixels, np.where(mask, pixels, np.float32(0)))
        np.testing.assert_array_equal(made.mask, mask)
    assert as_image(made) is made


def test_an_image_passes_through_and_can_be_restricted() -> None:
    image = as_image(GRAY, nodata=GRAY[0, 0])
    assert as_image(image) is image
    assert as_image(image, scale="amplitude") is image
    keep = GRAY > 100
    restricted = as_image(image, mask=keep, nodata=GRAY[keep][0])
    np.testing.assert_array_equal(restricted.mask, keep & (GRAY[0, 0] != GRAY) & (GRAY[keep][0] != GRAY))
    assert not restricted.pixels[~restricted.mask].any()
    assert restricted.source_dtype == "uint8"
    np.testing.assert_array_equal(image.mask, GRAY[0, 0] != GRAY)
    with pytest.raises(InputError, match="already made as 'amplitude'"):
        as_image(image, scale="intensity")
    with pytest.raises(InputError, match="no valid pixel"):
        as_image(image, mask=np.zeros(GRAY.shape))


def test_images_are_locked_and_io_is_imported_light(tmp_path: Path) -> None:
    image = as_image(GRAY)
    assert isinstance(image, Image)
    assert not image.pixels.flags.writeable
    code = "import sys, featreg.io, featreg.products.resample\n"
    code += "print(*{'rasterio', 'scipy', 'cv2', 'numba'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.tif"])
def test_a_colour_image_is_read_as_its_luminance(tmp_path: Path, name: str) -> None:
    import cv2

    rng = np.random.default_rng(3)
    bgr = cv2.resize(rng.integers(0, 256, (8, 8, 3)).astype(np.uint8), (64, 64))
    cv2.imwrite(str(tmp_path / name), bgr, [cv2.IMWRITE_JPEG_QUALITY, 100])
    wanted = np.array([0.114, 0.587, 0.299]) @ bgr.reshape(-1, 3).T
    image = as_image(tmp_path / name)
    assert image.source_dtype == "uint8"
    np.testing.assert_allclose(image.pixels.ravel(), wanted, atol=2.0 if name == "a.jpg" else 0.5)
