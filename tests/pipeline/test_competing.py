"""Trust where images agree without showing one scene under one model: nothing there is "ok", no right one is lost."""

from __future__ import annotations

import re

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import featreg
from featreg.geometry import Affine, Translation
from featreg.io import as_image
from featreg.pipeline.agreement import Agreement
from featreg.pipeline.competing import agreement_gates, rival_gate
from featreg.pipeline.steps import Draft
from featreg.pipeline.structure import structural_drift
from featreg.pipeline.trust import Limits
from featreg.types import Matches
from made.patchy_ground import SIDE, marked, patchy_ground, seen


def number(text: str, reason: str) -> float:
    found = re.search(rf"{text} ([+-]?[\d.]+)", reason)
    assert found, reason
    return float(found.group(1))


@pytest.mark.parametrize("method", ["sar-orb", "rift"])
def test_half_of_the_scene_moved_is_two_motions(method: str) -> None:
    ground = patchy_ground(5)
    moved = ground.copy()
    moved[:, 200:] = np.roll(ground, 8, 0)[:, 200:]
    result = featreg.match(seen(ground, 1), seen(moved, 2), method=method)
    assert result.status == "unreliable"
    words = next(part for part in result.reason.split("; ") if "two motions" in part)
    points = number("two motions,", words)
    assert 100 < points <= len(result.matches)
    # Either half may be the one that the words call moved.
    sign = 1 if "right part" in words else -1
    assert ("left part" in words) == (sign < 0)
    assert number("dx", words) == pytest.approx(0, abs=1)
    assert number("dy", words) == pytest.approx(sign * 8, abs=1)


def test_a_small_part_that_moved_leaves_the_model_and_is_told() -> None:
    ground = patchy_ground(5)
    moved = ground.copy()
    moved[250:330, 200:300] = np.roll(ground, 8, 0)[250:330, 200:300]
    result = featreg.match(seen(ground, 1), seen(moved, 2))
    assert result.status == "ok"
    assert result.gates["local"].value is not None
    assert result.model
    assert result.model(np.array([[150.0, 150.0]]))[0] == pytest.approx([150, 150], abs=0.3)
    assert result.gates["rival"].value == pytest.approx(0.05, abs=0.05)
    assert "agree on another model" in result.gates["rival"].meaning


@pytest.mark.parametrize("method", ["sar-orb", "sift"])
def test_two_scenes_in_one_exposure_are_rivals(method: str) -> None:
    ground = patchy_ground(6)
    both = 0.5 * ground + 0.5 * np.roll(ground, (24, 18), (0, 1))
    result = featreg.match(seen(ground, 1), seen(np.asarray(both, np.float32), 2), method=method)
    assert result.status == "unreliable"


