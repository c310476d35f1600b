"""What goes wrong in a scene: failing blocks, scenes of other places, keywords that cannot be."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import featreg
from featreg.errors import InputError, NoOverlapError, ParameterError
from featreg.interfaces import Matcher
from featreg.pipeline.assembly import assemble
from featreg.simulate import sar_pair
from featreg.types import Image, Matches
from made.scene_results import BLOCK, scene_error


class Fragile(Matcher):
    """Fails on every image whose first pixel is brighter than the second."""

    def match(self, reference: Image, secondary: Image) -> Matches:
        if reference.amplitude[0, 0] > reference.amplitude[0, 1]:
            raise ValueError("the first pixel is too bright")
        return _sar_orb().match(reference, secondary)


def _sar_orb() -> Matcher:

    matcher = assemble("sar-orb", n_features=500).matcher
    assert matcher is not None
    return matcher


def test_a_failing_block_is_a_row_and_not_the_end(located_pair: Any) -> None:
    got = featreg.match(located_pair.reference, located_pair.secondary, method=Fragile(), filters=["fsc"], **BLOCK)
    counts, table = got.provenance["blocks"], got.provenance["block_table"]
    assert 0 < counts["failed"] < counts["total"]
    assert "ValueError: the first pixel is too bright" in table["reason"]
    assert got.status == "ok", got.reason
    assert scene_error(got, located_pair.truth) < 0.2


class Broken(Matcher):
    """Never works."""

    def match(self, reference: Image, secondary: Image) -> Matches:
        raise RuntimeError("no")


def test_all_blocks_failing_is_an_unreliable_result(located_pair: Any) -> None:
    got = featreg.match(located_pair.reference, located_pair.secondary, method=Broken(), **BLOCK)
    assert got.status == "unreliable"
    counts = got.provenance["blocks"]
    assert counts["failed"] == counts["total"] - counts["skipped"]
    assert not len(got.matches)


def test_unrelated_scenes_are_unreliable(located_pair: Any, tmp_path: Path) -> None:
    """The geolocation says that they show the same ground, and they do not."""
    import rasterio

    other = sar_pair((700, 800), seed=99).secondary
    with rasterio.open(located_pair.secondary) as source:
        profile = source.profile
    with rasterio.open(tmp_path / "other.tif", "w", **profile) as dataset:
        dataset.write(np.clip(other * 300, 1, 65535).astype(np.uint16), 1)
    got = featreg.match(located_pair.reference, tmp_path / "other.tif", **BLOCK)
    assert got.status == "unreliable"
    assert got.reason


def test_no_overlap_says_where_the_images_lie(located_pair: Any, tmp_path: Path) -> None:
    import rasterio
    from rasterio.transform import Affine

    with rasterio.open(located_pair.secondary) as source:
        profile = source.profile | {"transform": Affine(10.0, 0.0, 700_000.0, 0.0, -10.0, 4_000_000.0)}
        samples = source.read(1)
    with rasterio.open(tmp_path / "far.tif", "w", **profile) as dataset:
        dataset.write(samples, 1)
    with pytest.raises(NoOverlapError, match="km"):
        featreg.match(located_pair.reference, tmp_path / "far.tif", **BLOCK)


@pytest.mark.parametrize(
    ("keywords", "text"),
    [
        ({"block": 50}, "block must be"),
        ({"block": 200.5}, "block must be"),
        ({"block": 200, "workers": 0}, "workers must be"),
        ({"block": 200, "executor": "cluster"}, "executor must be"),
        ({"block": 200, "dem": "a.tif", "height": 3.0}, "not from both"),
        ({"block": False, "height": 20.0}, "is for blocks"),
        ({"block": False, "model": "rpc-bias"}, "is for blocks"),
    ],
)
def test_misuse_says_what_would_be_right(keywords: dict[str, Any], text: str, located_pair: Any) -> None:
    with pytest.raises(ParameterError, match=text):
        featreg.match(located_pair.reference, located_pair.secondary, **keywords)


def test_a_missing_elevation_model_is_named(located_pair: Any) -> None:
    with pytest.raises(InputError, match=r"nowhere\.tif"):
        featreg.match(located_pair.reference, located_pair.secondary, **BLOCK, dem="nowhere.tif")


def test_rpc_bias_without_geolocation_is_an_error() -> None:
    noise = np.random.default_rng(0).random((300, 300), np.float32)
    with pytest.raises(InputError, match="nothing says where"):
        featreg.match(noise, noise, model="rpc-bias")
