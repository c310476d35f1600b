"""The blocks of a scene: every pixel in one, sides that suit the method, pilots all over."""

from __future__ import annotations

import math

import numpy as np
import pytest

import featreg
from featreg.io.raster_source import Window
from featreg.pipeline.assembly import assemble
from featreg.pipeline.feature_matcher import FeatureMatcher
from featreg.scene.blocks import MEMORY, Block, halo_of, middle_of, plan_blocks, spread_out, suitable_side
from featreg.scene.task import (
    refined_points,
)


def test_blocks_own_every_pixel_once() -> None:
    area = Window(13, -5, 1234, 777)
    blocks = plan_blocks(area, 200)
    owned = np.zeros((777, 1234), np.int64)
    for block in blocks:
        w = block.window
        owned[w.y + 5 : w.y + 5 + w.height, w.x - 13 : w.x - 13 + w.width] += 1
    assert (owned == 1).all()
    sides = np.array([(b.window.width, b.window.height) for b in blocks])
    assert np.ptp(sides, axis=0).max() <= 1
    assert [b.index for b in blocks] == list(range(len(blocks)))
    assert 0.66 * 200 <= sides.min() <= sides.max() <= 1.34 * 200


def test_an_area_smaller_than_a_block_is_one_block() -> None:
    assert [b.window for b in plan_blocks(Window(3, 4, 50, 70), 600)] == [Window(3, 4, 50, 70)]


def test_large_scenes_have_larger_blocks_and_as_many_refined_points() -> None:
    refined, plain, dense = (
        assemble(name, blocks=True, refine=refine)
        for name, refine in (("sar-orb", True), ("sar-orb", False), ("sar-dense", None))
    )
    large, middling, small = (Window(0, 0, *size) for size in ((11_000, 10_000), (4400, 4000), (2500, 2750)))
    assert suitable_side(large, refined) == 1000
    assert suitable_side(middling, refined) == round(np.sqrt(4400 * 4000) / 5)
    assert suitable_side(small, refined) == 600
    # The matches of a block, so many a block, are the tie points; and the paper's blocks are those of the paper.
    assert suitable_side(large, plain) == suitable_side(large, dense) == 600
    # Of what compares no features nothing is known.
    patches = assemble("cls", blocks=True)
    assert patches.refine is not None
    assert suitable_side(large, patches) == 600
    assert suitable_side(large, refined, "proportional") == 600
    assert [refined_points(Window(0, 0, side, side)) for side in (200, 600, 1200)] == [64, 64, 256]


def test_no_larger_block_takes_much_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    pipeline, large = assemble("sar-orb", blocks=True, refine=True), Window(0, 0, 11_000, 10_000)
    matcher = pipeline.matcher
    assert isinstance(matcher, FeatureMatcher)
    rim = 2 * halo_of(matcher, pipeline.locate, pipeline.refine)
    narrow, sides = Window(0, 0, 20_000, 1450), {}
    for area in (large, narrow):
        for pixel in (500.0, 1000.0, 5000.0):
            monkeypatch.setattr(
                type(matcher.detector), "window_bytes", lambda _, shape, pixel=pixel: pixel * shape[0] * shape[1]
            )
            sides[area, pixel] = side = suitable_side(area, pipeline)
            asked, least = (
                max(pixel * (w.height + rim) * (w.width + rim) for w in (b.window for b in plan_blocks(area, n)))
                for n in (side, 600)
            )
            assert asked <= max(MEMORY, least)
    # As large as there is room for, but for what blocks differ from what they are asked to be.
    assert sides[large, 500.0] == 1000
    assert sides[large, 1000.0] == pytest.approx(math.isqrt(MEMORY // 1000) - rim, rel=0.08)
    assert plan_blocks(large, sides[large, 5000.0]) == plan_blocks(large, 600)
    # One row of blocks 1450 px high would be too much, two rows are not.
    assert sides[narrow, 1000.0] < 967


def test_what_is_looked_at_part_by_part_takes_the_memory_of_a_part() -> None:
    pytest.importorskip("kornia")
    network = featreg.create("detector", "kornia-aliked")
    small, whole, parted = (network.window_bytes((side, side)) for side in (792, 1024, 1192))
    assert parted < small < whole
    assert whole == pytest.approx(small * (1024 / 792) ** 2)
    two = featreg.create("detector", "kornia-aliked", batch=2)
    assert two.window_bytes((1192, 1192)) == 2 * parted
    assert two.window_bytes((792, 792)) == small
    doubled, plain = (featreg.create("detector", "kornia-hessian", double_image=d) for d in (True, False))
    assert doubled.window_bytes((800, 900)) == 4 * plain.window_bytes((800, 900)) > 0


def test_a_pilot_block_is_the_middle_of_a_large_block() -> None:
    assert middle_of(Block(3, 1, 1, Window(1000, 2000, 900, 500))) == Block(3, 1, 1, Window(1150, 2000, 600, 500))


def test_pilot_blocks_lie_all_over() -> None:
    blocks = plan_blocks(Window(0, 0, 10_000, 11_000), 600)
    pilots = spread_out(blocks, 9)
    assert 8 <= len(pilots) <= 12
    rows, cols = {b.row for b in pilots}, {b.col for b in pilots}
    assert max(rows) - min(rows) >= 10
    assert max(cols) - min(cols) >= 10
