"""Arrays and masks of every library are understood, and what linear samples and decibels look like."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg.errors import InputError
from featreg.io.masks import as_mask
from featreg.io.raster_source import RasterSource, Window, open_source

SHAPE = (40, 50)
HOLE = np.s_[10:20, 5:30]


def speckle(seed: int = 0) -> NDArray[np.float32]:
    return np.random.default_rng(seed).rayleigh(1, SHAPE).astype(np.float32)


def shown() -> NDArray[np.bool_]:
    good = np.ones(SHAPE, np.bool_)
    good[HOLE] = False
    return good


def masked() -> np.ma.MaskedArray[Any, Any]:
    return np.ma.masked_array(np.ones(SHAPE, np.uint8), mask=~shown())


class DataArray:
    """What of xarray's class is looked at: its dimensions, and data that may be another library's."""

    def __init__(self, data: Any) -> None:
        self.dims, self.data = ("y", "x"), data

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.asarray(self.data, dtype)


class Picture:
    """What of Pillow's class is looked at: an array interface, and a size that is a pair."""

    def __init__(self, array: NDArray[Any]) -> None:
        self._array, self.size = array, array.shape[::-1]

    @property
    def __array_interface__(self) -> dict[str, Any]:
        return self._array.__array_interface__


def dask_blocks(array: Any) -> Any:
    return pytest.importorskip("dask.array").from_array(array, chunks=(20, 25), asarray=False)


def frame(array: Any, kind: str | None = None) -> Any:
    pandas = pytest.importorskip("pandas")
    return pandas.DataFrame(array) if kind is None else pandas.DataFrame(array).astype(kind)


def with_missing() -> Any:
    """A nullable frame of True, where masked missing."""
    return frame(np.ones(SHAPE, bool), "boolean").where(shown())


@pytest.mark.parametrize(
    "make",
    [
        masked,
        lambda: np.ma.masked_array(shown(), mask=False),
        lambda: DataArray(shown()),
        lambda: DataArray(masked()),
        lambda: DataArray(dask_blocks(masked())),
        lambda: dask_blocks(shown()),
        lambda: dask_blocks(masked()),
        lambda: frame(shown()),
        lambda: frame(shown().astype(float)),
        lambda: frame(shown(), "boolean"),
        with_missing,
        lambda: Picture(shown().astype(np.uint8) * 255),
    ],
)
def test_a_mask_of_any_array_type(make: Any) -> None:
    np.testing.assert_array_equal(as_mask(make(), SHAPE, "test"), shown())
    np.testing.assert_array_equal(featreg.as_image(speckle(), mask=make()).mask, shown())


