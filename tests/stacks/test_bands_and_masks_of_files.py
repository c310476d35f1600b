"""Displacement fields and stacks of files with several bands and with samples that are not data."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import featreg
from featreg import Stack
from featreg.cli.main import main
from featreg.errors import FeatregError
from featreg.simulate import sar_series

rasterio = pytest.importorskip("rasterio")
pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

NOTHING = -9.0


@pytest.fixture(scope="module")
def images() -> list[Any]:
    images = [image.copy() for image in sar_series(3, (200, 200), looks=8, seed=5).images]
    for image in images:
        image[:20, :20] = NOTHING
    return images


@pytest.fixture(scope="module")
def files(images: list[Any], tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Files whose band VH holds the images, their band VV something else."""
    home = tmp_path_factory.mktemp("bands")
    size: Any = {"driver": "GTiff", "height": 200, "width": 200, "count": 2, "dtype": "float32"}
    names = []
    for i, image in enumerate(images):
        noise = np.random.default_rng(i).gamma(1.0, 1.0, image.shape).astype(np.float32)
        names.append(str(home / f"{i}.tif"))
        with rasterio.open(names[-1], "w", **size) as out:
            out.write(np.stack([noise, image]))
            out.descriptions = ("VV", "VH")
    return names


def test_offsets_reads_the_band_that_is_named(files: list[str], images: list[Any], tmp_path: Path) -> None:
    same = featreg.offsets(*images[:2], nodata=NOTHING)
    field = featreg.offsets(*files[:2], nodata=NOTHING, band="VV", reference_band=2, secondary_band="VH")
    assert field.dx.tobytes() == same.dx.tobytes()
    assert field.good.sum() > 10
    assert (field.reference.band, field.secondary.band) == ("2", "VH")
    with pytest.raises(FeatregError, match="state which one as band"):
        featreg.offsets(*files[:2])
    made = tmp_path / "offsets.tif"
    assert main(["offsets", *files[:2], "-o", str(made), "--band", "VH", "--nodata", "-9", "--workers", "1"]) == 0
    with rasterio.open(made) as raster:
        np.testing.assert_array_equal(raster.read(1), same.dx.astype(np.float32))


def test_a_stack_reads_its_band_when_it_matches_and_when_it_warps(
    files: list[str], images: list[Any], tmp_path: Path
) -> None:
    job: Any = {"model": "rigid", "nodata": NOTHING, "workers": 1}
    same = featreg.register_stack(images, **job)
    stack = featreg.register_stack(files[:2], band="VH", **job)
    stack.to_json(tmp_path / "stack.json")
    stack = Stack.from_json(tmp_path / "stack.json").add(files[2], workers=1)
    for model, other in zip(stack.models, same.models, strict=True):
        assert model is not None
        assert other is not None
        assert model.parameters == other.parameters
    for warped, other_warped in zip(stack.warp(), same.warp(), strict=True):
        np.testing.assert_array_equal(warped, other_warped)
        assert np.isnan(warped[5:10, 5:10]).all()