@pytest.mark.parametrize(("period", "most"), [(25, 600), (40, 600), (40, 50)])
def test_a_scene_that_repeats_has_no_one_model(period: int, most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Judged by the images themselves: matchers mostly find no consensus here in the first place."""
    tile = gaussian_filter(np.random.default_rng(7).uniform(20, 160, (period, period)), 2, mode="wrap")
    ground = np.tile(tile, (SIDE // period + 1,) * 2)[:SIDE, :SIDE].astype(np.float32)
    a, b = seen(ground, 1), seen(np.roll(ground, period, 0), 2)
    # Larger images than so many samples are looked at by coarser ones.
    monkeypatch.setattr("featreg.pipeline.agreement.MOST_WHOLE", most)
    agreement = Agreement.of(as_image(a), as_image(b), Translation(0, 0))
    assert agreement is not None
    model, other, shift, _ = agreement.whole
    assert other > 0.7 * model
    assert min(abs(abs(s) % period - p) for s in shift for p in (0, period)) < (5 if most == 600 else 9)
    assert featreg.match(a, b).status == "unreliable"


@pytest.mark.parametrize("method", ["rift", "rift-paper", "sar-orb"])
def test_one_ringing_spot_is_one_tie_point(method: str) -> None:
    spot = np.full((200, 200), 7, np.uint8)
    spot[100:103, 90:93] = 70
    result = featreg.match(spot, np.roll(spot, (3, 5), (0, 1)), method=method)
    if result.status == "ok":
        assert result.model
        assert result.model(np.array([[91.0, 101.0], [20, 20]])) == pytest.approx(
            np.array([[96, 104], [25, 23]]), abs=1
        )


@pytest.mark.parametrize("ships", [1, 2, 6])
@pytest.mark.parametrize("method", ["rift", "rift-paper"])
def test_ships_on_a_quiet_sea_are_few_tie_points(method: str, ships: int) -> None:
    """Samples of a few grey levels: the ringing around each ship is everywhere, and half a turn leaves it the same."""
    rng = np.random.default_rng(ships)
    images = []
    centres = rng.integers(30, 170, (ships, 2))
    for dx, dy in ((0, 0), (5, 3)):
        sea = np.rint(6 * np.sqrt(rng.gamma(30, 1 / 30, (200, 200)))).astype(np.uint8)
        for x, y in centres:
            cv2.rectangle(sea, (int(x) + dx, int(y) + dy), (int(x) + dx + 3, int(y) + dy + 2), 70, -1)
        images.append(sea)
    result = featreg.match(*images, method=method)
    if result.status == "ok":
        assert result.model
        here = np.array([[20.0, 20], [180, 20], [100, 180]])
        assert result.model(here) == pytest.approx(here + np.array([5, 3]), abs=1)


def test_where_the_refinement_found_nothing_less_may_speak_against_a_model() -> None:
    ground = patchy_ground(5)
    moved = ground.copy()
    moved[60:160, 60:160] = np.roll(ground, 8, 0)[60:160, 60:160]
    a, b = as_image(seen(ground, 1)), as_image(seen(moved, 2))
    rng = np.random.default_rng(0)
    here = rng.uniform(10, 390, (300, 2))
    matches = Matches(here, here, np.ones(300))
    every = np.ones(300, np.bool_)
    limits = Limits()
    for useful in (True, False):
        stages = {"fsc": every, "refine": every & useful}
        draft = Draft(matches, stages, every, every, every, Translation(0, 0))
        gates, _ = agreement_gates(draft, a, b, limits, refined=useful)
        share = 1.0 if useful else 0.5
        assert gates["local"].high == share * limits.local
        assert ("the refinement found nothing" in gates["local"].meaning) == (not useful)
        assert rival_gate(draft, (a.shape, b.shape), limits, 0)["rival"].high == share * limits.rival
        assert gates["local"].value is not None
        assert gates["local"].value > 0.05


@pytest.mark.parametrize("seed", [1, 2])
def test_relief_under_an_affine_model_is_named_with_its_cures(seed: int) -> None:
    rng = np.random.default_rng(seed)
    bend = [gaussian_filter(rng.normal(0, 1, (SIDE, SIDE)), 40, mode="wrap") for _ in range(2)]
    dx, dy = (amplitude * f / np.abs(f).max() for amplitude, f in zip((10, 3), bend, strict=True))
    y, x = np.mgrid[0:SIDE, 0:SIDE]
    ground = patchy_ground(8)
    at = [(grid + by).astype(np.float32) for grid, by in ((x, dx), (y, dy))]
    warped = cv2.remap(ground, at[0], at[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    result = featreg.match(seen(ground, 1, 8), seen(np.asarray(warped, np.float32), 2, 8))
    assert result.status == "unreliable"
    assert "local" in result.reason
    assert all(word in result.reason for word in ("relief", "residual-field", "rpc-bias", "blocks"))


@pytest.mark.parametrize(
    "case", ["itself", "crop", "shifted", "fresh speckle", "labelled", "labelled and shifted", "dead"]
)
def test_images_of_one_scene_stay_ok(case: str) -> None:
    ground = patchy_ground(9, 460)
    first = seen(ground, 1)
    here = first[:SIDE, :SIDE]
    there, shift = {
        "itself": (here, (0, 0)),
        "crop": (here[40:340, 60:380], (-60, -40)),
        "shifted": (first[17 : SIDE + 17, 23 : SIDE + 23], (-23, -17)),
        "fresh speckle": (seen(ground, 2)[:SIDE, :SIDE], (0, 0)),
        "labelled": (seen(ground, 2)[:SIDE, :SIDE], (0, 0)),
        "labelled and shifted": (seen(ground, 2)[37 : SIDE + 37, 43 : SIDE + 43], (-43, -37)),
        "dead": (seen(ground, 2)[17 : SIDE + 17, 23 : SIDE + 23], (-23, -17)),
    }[case]
    if "label" in case or case == "dead":
        mark = marked("legend") if "label" in case else np.random.default_rng(4).random((SIDE, SIDE)) < 0.004
        here, there = (np.where(mark, np.float32(900), image) for image in (here, there))
    result = featreg.match(here, np.ascontiguousarray(there))
    assert result.status == "ok", result.reason
    assert result.model
    assert result.model(np.array([[150.0, 150.0]]))[0] - [150, 150] == pytest.approx(shift, abs=0.3)


def test_windows_that_drift_together_tell_a_model_that_is_right_in_one_part_only() -> None:
    ground = patchy_ground(10)
    a, b = as_image(seen(ground, 1)), as_image(seen(ground, 2))
    # A stretch of 3 % about (80, 80), where it is right.
    stretched = Affine(np.array([[1.03, 0.0, -0.03 * 80], [0.0, 1.03, -0.03 * 80]]))
    right, wrong, other = (Agreement.of(a, b, model) for model in (Translation(0, 0), stretched, Translation(40, 30)))
    assert right
    assert wrong
    assert other
    here = wrong.windows.xy[wrong.windows.peaked]
    expected = np.sqrt(((stretched(here) - here) ** 2).sum(axis=1).mean()) / 1.03
    assert expected > 4
    assert wrong.windows.drift == pytest.approx(expected, rel=0.1)
    assert right.windows.drift == pytest.approx(0, abs=0.3)
    assert right.windows.log10_chance(6) < -20
    assert other.windows.log10_chance(6) > -2
    # The more a model can do, the more windows follow one by chance.
    assert right.windows.log10_chance(12) > right.windows.log10_chance(6)


def test_structure_tells_how_far_a_model_is_off_where_intensities_cannot_be_compared() -> None:
    ground = patchy_ground(10)
    smooth = gaussian_filter(ground, 2)
    # Bright is dark, as between sensors of another kind.
    a, b = as_image(seen(ground, 1)), as_image(np.float32(smooth.mean() ** 2) / (smooth + 0.1 * smooth.mean()))
    right, turned = Affine(np.eye(3)[:2]), Affine(np.array([[1.0, -0.03, 0.03 * 199.5], [0.03, 1.0, -0.03 * 199.5]]))
    there = structural_drift(a, b, right)
    away = structural_drift(a, b, turned)
    assert there is not None
    assert away is not None
    assert there[1] == pytest.approx(SIDE / 256, rel=0.01)
    assert there[0] < there[1]
    x, y = np.meshgrid(np.linspace(30, 370, 9), np.linspace(30, 370, 9))
    grid = np.column_stack([x.ravel(), y.ravel()])
    expected = np.sqrt(((turned(grid) - grid) ** 2).sum(axis=1).mean())
    assert away[0] == pytest.approx(expected, rel=0.25)
    assert structural_drift(a, b, Translation(390, 0)) is None

    rng = np.random.default_rng(0)
    here, every = rng.uniform(10, 390, (300, 2)), np.ones(300, np.bool_)
    for model, passed in ((right, True), (turned, False)):
        draft = Draft(Matches(here, model(here), np.ones(300)), {"fsc": every}, every, every, every, model)
        gate = agreement_gates(draft, a, b, Limits(structure_px=3.0))[0]["structure"]
        assert gate.passed is passed
        assert gate.high == pytest.approx(3.0 * there[1], rel=0.01)
    assert "structure" not in agreement_gates(draft, a, b, Limits())[0]
