"""Trust: every gate by itself, what no image pair may pass, and what must pass."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg.errors import ParameterError
from featreg.geometry import Affine, Homography, Rigid, Translation
from featreg.interfaces import FailedFit, Model
from featreg.pipeline.trust import Evidence, Limits, assess
from featreg.pipeline.trust_measures import distinct, distortion
from featreg.simulate import SimulatedPair, sar_pair
from featreg.types import BoolArray, FloatArray, Gate, Matches

Texture = Callable[..., NDArray[np.float32]]
SHAPE = (600, 500)
MATRIX = np.array([[1.02, 0.05, 7.0], [-0.05, 1.01, -4.0]])


def tie_points(good: int = 300, bad: int = 300, noise: float = 0.3, matrix: Any = MATRIX) -> tuple[Matches, BoolArray]:
    rng = np.random.default_rng(0)
    here = rng.uniform(0, 1, (good + bad, 2)) * (SHAPE[1], SHAPE[0])
    there = here @ np.asarray(matrix)[:, :2].T + np.asarray(matrix)[:, 2] + rng.normal(0, noise, here.shape)
    there[good:] = rng.uniform(0, 1, (bad, 2)) * (SHAPE[1], SHAPE[0])
    return Matches(here, there, np.ones(good + bad)), np.arange(good + bad) < good


def judge(
    matches: Matches, inliers: BoolArray, limits: Limits | None = None, **more: Any
) -> tuple[str, str, Mapping[str, Gate]]:
    fitted = Affine.from_estimate(matches.reference_xy[inliers], matches.secondary_xy[inliers])
    model: Model | FailedFit = more.pop("model", fitted)
    every = np.ones(len(matches), np.bool_)
    return assess(Evidence(matches, every, inliers, inliers, model, SHAPE, SHAPE, **more), limits or Limits())


def test_good_tie_points_pass_every_gate() -> None:
    status, reason, gates = judge(*tie_points())
    assert (status, reason) == ("ok", "")
    assert gates
    assert all(g.passed and g.value is not None and g.meaning for g in gates.values())


@pytest.mark.parametrize(
    ("gate", "limits"),
    [
        ("inliers", {"least_inliers": 10**6}),
        ("spread", {"least_spread": 1.1}),
        ("significance", {"significance": -1e9}),
        ("held_out", {"held_out_px": 1e-6}),
        ("uncertainty", {"uncertainty_px": 1e-6}),
        ("stability", {"stability_px": 1e-6}),
        ("scale", {"scale": 1.0001}),
        ("anisotropy", {"anisotropy": 1.0}),
        ("dilution", {"dilution": 1e-6}),
    ],
)
def test_each_gate_that_fails_alone_is_named(gate: str, limits: dict[str, Any]) -> None:
    status, reason, gates = judge(*tie_points(), Limits(**limits))
    assert status == "unreliable"
    assert [name for name, g in gates.items() if not g.passed] == [gate]
    assert reason.startswith(gate)
    assert gates[gate].meaning in reason
    assert ";" not in reason


def test_a_rigid_model_of_stretched_tie_points_is_distorted() -> None:
    """By e along x: half of it is zoom, which a rigid model has not either."""
    rng, e = np.random.default_rng(1), 0.004
    here = rng.uniform(0, 1, (400, 2)) * (SHAPE[1], SHAPE[0])
    for stretch, expected in ((e, e * SHAPE[1] / math.sqrt(12)), (0.0, 0.0)):
        there = Rigid(5.0)(here) * [1 + stretch, 1.0] + rng.normal(0, 0.1, here.shape)
        model = Rigid.from_estimate(here, there)
        assert model
        assert distortion(model, here, there, SHAPE) == pytest.approx(expected, abs=0.08)
        status, reason, gates = judge(
            Matches(here, there, np.ones(400)), np.ones(400, np.bool_), Limits(distortion_px=0.3), model=model
        )
        assert (status == "ok") == (stretch == 0)
        assert reason.startswith("distortion") == (stretch != 0)
        assert gates["distortion"].value is not None
    # An affine model holds it.
    assert "distortion" not in judge(*tie_points(), Limits(distortion_px=0.3))[2]


@pytest.mark.parametrize("refined", [True, False])
def test_halves_are_judged_before_the_last_fit_chose_and_can_fail(refined: bool) -> None:
    """Regions that move by 12 px against their neighbours, of which a model keeps what lies within 1 px of it."""
    rng = np.random.default_rng(2)
    here = rng.uniform(0, 1, (800, 2)) * (SHAPE[1], SHAPE[0])
    board = (here / (SHAPE[1] / 4, SHAPE[0] / 4)).astype(int).sum(axis=1) % 2
    there = here @ MATRIX[:, :2].T + MATRIX[:, 2] + rng.normal(0, 0.2, here.shape)
    there[:, 0] += 12.0 * board
    model = Affine(MATRIX)
    measured = Matches(here, there, np.ones(800))
    kept = model.residuals(here, there) <= 1
    every = np.ones(800, np.bool_)
    evidence = Evidence(measured, every, every, kept, model, SHAPE, SHAPE, measured=measured if refined else None)
    if refined:  # the tie points themselves are those within 1 px
        few = measured.take(np.flatnonzero(kept))
        every = np.ones(len(few), np.bool_)
        evidence = Evidence(few, every, every, every, model, SHAPE, SHAPE, measured=measured)
    gate = assess(evidence, Limits())[2]["held_out"]
    assert gate.value == pytest.approx(12, abs=1)
    assert not gate.passed


def test_what_a_freer_model_does_beyond_the_model_is_part_of_its_error() -> None:
    """A stretch by e that a rigid fit to the middle cannot hold; none where the model is right."""
    rng, e = np.random.default_rng(3), 0.01
    here = rng.uniform(0, 1, (600, 2)) * (SHAPE[1], SHAPE[0])
    for stretch in (0.0, e):
        there = (here - 250) * [1 + stretch, 1.0] + 250 + rng.normal(0, 0.3, here.shape)
        model = Rigid(0.0)
        near = model.residuals(here, there) <= 1
        every = np.ones(600, np.bool_)
        found = Evidence(Matches(here, there, np.ones(600)), every, every, near, model, SHAPE, SHAPE)
        _, _, gates = assess(found, Limits())
        value = gates["uncertainty"].value
        assert value is not None
        assert value == pytest.approx(e * SHAPE[1] / math.sqrt(12) if stretch else 0.0, rel=0.6, abs=0.08)


def test_every_failing_gate_is_named() -> None:
    _, reason, gates = judge(*tie_points(), Limits(least_inliers=10**6, anisotropy=1.0))
    assert {n for n, g in gates.items() if not g.passed} == {"inliers", "anisotropy"}
    assert "inliers" in reason
    assert "anisotropy" in reason


def test_the_gates_stand_in_their_order_and_those_without_a_limit_are_left_out() -> None:
    names = ["inliers", "spread", "significance", "held_out", "uncertainty", "stability"]
    linear = ["determinant", "scale", "anisotropy"]
    points = tie_points()
    assert list(judge(*points)[2]) == [*names, *linear]
    every = Limits(distortion_px=9.0, dilution=9.0)
    further = {"blocks": Gate(0.0, low=0.1, meaning="share")}
    model = Rigid.from_estimate(points[0].reference_xy[points[1]], points[0].secondary_xy[points[1]])
    evidence = Evidence(points[0], points[1], points[1], points[1], model, SHAPE, SHAPE, Affine(MATRIX), 50.0)
    status, reason, gates = assess(evidence, every, further)
    assert list(gates) == [*names, "distortion", "dilution", *linear, "prior", "blocks"]
    assert status == "unreliable"
    assert reason.endswith("; blocks 0 is below 0.1 (share)")
    assert (gates["scale"].low, gates["scale"].high) == (1 / 2.5, 2.5)


@pytest.mark.parametrize(
    "limits", [{"held_out_px": math.nan}, {"least_spread": math.inf}, {"significance": -math.inf}, {"scale": 0.5}]
)
def test_a_limit_that_nothing_can_meet_is_refused(limits: dict[str, Any]) -> None:
    with pytest.raises(ParameterError, match=next(iter(limits))):
        Limits(**limits)
    Limits(held_out_px=math.inf, least_spread=-math.inf)


def test_a_model_far_from_the_prior_is_unreliable() -> None:
    points = tie_points()
    assert judge(*points, initial=Affine(MATRIX), search_radius=5.0)[0] == "ok"
    status, reason, gates = judge(*points, initial=Translation(60.0, 0.0), search_radius=5.0)
    assert status == "unreliable"
    assert reason.startswith("prior")
    assert [name for name, g in gates.items() if not g.passed] == ["prior"]


def test_a_failed_fit_is_unreliable_with_its_reason() -> None:
    matches, good = tie_points()
    status, reason, gates = judge(matches, good, model=FailedFit("the points lie on a line"))
    assert status == "unreliable"
    assert "the points lie on a line" in reason
    assert not gates


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


def test_a_mirror_image_is_unreliable_and_says_so() -> None:
    matches, good = tie_points(matrix=[[-1.0, 0, 499.0], [0, 1.0, 0]])
    status, reason, gates = judge(matches, good)
    assert status == "unreliable"
    assert "mirror" in reason
    assert [name for name, g in gates.items() if not g.passed] == ["determinant"]


def test_no_inliers_are_unreliable() -> None:
    matches, good = tie_points()
    status, reason, _ = judge(matches, np.zeros_like(good), model=Affine(MATRIX))
    assert status == "unreliable"
    assert reason


def test_values_that_cannot_be_told_fail_their_gate() -> None:
    matches, _ = tie_points()
    few = np.arange(len(matches)) < 4
    _, _, gates = judge(matches, few, model=Homography(np.eye(3)))
    assert gates["held_out"].value is None
    assert not gates["held_out"].passed
    assert all(g.value is None or math.isfinite(g.value) for g in gates.values())


# Whole registrations


def corner_error(model: Any, truth: FloatArray, size: int) -> float:
    corners = np.array([[0.0, 0], [size - 1, 0], [0, size - 1], [size - 1, size - 1]])
    return float(np.abs(model(corners) - corners @ truth[:, :2].T - truth[:, 2]).max())


@pytest.mark.parametrize("method", ["sar-orb", "orb"])
@pytest.mark.parametrize("seed", range(2))
def test_unrelated_images_are_unreliable_with_a_reason(method: str, seed: int) -> None:
    one, other = sar_pair((256, 256), seed=10 + seed), sar_pair((256, 256), seed=20 + seed)
    found = featreg.match(one.reference, other.secondary, method=method)
    assert found.status == "unreliable"
    assert found.reason


@pytest.mark.slow
def test_none_of_two_hundred_unrelated_crops_is_trusted() -> None:
    rng = np.random.default_rng(0)
    scenes = [sar_pair((500, 500), seed=100 + i).reference for i in range(6)]
    trusted = []
    for _ in range(200):
        i, j = rng.choice(6, 2, replace=False)
        size = int(rng.integers(100, 400))
        crops = []
        for k in (i, j):
            y, x = rng.integers(0, 500 - size, 2)
            crops.append(scenes[k][y : y + size, x : x + size])
        found = featreg.match(*crops)
        assert found.status == "ok" or found.reason
        trusted.append(found.status == "ok")
    assert sum(trusted) == 0


def test_an_image_and_itself_are_ok(sar_texture: Texture) -> None:
    amplitude = sar_texture(256, 256)
    found = featreg.match(amplitude, amplitude.copy())
    assert found.status == "ok"
    assert corner_error(found.model, np.eye(3)[:2], 256) < 0.02


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("method", ["sar-orb", "sift"])
def test_a_mirrored_secondary_is_unreliable(pair: SimulatedPair, method: str, axis: int) -> None:
    assert featreg.match(pair.reference, np.flip(pair.secondary, axis), method=method).status == "unreliable"


@pytest.mark.parametrize("seed", range(3))
def test_a_pair_of_one_scene_is_ok_and_right(seed: int) -> None:
    made = sar_pair((300, 300), seed=30 + seed, rotation_deg=[-12.0, 4.0, 18.0][seed], scale=[0.95, 1.0, 1.06][seed])
    found = featreg.match(made.reference, made.secondary)
    assert found.status == "ok", found.reason
    assert corner_error(found.model, made.truth, 300) < 0.5
