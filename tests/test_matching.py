"""The main job: what comes out, determinism, methods as objects, what is known beforehand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg import registry
from featreg.errors import InputError, ParameterError
from featreg.geometry import Affine
from featreg.interfaces import Matcher
from featreg.pipeline.assembly import assemble
from featreg.pipeline.feature_matcher import FeatureMatcher
from featreg.simulate import SimulatedPair, sar_pair
from featreg.types import Image, Matches
from made.matched import assert_same_bits, matched
from made.models import grid_rmse

# What comes out


@pytest.mark.parametrize("refine", [False, True])
def test_a_pair_is_registered(pair: SimulatedPair, refine: bool) -> None:
    found = matched(pair, refine=refine)
    assert found.status == "ok", found.reason
    assert grid_rmse(found, pair.truth) < (0.25 if refine else 0.6)
    assert list(found.stages) == ["gms", "fsc", "locate", *(["refine"] if refine else [])]
    assert not (found.stages["fsc"] & ~found.stages["gms"]).any()
    assert {"read", "detect", "describe", "match", "gms", "fsc", "model", "trust"} <= set(found.timings)
    assert all(seconds >= 0 for seconds in found.timings.values())
    assert found.provenance["seed"] == 0
    assert found.reference is not None
    assert (found.reference.path, found.reference.shape) == ("array", (300, 300))


def test_refinement_appends_rows_and_moves_none(pair: SimulatedPair) -> None:
    plain, refined = matched(pair, refine=False), matched(pair, refine=True)
    m = len(plain.matches)
    np.testing.assert_array_equal(refined.matches.reference_xy[:m], plain.matches.reference_xy)
    np.testing.assert_array_equal(refined.matches.secondary_xy[:m], plain.matches.secondary_xy)
    added = refined.stages["refine"]
    assert added[m:].all()
    assert not added[:m].any()
    np.testing.assert_array_equal(refined.stages["locate"][:m], plain.stages["locate"])
    assert not refined.stages["fsc"][m:].any()
    np.testing.assert_array_equal(refined.stages["gms"][:m], plain.stages["gms"])
    came = refined.matches.origin[m:]
    assert came.max() < m
    assert refined.matches.covariance is not None
    assert np.isfinite(refined.matches.covariance[m:]).all()


def test_refined_tie_points_are_better_than_plain_ones(pair: SimulatedPair) -> None:
    rms = []
    for refine in (False, True):
        found = matched(pair, refine=refine)
        final = found.matches.take(found.inliers)
        rms.append(float(np.sqrt((Affine(pair.truth).residuals(final.reference_xy, final.secondary_xy) ** 2).mean())))
    assert rms[1] < 0.75 * rms[0]
    assert rms[1] < 0.4


@pytest.mark.parametrize("n_features", [100, 600])
@pytest.mark.parametrize("method", ["sar-orb", "orb"])
def test_the_budget_holds_for_features_and_final_points(pair: SimulatedPair, method: str, n_features: int) -> None:
    found = matched(pair, method=method, n_features=n_features)
    putative = int(found.putative.sum())
    assert 0 < putative <= n_features
    assert found.inliers.sum() <= n_features
    final = found.matches.reference_xy[found.inliers]
    assert len(np.unique(final, axis=0)) == len(final)


def test_the_angle_of_the_model_is_counter_clockwise(pair: SimulatedPair) -> None:
    found = matched(pair, model="similarity")
    assert found.model.rotation_deg == pytest.approx(6.0, abs=0.2)
    assert found.model.scale == pytest.approx(1.02, abs=0.003)


# Determinism


@pytest.mark.parametrize("method", ["sar-orb", "sift"])
def test_the_same_seed_gives_the_same_bits(pair: SimulatedPair, method: str) -> None:
    assert_same_bits(matched(pair, method=method, seed=3), matched(pair, method=method, seed=3))


@pytest.mark.parametrize("seed", [1, 2, 2**40])
def test_other_seeds_are_as_good(pair: SimulatedPair, seed: int) -> None:
    found = matched(pair, seed=seed)
    assert found.status == "ok"
    assert grid_rmse(found, pair.truth) < 0.25
    assert found.provenance["seed"] == seed


# What goes in


def test_a_masked_or_switched_off_refinement_still_checks_its_keywords(pair: SimulatedPair) -> None:
    with pytest.raises(ParameterError):
        matched(pair, refine=False, half=1)


# Methods as objects


def test_a_matcher_or_a_pipeline_may_stand_for_the_method(pair: SimulatedPair) -> None:
    matcher = FeatureMatcher(
        registry.create("detector", "sar-ofast"),
        registry.create("descriptor", "brief"),
        registry.create("nearest", "brute-force"),
    )
    by_matcher = matched(pair, method=matcher)
    assert by_matcher.status == "ok"
    assert by_matcher.provenance["method"] == "FeatureMatcher"
    by_pipeline = matched(pair, method=assemble("sar-orb", n_features=700))
    assert_same_bits(by_pipeline, matched(pair, method="sar-orb", n_features=700))
    with pytest.raises(ParameterError, match="alpha"):
        matched(pair, method=assemble("sar-orb"), alpha=3.0)
    with pytest.raises(ParameterError, match="model"):
        matched(pair, method=assemble("sar-orb"), model="rigid")


class Truth(Matcher):
    """Tie points that follow a given matrix."""

    def __init__(self, truth: NDArray[np.float64], count: int = 200) -> None:
        self.truth, self.count = truth, count

    def match(self, reference: Image, secondary: Image) -> Matches:
        xy = np.random.default_rng(0).uniform(0, 299, (self.count, 2))
        return Matches(xy, xy @ self.truth[:, :2].T + self.truth[:, 2], np.ones(self.count))


def test_any_source_of_tie_points_gets_filters_model_and_trust(pair: SimulatedPair) -> None:
    found = matched(pair, method=Truth(pair.truth), refine=False)
    assert found.status == "ok"
    assert grid_rmse(found, pair.truth) < 1e-6
    none = matched(pair, method=Truth(pair.truth, 0))
    assert none.status == "unreliable"
    assert len(none.matches) == 0
    assert not none.model


# What is known beforehand


def test_matches_far_from_the_initial_model_are_dropped_first(pair: SimulatedPair) -> None:
    found = matched(pair, initial=pair.truth, search_radius=4.0, refine=False)
    assert next(iter(found.stages)) == "initial"
    known = Affine(pair.truth)
    distance = known.residuals(found.matches.reference_xy, found.matches.secondary_xy)
    np.testing.assert_array_equal(found.stages["initial"], (distance <= 4.0) & found.putative)
    # Only what survived is measured again.
    assert found.stages["initial"][found.matches.origin[found.stages["locate"]]].all()
    assert found.status == "ok"
    assert "prior" in found.gates


@pytest.mark.parametrize("form", ["model", "matrix", "registration"])
def test_initial_may_be_a_model_a_matrix_or_a_result(pair: SimulatedPair, form: str) -> None:
    before = matched(pair)
    initial = {"model": before.model, "matrix": before.model.matrix, "registration": before}[form]
    assert matched(pair, initial=initial, search_radius=5.0).status == "ok"


def test_a_failed_result_is_no_initial_model(pair: SimulatedPair) -> None:
    failed = matched(pair, method=Truth(pair.truth, 0))
    with pytest.raises((ParameterError, InputError)):
        matched(pair, initial=failed, search_radius=5.0)


def test_a_wrong_initial_model_gives_no_confident_result(pair: SimulatedPair) -> None:
    found = matched(pair, initial=[[1, 0, 80.0], [0, 1, 60.0]], search_radius=3.0)
    assert found.status == "unreliable"


# Real images


@pytest.mark.realdata
@pytest.mark.slow
@pytest.mark.parametrize("name", ["a", "h"])
def test_real_pairs_turned_by_eighteen_degrees(realdata: Path, name: str) -> None:
    files = sorted((realdata / "two_view").glob(f"{name}*"))
    assert len(files) >= 2, files
    found = featreg.match(files[0], files[1])
    assert found.status == "ok", found.reason


@pytest.mark.realdata
@pytest.mark.slow
@pytest.mark.parametrize("name", ["bern", "ottawa", "san"])
def test_real_images_warped_by_an_affine(realdata: Path, name: str) -> None:
    import cv2

    image: Any = cv2.imread(str(realdata / "bitemporal" / f"{name}_1.bmp"), cv2.IMREAD_GRAYSCALE)
    height, width = image.shape
    matrix: Any = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), 17.0, 1.08)
    warped = cv2.warpAffine(image, matrix, (width, height), flags=cv2.INTER_LINEAR)
    found = featreg.match(image, warped)
    assert found.status == "ok", found.reason
    assert grid_rmse(found, matrix, min(image.shape)) < 0.3


@pytest.mark.slow
def test_a_turn_of_any_size_is_registered() -> None:
    for angle in (-170.0, -95.0, 45.0, 90.0, 180.0):
        made = sar_pair((400, 400), rotation_deg=angle, seed=7)
        found = matched(made)
        assert found.status == "ok", (angle, found.reason)
        assert grid_rmse(found, made.truth, 400) < 0.3
