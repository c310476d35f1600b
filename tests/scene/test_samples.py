"""What is looked at of a scene beforehand: keypoints of its blocks, squares of its own pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import featreg
from featreg.io import as_image
from featreg.io.raster_source import ImageSource, Window
from featreg.matching import keypoints_of
from featreg.sar.speckle import equivalent_looks
from featreg.scene.blocks import plan_blocks
from featreg.scene.samples import SIDE, SQUARES, sampled
from featreg.types import Image
from made.scene_results import BLOCK


def test_keypoints_of_a_scene_are_those_of_its_blocks(located_pair: Any) -> None:
    got = featreg.match(
        located_pair.reference, located_pair.secondary, **BLOCK, initial=located_pair.truth, search_radius=12
    )
    found = keypoints_of(located_pair.reference, method="sar-orb", block=200)
    assert found is not None
    own = {tuple(point) for point in found}
    assert len(own) > len(got.matches) > 500
    # The overlap, whose blocks the scene has, lacks a rim of the reference: features of the same windows only.
    blocks = plan_blocks(Window(0, 0, 800, 700), 200)
    assert len(blocks) * 1000 >= len(found)
    assert found.min() >= -0.5
    shared = np.mean([tuple(point) in own for point in got.matches.reference_xy])
    assert shared > 0.9
    assert keypoints_of(located_pair.reference, method="rc-obcls", block=200) is None


def test_keypoints_of_proportional_blocks_rest_on_no_halo(located_pair: Any) -> None:
    whole, alone = (
        keypoints_of(located_pair.reference, method="sar-orb", block=200, split=s) for s in ("prior", "proportional")
    )
    assert whole is not None
    assert alone is not None
    # Columns of blocks are 200 px wide; 5 px at either side of a rim.
    rim = [np.abs((xy[:, 0] + 0.5) % 200 - 100) > 95 for xy in (whole, alone)]
    assert rim[0].any()
    assert not rim[1].any()


def test_a_scene_is_probed_by_squares_of_its_own_pixels() -> None:
    rng = np.random.default_rng(3)
    speckle = np.sqrt(rng.gamma(4.0, 0.25, (1500, 1400))).astype(np.float32)
    speckle[:590] = np.nan
    source = ImageSource(as_image(speckle))
    seen = sampled(source)
    assert seen.shape == ((SQUARES**2 - 10) * SIDE, SIDE)  # two rows of squares hold no data
    assert seen.all_valid
    assert equivalent_looks(seen) == pytest.approx(equivalent_looks(as_image(speckle[590:])), rel=0.05)
    small = ImageSource(as_image(speckle[600:700, :90]))
    assert sampled(small).shape == (100, 90)


def test_a_narrow_strip_of_data_is_probed_too() -> None:
    speckle = np.sqrt(np.random.default_rng(3).gamma(4.0, 0.25, (2000, 2000))).astype(np.float32)
    y, x = np.mgrid[:2000, :2000]
    whole = equivalent_looks(as_image(speckle[:500, :500]))
    for width in (200, 100):
        strip = sampled(ImageSource(as_image(speckle, mask=np.abs(x - y - 290) < width / 2)))
        assert len(strip.pixels) <= SQUARES**2 * SIDE
        assert equivalent_looks(strip) == pytest.approx(whole, rel=0.25)
    nothing = sampled(ImageSource(Image(speckle, np.zeros(speckle.shape, np.bool_))))
    assert nothing.shape == (SIDE, SIDE)
    assert not nothing.mask.any()
