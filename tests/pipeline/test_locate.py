"""Locating: positions nearer to the truth, wrong matches stay wrong, masks, bridged samples, blocks, files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg.geometry import Affine, Homography
from featreg.interfaces import FailedFit, Model
from featreg.io import as_image
from featreg.pipeline.locate import Locate
from featreg.pipeline.steps import SPREAD, Draft, _distinct_rows, located
from featreg.simulate import SimulatedPair, sar_pair
from featreg.types import Image, Matches


def around(truth: Any, xy: NDArray[np.float64], off: NDArray[np.float64]) -> Matches:
    """Matches that are off by (N, 2) pixels in the secondary."""
    return Matches(xy, Affine(truth)(xy) + off, np.ones(len(xy)))


def spread(count: int = 300, size: int = 300, margin: float = 40.0, seed: int = 3) -> NDArray[np.float64]:
    return np.random.default_rng(seed).uniform(margin, size - margin, (count, 2))


def measured(
    pair: SimulatedPair, matches: Matches, model: Model | None = None, images: tuple[Image, Image] | None = None
) -> Matches:
    images = images or (as_image(pair.reference), as_image(pair.secondary))
    return Locate().run(*images, model or Affine(pair.truth), matches, np.arange(len(matches)))


def errors(found: Matches, truth: Any) -> NDArray[np.float64]:
    return Affine(truth).residuals(found.reference_xy, found.secondary_xy)


@pytest.mark.parametrize("bend", [0.0, 2e-5])
def test_positions_that_are_off_by_a_pixel_or_two_are_found_again(pair: SimulatedPair, bend: float) -> None:
    xy = spread()
    given = around(pair.truth, xy, np.random.default_rng(0).uniform(-2, 2, xy.shape))
    frame = Homography(np.vstack([pair.truth, [0, 0, 1]]) + np.diag([0, 0, 0]) + np.outer([0, 0, 1], [bend, -bend, 0]))
    found = measured(pair, given, frame)
    assert len(found) > 0.85 * len(given)
    assert np.median(errors(found, pair.truth)) < 0.35 < 1.2 < np.median(errors(given, pair.truth))
    np.testing.assert_array_equal(found.reference_xy, given.reference_xy[found.origin])


def test_windows_around_few_matches_say_what_the_whole_images_do(
    pair: SimulatedPair, monkeypatch: pytest.MonkeyPatch
) -> None:
    xy = spread(100)
    given = around(pair.truth, xy, np.random.default_rng(0).uniform(-2, 2, xy.shape))
    found = []
    for windows in (False, True):
        monkeypatch.setattr("featreg.pipeline.locate.few", lambda *_, windows=windows: windows)
        found.append(measured(pair, given))
    assert abs(len(found[0]) - len(found[1])) <= 3
    _, one, other = np.intersect1d(found[0].origin, found[1].origin, return_indices=True)
    off = np.hypot(*(found[0].secondary_xy[one] - found[1].secondary_xy[other]).T)
    assert np.median(off) < 0.02
    assert np.mean(off < 0.1) > 0.95


def test_a_wrong_match_stays_wrong_or_is_left_out(pair: SimulatedPair) -> None:
    """Windows are looked for around the match's own position, not around where the model maps it."""
    xy = spread(margin=60.0)
    given = around(pair.truth, xy, np.tile([8.0, -7.0], (len(xy), 1)))
    found = measured(pair, given)
    assert len(found) < 0.7 * len(given)
    assert errors(found, pair.truth).min() > 3.0
    moved = found.secondary_xy - given.secondary_xy[found.origin]
    assert np.abs(moved).max() < 3 * 1.1 + 1.5


def test_unrelated_images_locate_almost_nothing(pair: SimulatedPair) -> None:
    other = sar_pair((300, 300), seed=9).secondary
    found = measured(
        pair, around(pair.truth, spread(), np.zeros((300, 2))), None, (as_image(pair.reference), as_image(other))
    )
    assert len(found) < 60


