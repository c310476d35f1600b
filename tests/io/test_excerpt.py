"""A part of a scene that is read once: windows of it are those of the scene."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import rasterio

from featreg.io.excerpt import Excerpt, part_of, together
from featreg.io.raster_files import stamp_of, unchanged
from featreg.io.raster_source import RasterSource, Source, Window, open_source
from featreg.types import Image


@pytest.fixture
def scene(tmp_path: Path) -> Source:
    path, rng = tmp_path / "scene.tif", np.random.default_rng(2)
    kind = {"driver": "GTiff", "dtype": "uint16", "nodata": 0, "transform": rasterio.Affine.scale(10)}
    with rasterio.open(path, "w", height=70, width=90, count=1, **kind) as file:
        file.write(rng.integers(0, 9, (70, 90)).astype(np.uint16), 1)
    return open_source(path)


@pytest.mark.parametrize("window", [Window(-4, 10, 40, 30), Window(5, 12, 31, 28), Window(-4, 5, 60, 45)])
def test_windows_of_an_excerpt_are_those_of_the_scene_which_is_read_once(
    scene: Source, window: Window, monkeypatch: pytest.MonkeyPatch
) -> None:
    wanted = scene.read(window)
    reads: list[Window] = []
    plain = RasterSource.read

    def counted(source: RasterSource, asked: Window) -> Image:
        reads.append(asked)
        return plain(source, asked)

    monkeypatch.setattr(RasterSource, "read", counted)
    excerpt = Excerpt(scene, Window(-4, 5, 60, 45))
    for _ in range(2):
        found = excerpt.read(window)
        np.testing.assert_array_equal(found.pixels, wanted.pixels)
        np.testing.assert_array_equal(found.mask, wanted.mask)
        assert found.pixels.flags.c_contiguous
        assert (found.name, found.source_dtype, found.scale) == (wanted.name, wanted.source_dtype, wanted.scale)
    assert reads == [excerpt.window]
    assert excerpt.shape == (70, 90)


def test_windows_are_read_together_only_where_they_share_most() -> None:
    here = Window(10, 20, 100, 100)
    assert together(here, here) == here
    assert together(here, Window(16, 11, 110, 100)) == Window(10, 11, 116, 109)
    assert together(here, Window(90, 20, 100, 100)) is None
    assert together(here, Window(5000, 20, 100, 100)) is None
    mask = np.arange(12).reshape(3, 4) % 5 == 0
    np.testing.assert_array_equal(part_of(mask, Window(6, 9, 2, 2), Window(5, 8, 4, 3)), mask[1:3, 1:3])


def test_files_are_looked_at_once_while_they_are_taken_for_unchanged(scene: Source) -> None:
    before = stamp_of(scene.name)
    beside = Path(scene.name + ".hdr")
    with unchanged():
        assert stamp_of(scene.name) == before
        with unchanged():
            beside.write_text("more")
            assert stamp_of(scene.name) == before
        assert stamp_of(scene.name) == before
    assert stamp_of(scene.name) != before


def test_a_library_that_another_thread_is_importing_is_let_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rasterio", ModuleType("rasterio"))
    with unchanged():
        assert "rasterio" in sys.modules
