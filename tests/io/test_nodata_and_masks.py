"""What is not data: values, mask bands, arrays, files and polygons."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

from featreg.errors import InputError, ParameterError
from featreg.io import as_image
from featreg.io.masks import inside_polygons
from featreg.types import Image
from made.rasters import write_raster

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
GRAY = np.random.default_rng(0).integers(1, 250, (40, 60), dtype=np.uint8)


def test_what_is_not_finite_is_masked() -> None:
    samples = GRAY.astype(np.float64)
    samples[3, 4], samples[5, 6], samples[7, 8], samples[9, 9] = np.nan, np.inf, -np.inf, 1e300
    image = as_image(samples)
    assert np.argwhere(~image.mask).tolist() == [[3, 4], [5, 6], [7, 8], [9, 9]]
    assert not image.pixels[~image.mask].any()
    image = as_image(np.where(np.isfinite(samples), GRAY + 1j, complex(1, np.nan)))
    assert (~image.mask).sum() == 3


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
