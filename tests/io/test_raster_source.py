"""Windows of scenes: the pixels are those of the whole image, wherever the window lies and whoever reads it."""

from __future__ import annotations

import itertools
import os
import pickle
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.errors import InputError, ParameterError
from featreg.io import as_image, raster_files
from featreg.io.images import small_image
from featreg.io.raster_source import ImageSource, RasterSource, Window, open_source
from made.rasters import write_raster

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
SHAPE = (150, 170)
WINDOWS = [Window(0, 0, 170, 150), Window(20, 30, 50, 40), Window(-7, 100, 60, 80), Window(150, -9, 40, 30)]


def amplitude(seed: int = 0) -> NDArray[np.float32]:
    return np.random.default_rng(seed).gamma(2.0, 50.0, SHAPE).astype(np.float32)


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


def test_a_changed_file_is_read_anew(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.tif", amplitude(0))
    source = RasterSource(str(path))
    first, before = source.read(WINDOWS[1]).pixels, source.identity()
    write_raster(tmp_path / "b.tif", amplitude(5)).replace(path)
    assert not np.array_equal(source.read(WINDOWS[1]).pixels, first)
    assert source.identity() != before


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


def test_what_lies_beside_a_file_is_seen_when_it_changes(tmp_path: Path) -> None:
    """A world file, a mask, statistics with a value for no data, RPC, the header of bare samples."""
    rasterio = pytest.importorskip("rasterio")
    samples = np.random.default_rng(0).integers(1, 99, (20, 30)).astype(np.uint16)
    path = tmp_path / "a.tif"
    with rasterio.open(path, "w", driver="GTiff", height=20, width=30, count=1, dtype="uint16") as dataset:
        dataset.write(samples, 1)
    whole = Window(0, 0, 30, 20)
    source = RasterSource(str(path), scale="amplitude")
    assert source.geolocation is None
    assert source.read(whole).mask.all()
    (tmp_path / "a.tfw").write_text("10\n0\n0\n-10\n505\n995\n")
    assert source.geolocation is not None
    assert source.geolocation.transform == (10, 0, 500, 0, -10, 1000)
    (tmp_path / "a.tfw").write_text("20\n0\n0\n-20\n510\n990.0\n")
    assert source.geolocation.transform == (20, 0, 500, 0, -20, 1000)
    (tmp_path / "a.tfw").unlink()
    assert source.geolocation is None
    (tmp_path / "a.tif.aux.xml").write_text(
        '<PAMDataset><PAMRasterBand band="1"><NoDataValue>7</NoDataValue></PAMRasterBand></PAMDataset>'
    )
    np.testing.assert_array_equal(source.read(whole).mask, samples != 7)
    (tmp_path / "a.tif.aux.xml").unlink()
    with rasterio.open(
        tmp_path / "a.tif.msk", "w", driver="GTiff", height=20, width=30, count=1, dtype="uint8"
    ) as mask:
        mask.write(np.where(np.arange(30) < 9, 0, 255).astype(np.uint8)[None].repeat(20, 0), 1)
        mask.update_tags(INTERNAL_MASK_FLAGS_1="2")
    np.testing.assert_array_equal(source.read(whole).mask[0], np.arange(30) >= 9)
    bare = RasterSource(str(tmp_path / "b.bil"), scale="amplitude")
    samples.astype("<u2").tofile(tmp_path / "b.bil")
    header = "nrows 20\nncols 30\nnbands 1\nnbits 16\npixeltype unsignedint\nbyteorder {}\nlayout bil\n"
    (tmp_path / "b.hdr").write_text(header.format("I"))
    np.testing.assert_array_equal(bare.read(whole).pixels, samples)
    (tmp_path / "b.hdr").write_text(header.format("M"))
    np.testing.assert_array_equal(bare.read(whole).pixels, samples.byteswap())


def test_what_is_not_beside_a_file_is_not_looked_for_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Thirty names a window, which a disk of a network answers one by one; a folder tells whether a file came."""
    path = write_raster(tmp_path / "a.tif", amplitude())
    settled = path.stat().st_mtime_ns - 10 * raster_files.SETTLED_NS
    os.utime(tmp_path, ns=(settled, settled))
    counts = []
    plain = os.stat
    with monkeypatch.context() as patch:
        for _ in range(2):
            asked: list[Any] = []
            patch.setattr(os, "stat", lambda *a, asked=asked, **k: (asked.append(a), plain(*a, **k))[1])
            stamp = raster_files.stamp_of(str(path))
            counts.append(len(asked))
    assert counts[0] > 25
    assert counts[1] <= 3
    (tmp_path / "a.tfw").write_text("1\n0\n0\n-1\n0\n0\n")
    with_world = raster_files.stamp_of(str(path))
    assert with_world != stamp
    os.utime(tmp_path, ns=(settled, settled))
    assert raster_files.stamp_of(str(path)) == stamp  # as the folder says, which nobody else sets back
    (tmp_path / "a.hdr").write_text("one")
    once = raster_files.stamp_of(str(path))
    (tmp_path / "a.hdr").write_text("other")
    assert len({stamp, with_world, once, raster_files.stamp_of(str(path))}) == 4


def test_a_folder_that_has_just_changed_is_looked_at_again(tmp_path: Path) -> None:
    """Its time may be that of a change still to come, as coarse as the clocks of disks are."""
    path = write_raster(tmp_path / "a.tif", amplitude())
    now = time.time_ns()
    os.utime(tmp_path, ns=(now, now))
    before = raster_files.stamp_of(str(path))
    (tmp_path / "a.tfw").write_text("1\n0\n0\n-1\n0\n0\n")
    os.utime(tmp_path, ns=(now, now))
    assert raster_files.stamp_of(str(path)) != before


def test_a_palette_beside_a_scene_tells_it_from_another(tmp_path: Path) -> None:
    """Its colours are the samples that are read."""
    import rasterio

    path, identities, means = tmp_path / "a.tif", [], []
    with rasterio.open(path, "w", driver="GTiff", width=64, height=48, count=1, dtype="uint8") as dataset:
        dataset.write(np.random.default_rng(0).integers(0, 4, (48, 64)).astype(np.uint8), 1)
    for step in (10, 20):
        entries = "".join(
            f'<Entry c1="{step * k}" c2="{step * k}" c3="{step * k}" c4="255"/>' for k in range(256 // step)
        )
        Path(f"{path}.aux.xml").write_text(
            '<PAMDataset><PAMRasterBand band="1"><ColorInterp>Palette</ColorInterp>'
            f"<ColorTable>{entries}</ColorTable></PAMRasterBand></PAMDataset>"
        )
        source = RasterSource(str(path), scale="amplitude")
        identities.append(source.identity())
        means.append(float(source.read(Window(0, 0, 64, 48)).amplitude.mean()))
    assert means[1] == pytest.approx(2 * means[0], rel=0.1)
    assert identities[0] != identities[1]


def test_what_lies_beside_a_scene_tells_it_from_another(tmp_path: Path) -> None:
    import rasterio

    array = amplitude(0)
    path = write_raster(tmp_path / "a.tif", array)
    seen = [open_source(path).identity()]
    # What another program writes when it looks at an image changes nothing.
    pam = '<PAMDataset><PAMRasterBand band="1">{}</PAMRasterBand></PAMDataset>'
    Path(f"{path}.aux.xml").write_text(pam.format('<Metadata><MDI key="STATISTICS_MEAN">7</MDI></Metadata>'))
    assert open_source(path).identity() == seen[0]
    Path(f"{path}.aux.xml").write_text(pam.format("<NoDataValue>9</NoDataValue>"))
    seen.append(open_source(path).identity())
    (tmp_path / "a.tfw").write_text("10\n0\n0\n-10\n500000\n4200000\n")
    seen.append(open_source(path).identity())
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=False), rasterio.open(path, "r+") as dataset:
        dataset.write_mask(array > 0)
    seen.append(open_source(path).identity())
    assert all(one != other for one, other in itertools.combinations(seen, 2))
    (tmp_path / "v.vrt").write_text(
        f'<VRTDataset rasterXSize="{SHAPE[1]}" rasterYSize="{SHAPE[0]}"><VRTRasterBand dataType="Float32" band="1">'
        '<SimpleSource><SourceFilename relativeToVRT="1">a.tif</SourceFilename><SourceBand>1</SourceBand>'
        "</SimpleSource></VRTRasterBand></VRTDataset>"
    )
    before = open_source(tmp_path / "v.vrt").identity()
    write_raster(tmp_path / "b.tif", amplitude(5)).replace(path)
    assert open_source(tmp_path / "v.vrt").identity() != before


def test_a_scene_is_the_same_by_whatever_name_it_is_called(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    np.save(tmp_path / "a.npy", amplitude(0))
    monkeypatch.chdir(tmp_path)
    assert open_source("a.npy").identity() == open_source(tmp_path / "a.npy").identity()


def test_what_a_file_says_of_any_band_that_is_read_tells_a_scene_from_another(tmp_path: Path) -> None:
    import rasterio

    kind: Any = {"driver": "GTiff", "dtype": "float32", "height": SHAPE[0], "width": SHAPE[1], "count": 2}
    with rasterio.open(tmp_path / "a.tif", "w", **kind) as dataset:
        dataset.write(np.stack([amplitude(0), amplitude(1)]))
    seen = [open_source(tmp_path / "a.tif", band=band).identity() for band in ("iq", 1)]
    text = '<PAMDataset><PAMRasterBand band="2"><Scale>3</Scale></PAMRasterBand></PAMDataset>'
    (tmp_path / "a.tif.aux.xml").write_text(text)
    now = [open_source(tmp_path / "a.tif", band=band).identity() for band in ("iq", 1)]
    assert now[0] != seen[0]
    assert now[1] == seen[1]
