"""Trust: where tie points lie, and how many agree by chance."""

from __future__ import annotations

import numpy as np
import pytest

from featreg.geometry import Affine
from featreg.pipeline.trust import Limits
from featreg.pipeline.trust_measures import distinct
from featreg.types import Matches
from made.judged import MATRIX, SHAPE, judge, tie_points


def test_tie_points_of_one_spot_are_not_spread() -> None:
    rng = np.random.default_rng(0)
    here = 300 + rng.normal(0, 12, (200, 2))
    matches = Matches(here, here @ MATRIX[:, :2].T + MATRIX[:, 2] + rng.normal(0, 0.3, here.shape), np.ones(200))
    status, _, gates = judge(matches, np.ones(200, np.bool_), Limits(least_spread=0.2))
    assert status == "unreliable"
    assert not gates["spread"].passed


def test_the_less_of_the_image_holds_tie_points_the_less_one_region_may_move_the_model() -> None:
    matches, good = tie_points()
    narrow = good & (matches.reference_xy[:, 0] < 130)
    limits = Limits()
    for inliers in (good, narrow):
        gates = judge(matches, inliers)[2]
        seen = gates["spread"].value
        assert seen is not None
        assert gates["stability"].high == pytest.approx(
            min(limits.stability_px, limits.stability_by_spread_px * seen), abs=1e-12
        )
    assert (gates["stability"].high or 0) < 0.5 * limits.stability_px
    # Only the matcher's tie points stand where no refinement was asked for.
    assert judge(matches, narrow, refining=False)[2]["stability"].high == limits.stability_px


@pytest.mark.parametrize("length", [20.0, 80.0])
def test_a_strip_of_tie_points_does_not_speak_for_the_rest_of_the_image(length: float) -> None:
    """Smooth errors along a strip of 55 px tilt an affine model; far from it the model is off by many times as much."""
    grid = np.stack(np.meshgrid(np.linspace(0, SHAPE[1] - 1, 9), np.linspace(0, SHAPE[0] - 1, 9)), -1).reshape(-1, 2)
    for seed in range(6):
        rng = np.random.default_rng(seed)
        xy = np.column_stack([rng.uniform(100, 155, 300), rng.uniform(20, 580, 300)])
        wave = rng.normal(0, 0.6, (2, 2, 1)) * [np.cos(xy[:, 1] / length), np.sin(xy.sum(axis=1) / length)]
        there = xy + wave.sum(axis=1).T + rng.normal(0, 0.15, xy.shape)
        matches = Matches(xy, there, np.ones(len(xy)))
        every = np.ones(len(xy), np.bool_)
        status, _, gates = judge(matches, every)
        model = Affine.from_estimate(xy, there)
        assert model
        off = float(np.sqrt(((model(grid) - grid) ** 2).sum(axis=1).mean()))
        stated = gates["uncertainty"].value
        assert stated is not None
        assert status == "unreliable" or off <= 2 * stated


def test_windows_of_the_images_count_against_chance() -> None:
    matches, good = tie_points(good=20, bad=3000)
    alone, confirmed = (judge(matches, good, chance=chance)[2]["significance"] for chance in (0.0, -300.0))
    assert alone.value is not None
    assert -300 < alone.value < 0
    assert confirmed.value == -300


def test_a_few_agreeing_among_many_random_matches_are_chance() -> None:
    matches, good = tie_points(good=9, bad=5000, noise=2.0)
    status, reason, gates = judge(matches, good)
    assert status == "unreliable"
    assert not gates["significance"].passed
    assert "chance" in reason


def test_copies_of_one_tie_point_count_once() -> None:
    here = np.repeat([[100.0, 100.0], [300.0, 200.0]], 50, axis=0)
    assert distinct(here, here) == 2
    assert distinct(here, np.arange(200.0).reshape(100, 2) * 50) == 2