def test_errors_are_as_large_as_their_covariances_say() -> None:
    made = sar_pair((500, 500), seed=5)
    xy = spread(600, 500)
    given = around(made.truth, xy, np.random.default_rng(0).normal(0, 0.7, xy.shape))
    everything = np.ones(len(given), np.bool_)
    draft = Draft(given, {"fsc": everything}, everything, everything, everything, Affine(made.truth))
    draft = located(draft, measured(made, given), 5000)
    final = draft.matches.take(np.flatnonzero(draft.inliers))
    assert final.covariance is not None
    error = final.secondary_xy - Affine(made.truth)(final.reference_xy)
    squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(final.covariance), error)
    assert 1.0 < np.median(squared) / np.log(2) < 3.0  # 2 for two Gaussian errors
    assert not isinstance(draft.model, FailedFit)


def test_the_covariance_is_in_the_pixels_of_the_secondary() -> None:
    """Stripes along x fix y alone; where the secondary is turned by 90 degrees they fix x."""
    rng = np.random.default_rng(0)
    stripes = np.exp(np.repeat(rng.normal(0, 1, (200, 1)), 200, axis=1) + rng.normal(0, 0.3, (200, 200)))
    turned = np.ascontiguousarray(np.rot90(stripes))  # out[199 - x, y] = in[y, x]
    model = Affine(np.array([[0.0, 1, 0], [-1, 0, 199]]))
    xy = spread(50, 200, 60.0)
    found = Locate().run(as_image(stripes), as_image(turned), model, Matches(xy, model(xy), np.ones(50)), np.arange(50))
    assert len(found) > 10
    assert found.covariance is not None
    assert (found.covariance[:, 0, 0] < 0.3 * found.covariance[:, 1, 1]).all()


def test_windows_that_are_not_whole_are_not_measured(pair: SimulatedPair) -> None:
    mask = np.ones((300, 300), np.bool_)
    mask[:, 150:] = False
    xy = spread(margin=0.0)
    given = around(pair.truth, xy, np.zeros_like(xy))
    half = measured(pair, given, None, (as_image(pair.reference, mask=mask), as_image(pair.secondary)))
    assert len(half) > 0
    assert half.reference_xy[:, 0].max() < 150 - 14
    half = measured(pair, given, None, (as_image(pair.reference), as_image(pair.secondary, mask=mask)))
    assert len(half) > 0
    assert half.secondary_xy[:, 0].max() < 150 - 14


def test_no_room_and_no_matches_give_nothing(pair: SimulatedPair) -> None:
    small = as_image(pair.reference[:40, :40])
    at = Matches(np.full((1, 2), 20.0), np.full((1, 2), 20.0), np.ones(1))
    assert len(Locate().run(small, small, Affine(np.eye(2, 3)), at, np.arange(1))) == 0
    assert len(measured(pair, Matches.empty())) == 0


def test_the_stage_is_what_nm_is_counted_at_and_can_be_left_out(pair: SimulatedPair) -> None:
    run: Any = {"model": "affine", "seed": 0, "refine": False}
    found = featreg.match(pair.reference, pair.secondary, **run)
    without = featreg.match(pair.reference, pair.secondary, locate=False, **run)
    assert list(without.stages) == ["gms", "fsc"]
    mask, kept = found.stages["locate"], np.flatnonzero(found.stages["gms"])
    assert set(found.matches.origin[mask]) <= set(kept)
    assert mask.sum() > 0.7 * len(kept)
    assert not (mask & found.putative).any()
    np.testing.assert_array_equal(found.putative[: len(without.matches)], without.putative)
    assert (found.inliers & ~mask).sum() == 0
    now, before = (featreg.evaluate(one, pair.truth) for one in (found, without))
    assert (now.stage, before.stage) == ("locate", "gms")
    assert now.ncm > before.ncm
    assert now.precision > before.precision
    assert now.rmse < 0.6 * before.rmse
    assert now.grid_rmse < before.grid_rmse
    assert featreg.evaluate(found, pair.truth, stage="gms").ncm == before.ncm


