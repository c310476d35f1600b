"""Samples kept with a gain and an offset stand for the same values, read whole or by windows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.geometry import Affine
from featreg.io import as_image
from featreg.io.raster_source import RasterSource
from featreg.io.window import Window
from featreg.products.warping import warp_file
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.types import Matches

rasterio = pytest.importorskip("rasterio")
pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

#: Decibels between -25 and 5 in every dtype that packs them.
PACKED = {"uint16": (0.01, -100.0), "uint8": (0.2, -40.0), "int16": (0.01, 0.0), "uint32": (1e-6, -50.0)}


def packed(path: Path, dtype: str, *, side: int = 48, alpha: bool = False, **more: Any) -> np.ndarray[Any, Any]:
    """Write decibels packed into integers; return the numbers in the file."""
    gain, offset = PACKED[dtype]
    db = np.random.default_rng(0).uniform(-25, 5, (side, side))
    numbers = np.rint((db - offset) / gain).astype(dtype)
    profile = {"driver": "GTiff", "width": side, "height": side, "count": 1 + alpha, "dtype": dtype, **more}
    with rasterio.open(path, "w", **profile) as dataset:
        dataset.write(numbers, 1)
        if alpha:
            dataset.write(np.full((side, side), np.iinfo(dtype).max, dtype), 2)
            dataset.colorinterp = [rasterio.enums.ColorInterp.gray, rasterio.enums.ColorInterp.alpha]
        dataset.scales, dataset.offsets = (gain,) * (1 + alpha), (offset,) * (1 + alpha)
    return numbers


@pytest.mark.parametrize("dtype", PACKED)
@pytest.mark.parametrize("alpha", [False, True])
def test_windows_and_the_whole_have_the_same_values(dtype: str, alpha: bool, tmp_path: Path) -> None:
    packed(tmp_path / "a.tif", dtype, alpha=alpha)
    whole, source = as_image(tmp_path / "a.tif"), RasterSource(str(tmp_path / "a.tif"))
    assert source.known_scale == whole.scale == "db"
    part = source.read(Window(5, 7, 20, 30))
    assert np.array_equal(part.pixels, whole.pixels[7:37, 5:25])
    assert np.array_equal(part.mask, whole.mask[7:37, 5:25])


def test_what_is_masked_has_no_say_in_the_scale(tmp_path: Path) -> None:
    side = 40
    amplitude = np.random.default_rng(1).uniform(1, 9, (side, side)).astype(np.float32)
    amplitude[:8] = -20.0
    with rasterio.open(
        tmp_path / "a.tif", "w", driver="GTiff", width=side, height=side, count=1, dtype="float32"
    ) as dataset:
        dataset.write(amplitude, 1)
        dataset.write_mask(np.arange(side)[:, None] * np.ones(side) >= 8)
    assert RasterSource(str(tmp_path / "a.tif")).known_scale == as_image(tmp_path / "a.tif").scale == "amplitude"
    rows = ((0.0, 7.5), (39.0, 7.5), (39.0, 39.0), (0.0, 39.0))
    np.save(tmp_path / "b.npy", amplitude)
    masked = RasterSource(str(tmp_path / "b.npy"), mask=(rows,))
    assert masked.known_scale == "amplitude"


def test_a_product_of_packed_decibels_keeps_its_samples(tmp_path: Path) -> None:
    numbers = packed(tmp_path / "a.tif", "uint16")
    images: Any = {role: InputImage(str(tmp_path / "a.tif"), numbers.shape) for role in ("reference", "secondary")}
    result = Registration(Matches.empty(), {}, np.zeros(0, bool), Affine(np.eye(3)[:2]), "ok", **images)
    product = warp_file(result, tmp_path / "a.tif", tmp_path / "o.tif", resampling="nearest", workers=1)
    assert product.valid == 1.0
    with rasterio.open(tmp_path / "o.tif") as dataset:
        assert np.array_equal(dataset.read(1), numbers)
        assert (dataset.scales[0], dataset.offsets[0]) == PACKED["uint16"]
