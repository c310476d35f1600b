"""What samples are by the names of bands and files, as SNAP, pyroSAR and others write them."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.cli.info import describe
from featreg.errors import InputError
from featreg.io import as_image
from featreg.io.raster_source import Window, open_source
from made.rasters import write_raster

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

POWER = np.random.default_rng(0).gamma(4.0, 0.05, (40, 60)).astype(np.float32)
DB = (10 * np.log10(POWER)).astype(np.float32)


@pytest.mark.parametrize(
    ("file", "band", "samples", "scale"),
    [
        ("a.tif", "Sigma0_VV", POWER, "intensity"),
        ("a.tif", "Gamma0_VH", POWER, "intensity"),
        ("a.tif", "Intensity_VV", POWER, "intensity"),
        ("a.tif", "Amplitude_VV", POWER, "amplitude"),
        ("a.tif", "Sigma0_VV_db", DB, "db"),
        ("a.tif", "Sigma0_VV_db", DB - DB.min(), "db"),
        ("S1A__IW___A_20150309T173017_VV_gamma0-rtc.tif", "", POWER, "intensity"),
        ("S1A__IW___A_20150309T173017_VV_gamma0-rtc_db.tif", "", DB, "db"),
        ("S1A__IW___A_20150309T173017_VV_grd_mli_geo_norm_db.tif", "", DB - DB.min(), "db"),
        ("S1_sigma0_VV.tif", "Amplitude_VV", POWER, "amplitude"),
        ("S1_VV_gamma0_amplitude.tif", "", POWER, "amplitude"),
        ("S1_sigma0_VV.tif", "VV", POWER, "amplitude"),
        ("scene.tif", "", POWER, "amplitude"),
        ("a.tif", "Sigma0_VV", (POWER * 1e4).astype(np.uint16), "amplitude"),
        ("a.tif", "Sigma0_VV", POWER * 1e3, "amplitude"),
        ("a.tif", "Intensity_VV", POWER * 1e3, "intensity"),
        ("a_db.tif", "", (POWER * 1e4).astype(np.int16), "amplitude"),
    ],
)
def test_names_tell(
    file: str, band: str, samples: Any, scale: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = write_raster(tmp_path / file, samples, names=[band] if band else [])
    with caplog.at_level(logging.WARNING, "featreg"):
        image = as_image(path)
    assert image.scale == scale
    values = samples.astype(np.float64)
    expected = values
    if scale != "amplitude":
        expected = np.sqrt(values) if scale == "intensity" else 10 ** (values / 20)
    np.testing.assert_allclose(image.pixels, expected, rtol=1e-5)
    assert not caplog.records
    source = open_source(path)
    assert source.known_scale == scale
    np.testing.assert_array_equal(source.read(Window(5, 6, 20, 10)).pixels, image.pixels[6:16, 5:25])


def test_the_user_may_say_otherwise_and_is_told_what_was_taken(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "Sigma0_VV.img", POWER, "ENVI", ["Sigma0_VV"])
    assert describe(str(path))["samples"] == {
        "dtype": "float32",
        "scale": "intensity",
        "told_by": "its names and units",
    }
    assert describe(str(path), scale="amplitude")["samples"]["told_by"] == "stated"
    np.testing.assert_array_equal(as_image(path, scale="amplitude").pixels, POWER)
    by_file = write_raster(tmp_path / "gamma0.tif", POWER)
    assert describe(str(by_file))["samples"]["told_by"] == "the name of the file"
    assert describe(str(write_raster(tmp_path / "plain.tif", POWER)))["samples"]["told_by"] == "its samples"


def test_the_header_of_snap_says_which_file_to_give(tmp_path: Path) -> None:
    (tmp_path / "product.data").mkdir()
    write_raster(tmp_path / "product.data" / "Sigma0_VV.img", POWER, "ENVI", ["Sigma0_VV"])
    (tmp_path / "product.dim").write_text('<?xml version="1.0"?><Dimap_Document name="product.dim"></Dimap_Document>')
    with pytest.raises(InputError, match=r"header of SNAP; give one of its bands: .*product\.data/Sigma0_VV\.img'"):
        as_image(tmp_path / "product.dim")


def test_words_that_samples_belie_are_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    linear = np.random.default_rng(1).exponential(3000.0, (40, 60)).astype(np.float32) - 20
    assert (linear < 0).any()
    path = write_raster(tmp_path / "a_db.tif", linear)
    image = as_image(path)
    assert image.scale == "intensity"
    assert "is called decibels, but most of its values cannot be" in caplog.text
    np.testing.assert_allclose(image.pixels, np.sqrt(np.maximum(linear, 0)), rtol=1e-5)
