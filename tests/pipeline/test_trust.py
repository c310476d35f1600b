"""Trust: every gate by itself."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from featreg.errors import ParameterError
from featreg.geometry import Affine, Homography, Rigid, Translation
from featreg.interfaces import FailedFit
from featreg.pipeline.trust import Evidence, Limits, assess
from featreg.pipeline.trust_measures import distortion
from featreg.types import Gate, Matches
from made.judged import MATRIX, SHAPE, judge, tie_points


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
