"""Which scale samples have is told from no more than memory holds, negative ones included."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from featreg.io import as_image
from featreg.io.raster_files import SAMPLE, scale_by_strips
from featreg.io.raster_source import Window, open_source
from featreg.io.reader import Raster
from made.placed_rasters import AMPLITUDE, RNG, H, W, write

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


def test_the_scale_is_told_from_no_more_than_memory_holds() -> None:
    read = []

    def of(window: Window) -> Raster:
        read.append(window.width * window.height)
        return Raster(np.ones((4, 4), np.float32), "float32")

    assert scale_by_strips((5, 10**12), of, None, lambda window: None, "a") == "amplitude"
    assert sum(read) <= 5 * SAMPLE**2


def test_negative_intensities_are_very_dark_data(tmp_path: Path) -> None:
    noisy = (AMPLITUDE**2).astype(np.float32)
    noisy[::7, ::5] *= -0.01
    path = write(tmp_path / "a.tif", noisy, "GTiff")
    for image in (as_image(path, scale="intensity"), open_source(path, scale="intensity").read(Window(0, 0, W, H))):
        assert image.mask.all()
        np.testing.assert_allclose(image.pixels, np.sqrt(np.maximum(noisy, 0)), rtol=1e-6)


def test_linear_samples_with_negatives_are_told_from_decibels(tmp_path: Path) -> None:
    sigma0 = RNG.gamma(1.0, 0.08, (H, W)).astype(np.float32) - 0.004
    assert 0.03 < (sigma0 < 0).mean() < 0.08
    assert as_image(write(tmp_path / "a.tif", sigma0, "GTiff")).scale == "intensity"
    assert as_image(write(tmp_path / "b.tif", sigma0, "GTiff", names=["Sigma0_VV"])).scale == "intensity"
    db = (10 * np.log10(np.maximum(sigma0, 1e-4))).astype(np.float32)
    assert as_image(write(tmp_path / "c.tif", db, "GTiff")).scale == "db"
    assert as_image(write(tmp_path / "d.tif", db, "GTiff", names=["sigma0"])).scale == "db"
    bright = write(tmp_path / "e.tif", db - db.min(), "GTiff", names=["VV_dB"])
    assert as_image(bright).scale == open_source(bright).known_scale == "db"
