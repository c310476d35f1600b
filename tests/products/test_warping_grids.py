"""Products from file to file: any number of workers, any size, grids of other pixels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import featreg
from featreg.geometry import Affine
from featreg.io import as_image, write_geotiff
from featreg.products.files import WINDOW
from featreg.products.lattice import OtherGrids, resized
from featreg.products.resample import resample
from featreg.products.warping import warp_file
from featreg.types import Geolocation
from made.warped_files import MOVE, PLACE, SHAPE, files, read, registration, texture

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


def test_any_number_of_workers_gives_the_same_file(tmp_path: Path) -> None:
    files(tmp_path, texture(WINDOW + 100, WINDOW + 40).astype(np.uint16))
    reg = registration(tmp_path, size=(WINDOW + 100, WINDOW + 40))
    for workers in (1, 3):
        warp_file(reg, tmp_path / "sec.tif", tmp_path / f"{workers}.tif", workers=workers)
    np.testing.assert_array_equal(read(tmp_path / "1.tif")[0], read(tmp_path / "3.tif")[0])


def test_a_window_that_shows_much_of_the_secondary_is_read_in_parts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files(tmp_path, texture(*SHAPE).astype(np.uint16))
    warp_file(registration(tmp_path), tmp_path / "sec.tif", tmp_path / "a.tif")
    monkeypatch.setattr("featreg.products.rendering.MOST_READ", 5000)
    warp_file(registration(tmp_path), tmp_path / "sec.tif", tmp_path / "b.tif")
    a, b = (read(tmp_path / name)[0].astype(int) for name in ("a.tif", "b.tif"))
    assert np.abs(a - b).max() <= 1


def test_beyond_the_width_that_opencv_takes(tmp_path: Path) -> None:
    wide = np.tile(texture(40, 1000), (1, 34)).astype(np.uint16)
    wide[:, 33500] = 1000
    files(tmp_path, wide)
    reg = registration(tmp_path, Affine(np.array([[1.0, 0, 5], [0, 1, 2]])), wide.shape)
    warp_file(reg, tmp_path / "sec.tif", tmp_path / "out.tif")
    written = read(tmp_path / "out.tif")[0][0]
    np.testing.assert_array_equal(written[:-2, :-5], wide[2:, 5:])


@pytest.mark.parametrize("factor", [2, 3])
def test_one_fit_serves_a_file_with_smaller_pixels(tmp_path: Path, factor: int, caplog: Any) -> None:
    files(tmp_path, texture(*SHAPE))
    reg = registration(tmp_path)
    whole = featreg.warp(reg, tmp_path / "sec.tif", resampling="bilinear")
    fine = np.kron(read(tmp_path / "sec.tif")[0][0], np.ones((factor, factor), np.float32))
    write_geotiff(tmp_path / "fine.tif", fine)
    warp_file(reg, tmp_path / "fine.tif", tmp_path / "out.tif", resampling="bilinear")
    assert f"{factor} times as many pixels" in caplog.text
    out = read(tmp_path / "out.tif")[0][0]
    both = np.isfinite(out) & np.isfinite(whole)

    # Blocks of equal pixels: no shift between the two, only less smoothing.
    def mean_shift(axis: int) -> float:
        slope = np.gradient(whole, axis=axis)
        good = both & np.isfinite(slope)
        return float((slope[good] * (out - whole)[good]).sum() / (slope[good] ** 2).sum())

    assert abs(mean_shift(0)) < 0.02
    assert abs(mean_shift(1)) < 0.02
    stated = warp_file(reg, tmp_path / "fine.tif", tmp_path / "b.tif", secondary_scale=factor, resampling="bilinear")
    np.testing.assert_array_equal(read(tmp_path / "b.tif")[0][0], out)
    assert stated.shape == SHAPE


def test_georeferencing_tells_the_pixel_size_and_the_corner(tmp_path: Path) -> None:
    samples = texture(*SHAPE)
    write_geotiff(tmp_path / "ref.tif", samples)
    write_geotiff(tmp_path / "sec.tif", samples, PLACE)
    a, b, c, d, e, f = (10.0, 0.0, 5e5, 0.0, -10.0, 6e6)
    write_geotiff(tmp_path / "part.tif", samples[40:, 25:], Geolocation((a, b, c + 250, d, e, f - 400), PLACE.crs))
    reg = registration(tmp_path)
    warp_file(reg, tmp_path / "part.tif", tmp_path / "part_out.tif")
    warp_file(reg, tmp_path / "sec.tif", tmp_path / "out.tif")
    part, whole = (read(tmp_path / name)[0][0] for name in ("part_out.tif", "out.tif"))
    both = np.isfinite(part)
    assert both.mean() > 0.6
    np.testing.assert_allclose(part[both], whole[both], rtol=1e-5)


def test_a_reference_with_other_pixels_is_a_grid_too(tmp_path: Path) -> None:
    files(tmp_path, texture(*SHAPE))
    write_geotiff(tmp_path / "half.tif", texture(SHAPE[0] // 2, SHAPE[1] // 2))
    made = warp_file(registration(tmp_path), tmp_path / "sec.tif", tmp_path / "o.tif", like=tmp_path / "half.tif")
    assert made.shape == (150, 170)
    model = OtherGrids(MOVE, resized((2, 2)), resized((1, 1)))
    wanted = resample(as_image(tmp_path / "sec.tif"), model, (150, 170))
    np.testing.assert_allclose(read(tmp_path / "o.tif")[0][0][wanted.mask], wanted.pixels[wanted.mask], rtol=1e-5)