def test_a_mask_of_any_array_type_of_a_scene(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", speckle())
    masks: list[Any] = [masked(), DataArray(masked()), Picture(shown().astype(np.uint8))]
    for mask in masks:
        source: Any = open_source(tmp_path / "a.npy", mask=mask)
        np.testing.assert_array_equal(source.read(Window(0, 0, 50, 40)).mask, shown())


@pytest.mark.parametrize(
    "make",
    [
        lambda a: np.ma.masked_array(a, mask=~shown()),
        lambda a: DataArray(np.ma.masked_array(a, mask=~shown())),
        lambda a: dask_blocks(np.ma.masked_array(a, mask=~shown())),
        lambda a: frame(np.where(shown(), a, np.nan)),
    ],
)
def test_an_image_of_any_array_type(make: Any) -> None:
    image = featreg.as_image(make(speckle()))
    np.testing.assert_array_equal(image.mask, shown())
    np.testing.assert_array_equal(image.pixels[shown()], speckle()[shown()])


def test_a_picture_of_pillow() -> None:
    grey = np.random.default_rng(0).integers(0, 255, SHAPE).astype(np.uint8)
    np.testing.assert_array_equal(featreg.as_image(Picture(grey)).pixels, grey)  # type: ignore[arg-type]
    picture = pytest.importorskip("PIL.Image").fromarray(grey)
    np.testing.assert_array_equal(featreg.as_image(picture).pixels, grey)
    assert featreg.match(picture, picture).reason  # opened, and too small for a match


def test_opencv_manners_take_a_masked_array_as_mask() -> None:
    grey = np.random.default_rng(0).integers(0, 255, (120, 120)).astype(np.uint8)
    hidden = np.zeros(grey.shape, bool)
    hidden[:, :60] = True
    found = featreg.create("detector", "orb").detect(grey, np.ma.masked_array(np.ones_like(grey), mask=hidden))
    assert found
    assert min(point.pt[0] for point in found) >= 60


def test_alpha_beside_a_nodata_value(tmp_path: Path) -> None:
    import rasterio
    from rasterio.enums import ColorInterp

    samples = np.random.default_rng(0).integers(2, 200, SHAPE).astype(np.uint8)
    samples[:5] = 1
    path = tmp_path / "a.tif"
    profile: Any = {"driver": "GTiff", "width": 50, "height": 40, "count": 2, "dtype": "uint8", "nodata": 1}
    with rasterio.open(path, "w", **profile) as file:
        file.colorinterp = [ColorInterp.gray, ColorInterp.alpha]
        file.write(samples, 1)
        file.write(np.where(shown(), 255, 0).astype(np.uint8), 2)
    wanted = shown() & (samples != 1)
    np.testing.assert_array_equal(featreg.as_image(path).mask, wanted)
    np.testing.assert_array_equal(RasterSource(str(path)).read(Window(0, 0, 50, 40)).mask, wanted)


def sigma0(share: float, looks: float = 1.0, dark: float = 0.3) -> NDArray[np.float32]:
    """Calibrated intensity, `dark` of it a sea at the noise, less the noise; `share` of all negative."""
    rng = np.random.default_rng(1)
    ground = np.where(np.arange(100) < 100 * dark, 0.004, 0.08) * rng.lognormal(0, 0.5, (80, 100))
    power = ground * rng.gamma(looks, 1 / looks, ground.shape)
    return (power - np.quantile(power, share)).astype(np.float32)


@pytest.mark.parametrize("share", [0.002, 0.05, 0.2])
@pytest.mark.parametrize("looks", [1.0, 4.0])
@pytest.mark.parametrize("gain", [1.0, 30.0])
def test_small_negatives_of_linear_samples_are_noise_removal(
    share: float, looks: float, gain: float, caplog: pytest.LogCaptureFixture
) -> None:
    samples = gain * sigma0(share, looks)
    with caplog.at_level(logging.WARNING):
        image = featreg.as_image(samples)
    assert image.scale == "intensity"
    assert "noise removed" in caplog.text
    # What was left below zero is data of very dark ground.
    assert image.mask.all()
    np.testing.assert_allclose(image.pixels, np.sqrt(np.maximum(samples, 0)), rtol=1e-6)


@pytest.mark.parametrize("looks", [1.0, 4.0, 20.0])
@pytest.mark.parametrize("offset", [-15.0, -3.0, 5.0, 12.0])
@pytest.mark.parametrize("dark", [0.0, 0.3, 0.8])
def test_decibels_stay_decibels(looks: float, offset: float, dark: float) -> None:
    rng = np.random.default_rng(2)
    ground = np.where(np.arange(100) < 100 * dark, 0.05, 1.0) * rng.lognormal(0, 0.3, (80, 100))
    decibels = 10 * np.log10(ground * rng.gamma(looks, 1 / looks, ground.shape)) + offset
    if (decibels < 0).mean() < 0.01:
        pytest.skip("too few negative samples to tell")
    assert featreg.as_image(decibels.astype(np.float32)).scale == "db"


@pytest.mark.parametrize(
    ("name", "unit", "scale"),
    [
        ("Sigma0_VV_db", "", "db"),
        ("band", "dB", "db"),
        ("Intensity_VH", "", "intensity"),
        ("Gamma0_VV", "", "intensity"),
    ],
)
def test_the_words_of_the_file_decide(tmp_path: Path, name: str, unit: str, scale: str) -> None:
    import rasterio

    samples = np.random.default_rng(0).normal(3, 2, SHAPE).astype(np.float32)
    path = tmp_path / "a.tif"
    with rasterio.open(path, "w", driver="GTiff", width=50, height=40, count=1, dtype="float32") as file:
        file.write(samples, 1)
        file.set_band_description(1, name)
        file.units = (unit,)
    assert featreg.as_image(path).scale == RasterSource(str(path)).known_scale == scale


def test_an_undeclared_negative_fill_is_named() -> None:
    samples = sigma0(0.0) + 0.001
    samples[:20] = -9999
    with pytest.raises(InputError, match="nodata="):
        featreg.as_image(samples)
