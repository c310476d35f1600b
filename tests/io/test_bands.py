"""Of several bands one is named: by number, by name, as I and Q, as colours."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio

from featreg.errors import InputError
from featreg.io import as_image
from featreg.io.bands import Choice, choose, name_of
from featreg.io.raster_source import RasterSource, Window, open_source
from featreg.io.reader import Band
from made.placed_rasters import AMPLITUDE, BYTES, COMPLEX, RNG, H, W, write

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


def test_of_several_bands_one_must_be_named(tmp_path: Path) -> None:
    names = ["Sigma0_VV", "Gamma0_VV", "Sigma0_VH"]
    path = write(tmp_path / "a.tif", np.stack([AMPLITUDE * k for k in (1, 2, 3)]), "GTiff", names=names)
    with pytest.raises(InputError, match=r"has 3 bands, state which one as band .*1 'Sigma0_VV' .*3 'Sigma0_VH'"):
        as_image(path)
    assert as_image(path, band="vh").band == "Sigma0_VH"
    np.testing.assert_array_equal(as_image(path, band="gamma0").pixels, AMPLITUDE * 2)
    for band in (3, "3", "Sigma0_VH", "VH"):
        np.testing.assert_array_equal(as_image(path, band=band).pixels, AMPLITUDE * 3)
    with pytest.raises(InputError, match="2 bands go by 'VV', write more of the name"):
        as_image(path, band="VV")
    with pytest.raises(InputError, match="did you mean 'Sigma0_VH'"):
        as_image(path, band="Sigma0_HH")
    with pytest.raises(InputError, match="band 4 was asked for"):
        RasterSource(str(path), band=4).checked()


def test_pairs_of_i_and_q_are_told_by_their_names(tmp_path: Path) -> None:
    parts = np.stack([COMPLEX.imag, COMPLEX.real, 2 * COMPLEX.real, 2 * COMPLEX.imag]).astype(np.int16)
    path = write(tmp_path / "a.tif", parts, "GTiff", names=["q_VV", "i_VV", "i_VH", "q_VH"])
    with pytest.raises(InputError, match="or 'iq' for complex samples"):
        as_image(path)
    with pytest.raises(InputError, match="2 pairs of I and Q, write iq:NAME"):
        as_image(path, band="iq")
    image = as_image(path, band="iq:VV")
    np.testing.assert_array_equal(image.pixels, COMPLEX)
    assert image.band == "iq:vv"
    np.testing.assert_array_equal(as_image(path, band="iq:vh").pixels, 2 * COMPLEX)


def test_colours_and_palettes_become_luminance(tmp_path: Path) -> None:
    rgb = RNG.integers(0, 256, (3, H, W)).astype(np.uint8)
    wanted = np.tensordot([0.299, 0.587, 0.114], rgb.astype(float), 1)
    alpha = np.full((H, W), 255, np.uint8)
    alpha[:9] = 0
    path = write(tmp_path / "a.tif", np.stack([*rgb, alpha]), "GTiff", photometric="RGB", alpha="YES")
    for image in (as_image(path), open_source(str(path)).read(Window(0, 0, W, H))):
        np.testing.assert_array_equal(image.mask, alpha > 0)
        np.testing.assert_allclose(image.pixels[image.mask], wanted[alpha > 0], atol=0.501)
    np.testing.assert_array_equal(as_image(path, band="rgb").pixels, as_image(path).pixels)
    np.testing.assert_array_equal(as_image(path, band=2).pixels[9:], rgb[1, 9:])
    with rasterio.open(tmp_path / "p.png", "w", driver="PNG", height=H, width=W, count=1, dtype="uint8") as dataset:
        dataset.write(BYTES, 1)
        dataset.write_colormap(1, {i: (i, 255 - i, 7, 255 if i != 9 else 0) for i in range(256)})
    image = as_image(tmp_path / "p.png")
    palette = 0.299 * BYTES + 0.587 * (255.0 - BYTES) + 0.114 * 7
    np.testing.assert_array_equal(image.mask, BYTES != 9)
    np.testing.assert_allclose(image.pixels[image.mask], palette[BYTES != 9], atol=0.501)


def test_a_pair_of_parts_is_asked_for_by_what_only_it_has(tmp_path: Path) -> None:
    names = [f"{part}_IW{swath}_{name}" for swath in (1, 2) for name in ("VV", "VH") for part in "iq"]
    bands = [Band(name, (H, W), "float32") for name in names]
    for k in range(4):
        choice = Choice("iq", (2 * k, 2 * k + 1))
        asked = name_of(bands, choice)
        assert choose(bands, asked, "a") == choice
    assert name_of(bands[:4], Choice("iq", (0, 1))) == "iq:vv"
    with pytest.raises(InputError, match="has no band '²'"):
        choose(bands, "²", "a")


@pytest.mark.parametrize("dtype", ["int16", "float32"])
def test_parts_that_are_scaled_keep_their_holes(dtype: str, tmp_path: Path) -> None:
    parts = np.stack([COMPLEX.real, COMPLEX.imag]).astype(dtype)
    parts[:, :7] = -9999
    path = write(tmp_path / "a.tif", parts, "GTiff", names=["i", "q"], nodata=-9999)
    with rasterio.open(path, "r+") as dataset:
        dataset.scales, dataset.offsets = (0.001, 0.001), (0.0, 0.0)
    image = as_image(path, band="iq")
    np.testing.assert_array_equal(image.mask[:, 0], np.arange(H) >= 7)
    np.testing.assert_allclose(image.pixels[7:], COMPLEX[7:] * 0.001, rtol=1e-6)