def test_the_consensus_stays_where_little_is_located(pair: SimulatedPair) -> None:
    every = np.ones(100, np.bool_)
    given = around(pair.truth, spread(100), np.zeros((100, 2)))
    draft = Draft(given, {"fsc": every}, every, every, every, Affine(pair.truth))
    few = Matches(given.reference_xy[:12], given.secondary_xy[:12] + 2.0, np.ones(12), np.tile(np.eye(2), (12, 1, 1)))
    after = located(draft, few, 5000)
    assert after.model is draft.model
    np.testing.assert_array_equal(after.inliers, np.arange(112) < 100)
    assert after.stages["locate"].sum() == 12
    # They are known up to a factor, which no fit has told.
    assert after.matches.covariance is None


def test_blocks_locate_as_whole_images_do_and_keep_it(tmp_path: Path) -> None:
    made = sar_pair((420, 420), rotation_deg=0.3, scale=1.0, shift=(3.0, -2.0), seed=4)
    run: Any = {
        "block": 210, "workers": 1, "initial": np.eye(3), "search_radius": 20.0, "refine": False, "resume": tmp_path,
    }  # fmt: skip
    scene = featreg.match(made.reference, made.secondary, **run)
    assert scene.status == "ok", scene.reason
    assert list(scene.stages)[-1] == "locate"
    mask = scene.stages["locate"]
    came = scene.matches.origin[mask]
    np.testing.assert_array_equal(scene.matches.reference_xy[mask], scene.matches.reference_xy[came])
    assert scene.stages["gms"][came].all()
    owners = scene.provenance["tie_point_blocks"]
    np.testing.assert_array_equal(owners[mask], owners[came])
    assert featreg.evaluate(scene, made.truth).rmse < 0.5
    again = featreg.match(made.reference, made.secondary, **run)
    assert again.provenance["blocks"]["reused"] == 4
    np.testing.assert_array_equal(again.matches.secondary_xy, scene.matches.secondary_xy)
    np.testing.assert_array_equal(again.stages["locate"], mask)


def test_a_result_keeps_it_in_its_file(pair: SimulatedPair, tmp_path: Path) -> None:
    found = featreg.match(pair.reference, pair.secondary, n_features=800)
    found.to_json(tmp_path / "out.json")
    back = featreg.Registration.from_json(tmp_path / "out.json")
    assert list(back.stages) == list(found.stages)
    for name, mask in found.stages.items():
        np.testing.assert_array_equal(back.stages[name], mask)
    np.testing.assert_array_equal(back.putative, found.putative)
    assert "located" in found.explain()


@pytest.mark.parametrize(
    ("xy", "rows"),
    [
        ([], []),
        ([(3, 4), (3, 5), (2, 4)], [0, 1, 2]),
        ([(3, 4), (1, 2), (3, 4), (3, 5), (1, 2)], [0, 1, 3]),
        ([(1, SPREAD), (2, 0), (1, SPREAD)], [0, 1]),  # of one sum
        ([(0.0, -0.0), (-0.0, 0.0)], [0]),
    ],
)
def test_the_first_of_equal_points_stands_for_all(xy: list[tuple[float, float]], rows: list[int]) -> None:
    assert _distinct_rows(np.array(xy, np.float64).reshape(-1, 2)).tolist() == rows


def test_what_can_be_measured_under_an_affine_map_is_what_any_map_says() -> None:
    rng = np.random.default_rng(4)
    model = Affine(np.array([[1.02, -0.03, 9.3], [0.03, 0.99, -4.6]]))
    xy = rng.uniform(-20, 220, (400, 2))
    matches = Matches(xy, model(xy) + rng.uniform(-16, 16, xy.shape), np.ones(400))
    image, rows = as_image(rng.random((190, 210), np.float32)), np.sort(rng.permutation(400)[:300])
    wanted = Locate()._near(image, model, matches, rows)
    assert 30 < len(wanted[2]) < 290
    for one, other in zip(Locate()._near_affine(image, model.matrix[:2], matches, rows), wanted, strict=True):
        np.testing.assert_array_equal(one, other)
    for wrong in ([3, 400], [-1, 3]):
        with pytest.raises(IndexError, match="400 matches"):
            Locate().run(image, image, model, matches, np.array(wrong))
