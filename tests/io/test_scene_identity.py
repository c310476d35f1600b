"""What tells one scene from another: its files, what lies beside them, and what they say."""

from __future__ import annotations

import itertools
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.io import raster_files
from featreg.io.raster_source import RasterSource, Window, open_source
from made.rasters import write_raster
from made.scene_files import SHAPE, WINDOWS, amplitude

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


def test_a_changed_file_is_read_anew(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.tif", amplitude(0))
    source = RasterSource(str(path))
    first, before = source.read(WINDOWS[1]).pixels, source.identity()
    write_raster(tmp_path / "b.tif", amplitude(5)).replace(path)
    assert not np.array_equal(source.read(WINDOWS[1]).pixels, first)
    assert source.identity() != before


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
