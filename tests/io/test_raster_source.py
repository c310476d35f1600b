"""Windows of scenes: the pixels are those of the whole image, wherever the window lies and whoever reads it."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError, ParameterError
from featreg.io import as_image
from featreg.io.images import small_image
from featreg.io.raster_source import ImageSource, RasterSource, Window, open_source
from made.rasters import write_raster
from made.scene_files import SHAPE, WINDOWS, amplitude

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


def plain(folder: Path) -> tuple[Path, dict[str, Any]]:
    return write_raster(folder / "plain.tif", amplitude()), {}


def with_nodata(folder: Path) -> tuple[Path, dict[str, Any]]:
    array = amplitude().astype(np.uint16)
    array[40:90, 60:120] = 0
    return write_raster(folder / "nodata.tif", array, nodata=0, tiled=True, blockxsize=64, blockysize=64), {}


def decibels(folder: Path) -> tuple[Path, dict[str, Any]]:
    return write_raster(folder / "db.tif", (20 * np.log10(amplitude() / 60)).astype(np.float32)), {}


def stated_intensity(folder: Path) -> tuple[Path, dict[str, Any]]:
    return write_raster(folder / "intensity.tif", amplitude()), {"scale": "intensity"}


def complex_samples(folder: Path) -> tuple[Path, dict[str, Any]]:
    phase = np.random.default_rng(1).uniform(-3, 3, SHAPE)
    return write_raster(folder / "complex.tif", (amplitude() * np.exp(1j * phase)).astype(np.complex64)), {}


def numpy_file(folder: Path) -> tuple[Path, dict[str, Any]]:
    array = amplitude()
    array[10:30, 10:30] = np.nan
    np.save(folder / "a.npy", array)
    return folder / "a.npy", {}


def palette(folder: Path) -> tuple[Path, dict[str, Any]]:
    import cv2

    cv2.imwrite(str(folder / "gray.bmp"), np.clip(amplitude(), 0, 255).astype(np.uint8))
    return folder / "gray.bmp", {}


def polygon(folder: Path) -> tuple[Path, dict[str, Any]]:
    return plain(folder)[0], {"mask": [[(10.2, 12.0), (140.0, 20.5), (90.0, 130.0)]]}


def mask_file(folder: Path) -> tuple[Path, dict[str, Any]]:
    mask = (np.random.default_rng(2).random(SHAPE) > 0.3).astype(np.uint8)
    return plain(folder)[0], {"mask": str(write_raster(folder / "mask.tif", mask))}


def mask_of_floats(folder: Path) -> tuple[Path, dict[str, Any]]:
    mask = np.ones(SHAPE, np.float32)
    mask[:9], mask[9:20], mask[20:30] = np.nan, np.inf, 0
    np.save(folder / "mask.npy", mask)
    return plain(folder)[0], {"mask": str(folder / "mask.npy")}


Maker = Callable[[Path], tuple[Path, dict[str, Any]]]
MAKERS: list[Maker] = [
    plain, with_nodata, decibels, stated_intensity, complex_samples, numpy_file, palette, polygon, mask_file,
    mask_of_floats,
]  # fmt: skip


@pytest.mark.parametrize("make", MAKERS)
def test_a_window_holds_the_pixels_of_the_whole_image(make: Maker, tmp_path: Path) -> None:
    path, keywords = make(tmp_path)
    whole = as_image(path, **keywords)
    source = open_source(path, **keywords)
    assert source.shape == whole.shape
    assert source.is_complex == whole.is_complex
    assert source.known_scale == whole.scale
    for window in WINDOWS:
        got = source.read(window)
        assert got.shape == window.shape
        part = window.within(whole.shape)
        assert part is not None
        inside = np.zeros(window.shape, np.bool_)
        rows = slice(part.y - window.y, part.y - window.y + part.height)
        cols = slice(part.x - window.x, part.x - window.x + part.width)
        inside[rows, cols] = True
        assert not got.mask[~inside].any()
        assert not got.pixels[~got.mask].any()
        there = slice(part.y, part.y + part.height), slice(part.x, part.x + part.width)
        assert np.array_equal(got.mask[rows, cols], whole.mask[there])
        assert np.array_equal(got.pixels[rows, cols], whole.pixels[there])


def test_a_name_stands_for_the_file_of_the_working_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for value in (1, 2):
        folder = tmp_path / str(value)
        folder.mkdir()
        np.save(folder / "a.npy", value * (1 + np.arange(400.0).reshape(20, 20)))
        os.utime(folder / "a.npy", (1e9, 1e9))
        monkeypatch.chdir(folder)
        assert open_source("a.npy").read(Window(0, 0, 20, 20)).pixels[0, 0] == value


def test_a_window_outside_the_scene_is_all_masked(tmp_path: Path) -> None:
    got = open_source(plain(tmp_path)[0]).read(Window(1000, 1000, 20, 30))
    assert got.shape == (30, 20)
    assert not got.mask.any()


def test_an_empty_or_constant_window_is_no_error(tmp_path: Path) -> None:
    source = open_source(with_nodata(tmp_path)[0])
    assert not source.read(Window(70, 50, 20, 20)).mask.any()


@pytest.mark.parametrize("make", [plain, numpy_file])
def test_threads_and_pickles_read_the_same(make: Maker, tmp_path: Path) -> None:
    source = open_source(make(tmp_path)[0])
    wanted = [source.read(window).pixels for window in WINDOWS]
    other = pickle.loads(pickle.dumps(source))
    with ThreadPoolExecutor(4) as pool:
        for _ in range(5):
            for got, want in zip(pool.map(other.read, WINDOWS), wanted, strict=True):
                assert np.array_equal(got.pixels, want)


def test_an_image_in_memory_has_the_same_manners(tmp_path: Path) -> None:
    array = amplitude()
    array[:20] = np.nan
    source = open_source(array)
    assert isinstance(source, ImageSource)
    spooled = source.shareable(lambda: tmp_path, "scene")
    for window in WINDOWS:
        a, b = source.read(window), spooled.read(window)
        assert np.array_equal(a.pixels, b.pixels)
        assert np.array_equal(a.mask, b.mask)
    assert source.identity() == open_source(array.copy()).identity()
    array[100, 100] += 1
    assert source.identity() != open_source(array).identity()


def test_an_overview_averages_intensity_over_valid_pixels(tmp_path: Path) -> None:
    array = np.full((64, 96), 3.0, np.float32)
    array[::2] = 5.0
    array[:16, :16] = np.nan
    np.save(tmp_path / "a.npy", array)
    overview = open_source(tmp_path / "a.npy").overview(4)
    assert overview.shape == (16, 24)
    assert not overview.mask[:4, :4].any()
    assert overview.mask.sum() == 16 * 24 - 16
    np.testing.assert_allclose(overview.pixels[overview.mask], np.sqrt((9 + 25) / 2), rtol=1e-6)


@pytest.mark.parametrize("hole", [False, True])
@pytest.mark.parametrize("factor", [1, 3, 4, 7])
def test_an_overview_is_the_root_of_the_mean_square(factor: int, hole: bool) -> None:
    array = amplitude()
    array[40:90, 60:120] = np.nan if hole else 1.0
    image = as_image(array)
    rows, cols = (n // factor for n in SHAPE)
    cut = (slice(0, rows * factor), slice(0, cols * factor))
    square, good = (
        part[cut].reshape(rows, factor, cols, factor).sum(axis=(1, 3))
        for part in (np.where(image.mask, image.pixels, 0).astype(np.float64) ** 2, image.mask)
    )
    enough = good > factor**2 / 2
    overview = ImageSource(image).overview(factor)
    np.testing.assert_array_equal(overview.mask, enough)
    wanted = np.sqrt(np.where(enough, square / np.maximum(good, 1), 0))
    np.testing.assert_allclose(overview.pixels, wanted, rtol=2e-6)


def test_neighbouring_windows_share_no_point_and_lose_none() -> None:
    xy = np.random.default_rng(3).uniform(-0.5, 39.5, (500, 2))
    xy[:4] = [[19.5, 5], [19.499999, 5], [5, 19.5], [-0.5, -0.5]]
    parts = [Window(x, y, 20, 20) for y in (0, 20) for x in (0, 20)]
    assert (np.sum([window.holds(xy) for window in parts], axis=0) == 1).all()


def test_another_band_can_be_chosen(tmp_path: Path) -> None:
    import rasterio

    from featreg.io.gdal_errors import quiet

    bands = np.stack([amplitude(0), amplitude(1)])
    size = {"height": SHAPE[0], "width": SHAPE[1], "count": 2, "dtype": "float32"}
    with quiet(), rasterio.open(tmp_path / "two.tif", "w", driver="GTiff", **size) as dataset:
        dataset.write(bands)
    got = RasterSource(str(tmp_path / "two.tif"), band=2).read(Window(0, 0, 170, 150))
    assert np.array_equal(got.pixels, bands[1])
    with pytest.raises(InputError, match="2 bands"):
        open_source(tmp_path / "two.tif")
    with pytest.raises(InputError, match="band 3"):
        _ = RasterSource(str(tmp_path / "two.tif"), band=3).shape


@pytest.mark.parametrize(
    ("name", "content", "text"),
    [
        ("missing.tif", None, "no such file"),
        ("empty.tif", b"", "is empty"),
        ("wrong.tif", b"not a tiff at all", "not TIFF"),
        ("broken.tif", b"II*\0" + bytes(200), "broken"),
        ("wrong.npy", b"not an array", "not NPY"),
        ("notes.txt", b"words", "not a known image format"),
    ],
)
def test_files_that_cannot_be_used_say_why(name: str, content: bytes | None, text: str, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=text):
        open_source(tmp_path / name)
    with pytest.raises(InputError, match=text):
        small_image(tmp_path / name, 10)


def test_a_truncated_scene_is_named_when_the_missing_part_is_read(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.tif", amplitude())
    path.write_bytes(path.read_bytes()[:40_000])
    with pytest.raises(InputError, match=r"a\.tif: the"):
        RasterSource(str(path)).read(Window(0, 100, 50, 50))


def test_misuse_says_what_would_be_right(tmp_path: Path) -> None:
    path = plain(tmp_path)[0]
    with pytest.raises(ParameterError, match="width and height"):
        Window(0, 0, 0, 5)
    with pytest.raises(ParameterError, match="factor"):
        open_source(path).overview(0)
    with pytest.raises(ParameterError, match="unknown scale"):
        open_source(path, scale="decibel")
    other = write_raster(tmp_path / "small.tif", np.ones((20, 20), np.uint8))
    with pytest.raises(InputError, match="the scene is 170 x 150"):
        open_source(path, mask=str(other))
    with pytest.raises(InputError, match="complex"):
        open_source(complex_samples(tmp_path)[0], scale="db")


def test_only_images_that_are_small_enough_are_read_whole(tmp_path: Path) -> None:
    for source in (plain(tmp_path)[0], numpy_file(tmp_path)[0], amplitude(), as_image(amplitude())):
        assert small_image(source, 150 * 170 - 1) is None
        found = small_image(source, 150 * 170)
        assert found is not None
        np.testing.assert_array_equal(found.pixels, as_image(source).pixels)
