"""Reading: every format gives back its samples."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio

from featreg.errors import InputError
from featreg.io import as_image, read_image
from featreg.types import Image
from made.rasters import write_raster

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


def test_scale_and_offset_of_a_file_are_applied(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.tif", GRAY)
    with rasterio.open(path, "r+") as dataset:
        dataset.scales, dataset.offsets = (0.5,), (3.0,)
    np.testing.assert_array_equal(as_image(path).pixels, GRAY * 0.5 + 3)


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
