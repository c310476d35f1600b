"""The main job: match and fit, keyword routing, determinism, masks, budgets, what is known beforehand."""

from __future__ import annotations

import threading
import warnings
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
from featreg.results.registration import Registration
from featreg.simulate import SimulatedPair, sar_pair
from featreg.types import Image, Matches
from made.models import grid_rmse


def run(pair: SimulatedPair, **keywords: Any) -> Registration:
    return featreg.match(pair.reference, pair.secondary, **keywords)


def assert_equal(a: Registration, b: Registration) -> None:
    for name in ("reference_xy", "secondary_xy", "score", "origin"):
        np.testing.assert_array_equal(getattr(a.matches, name), getattr(b.matches, name))
    assert list(a.stages) == list(b.stages)
    for name, mask in a.stages.items():
        np.testing.assert_array_equal(mask, b.stages[name])
    np.testing.assert_array_equal(a.inliers, b.inliers)
    np.testing.assert_array_equal(a.model.matrix, b.model.matrix)
    assert (a.status, a.reason, dict(a.gates)) == (b.status, b.reason, dict(b.gates))


def test_files_that_are_read_side_by_side_leave_warnings_as_they_were(monkeypatch: pytest.MonkeyPatch) -> None:
    """Readers keep quiet what the libraries say, and the second ends after the first."""
    began, both, ended = (threading.Event() for _ in range(3))

    def reading(given: str, *rest: object, **keywords: object) -> None:
        first = given == "a.tif"
        assert first or began.wait(5)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            (began if first else both).set()
            assert (both if first else ended).wait(5)
        ended.set()
        raise InputError(f"{given} is no image")

    monkeypatch.setattr("featreg.matching.small_image", reading)
    before = list(warnings.filters)
    with pytest.raises(InputError, match=r"^a\.tif is no image"):
        featreg.match("a.tif", "b.tif", block=False, threads=2)
    assert warnings.filters == before


# What comes out


@pytest.mark.parametrize("refine", [False, True])
def test_a_pair_is_registered(pair: SimulatedPair, refine: bool) -> None:
    found = run(pair, refine=refine)
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
    plain, refined = run(pair, refine=False), run(pair, refine=True)
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
        found = run(pair, refine=refine)
        final = found.matches.take(found.inliers)
        rms.append(float(np.sqrt((Affine(pair.truth).residuals(final.reference_xy, final.secondary_xy) ** 2).mean())))
    assert rms[1] < 0.75 * rms[0]
    assert rms[1] < 0.4


@pytest.mark.parametrize("n_features", [100, 600])
@pytest.mark.parametrize("method", ["sar-orb", "orb"])
def test_the_budget_holds_for_features_and_final_points(pair: SimulatedPair, method: str, n_features: int) -> None:
    found = run(pair, method=method, n_features=n_features)
    putative = int(found.putative.sum())
    assert 0 < putative <= n_features
    assert found.inliers.sum() <= n_features
    final = found.matches.reference_xy[found.inliers]
    assert len(np.unique(final, axis=0)) == len(final)


def test_the_angle_of_the_model_is_counter_clockwise(pair: SimulatedPair) -> None:
    found = run(pair, model="similarity")
    assert found.model.rotation_deg == pytest.approx(6.0, abs=0.2)
    assert found.model.scale == pytest.approx(1.02, abs=0.003)


# Determinism


@pytest.mark.parametrize("method", ["sar-orb", "sift"])
def test_the_same_seed_gives_the_same_bits(pair: SimulatedPair, method: str) -> None:
    assert_equal(run(pair, method=method, seed=3), run(pair, method=method, seed=3))


@pytest.mark.parametrize("seed", [1, 2, 2**40])
def test_other_seeds_are_as_good(pair: SimulatedPair, seed: int) -> None:
    found = run(pair, seed=seed)
    assert found.status == "ok"
    assert grid_rmse(found, pair.truth) < 0.25
    assert found.provenance["seed"] == seed


def test_the_callers_arrays_are_left_alone(pair: SimulatedPair) -> None:
    arrays = pair.reference.copy(), pair.secondary.copy()
    featreg.match(*arrays)
    np.testing.assert_array_equal(arrays[0], pair.reference)
    assert arrays[0].flags.writeable


# What goes in


@pytest.mark.parametrize("kind", ["uint8", "uint16", "float64", "gain", "complex", "intensity", "db"])
def test_one_scene_in_any_dress_gives_the_same_registration(pair: SimulatedPair, kind: str) -> None:
    rng = np.random.default_rng(0)
    scale = {"intensity": "intensity", "db": "db"}.get(kind)

    def dressed(a: NDArray[np.float32]) -> NDArray[Any]:
        if kind == "uint8":
            return np.clip(np.rint(a * 50), 0, 255).astype(np.uint8)
        if kind == "uint16":
            return np.clip(np.rint(a * 2000), 0, 65535).astype(np.uint16)
        if kind == "complex":
            return np.asarray(a * np.exp(1j * rng.uniform(0, 6.3, a.shape)), np.complex64)
        if kind == "intensity":
            return np.square(a)
        if kind == "db":
            return 20 * np.log10(np.maximum(a, 1e-6))
        return a.astype(np.float64) * (1000 if kind == "gain" else 1)

    plain = run(pair)
    found = featreg.match(dressed(pair.reference), dressed(pair.secondary), scale=scale)
    assert found.status == "ok"
    assert grid_rmse(found, plain.model.matrix[:2]) < 0.1  # type: ignore[index]


def test_different_gains_and_depths_of_the_two_images(pair: SimulatedPair) -> None:
    found = featreg.match((pair.reference * 900).astype(np.uint16), pair.secondary * 1e-4)
    assert found.status == "ok"
    assert grid_rmse(found, pair.truth) < 0.25


def test_nodata_is_kept_clear_of_from_the_gradient_to_the_fit(pair: SimulatedPair) -> None:
    first, second = pair.reference.copy(), pair.secondary.copy()
    first[:90], second[:, 220:] = 0, 0
    found = featreg.match(first, second, nodata=0)
    assert found.status == "ok"
    assert found.matches.reference_xy[:, 1].min() > 90 + 15
    assert found.matches.secondary_xy[:, 0].max() < 220 - 15


def test_masks_are_arrays_or_polygons(pair: SimulatedPair) -> None:
    mask = np.zeros((300, 300), np.bool_)
    mask[:, :200] = True
    by_array = run(pair, reference_mask=mask)
    by_polygon = run(pair, reference_mask=[(-0.5, -0.5), (199.5, -0.5), (199.5, 299.5), (-0.5, 299.5)])
    assert_equal(by_array, by_polygon)
    assert by_array.matches.reference_xy[:, 0].max() < 200 - 15
    assert by_array.matches.secondary_xy[:, 0].max() > 200  # the other image is whole
    other = run(pair, secondary_mask=mask)
    assert other.matches.secondary_xy[:, 0].max() < 200 - 15


def test_images_of_different_sizes(pair: SimulatedPair) -> None:
    found = featreg.match(pair.reference[:240, :280], pair.secondary)
    assert found.status == "ok"
    assert grid_rmse(found, pair.truth, 240) < 0.25


@pytest.mark.parametrize("size", [16, 40, 64])
def test_tiny_images_are_unreliable_with_a_reason(size: int) -> None:
    rng = np.random.default_rng(0)
    found = featreg.match(rng.uniform(1, 2, (size, size)), rng.uniform(1, 2, (size, size)))
    assert found.status == "unreliable"
    assert found.reason


@pytest.mark.parametrize("shape", [(16, 400), (400, 16)])
def test_narrow_images_do_not_break(shape: tuple[int, int]) -> None:
    strip = np.random.default_rng(0).gamma(4, 0.25, shape)
    for method in ("sar-orb", "orb", "sift"):
        found = featreg.match(strip, strip, method=method)
        assert found.status in ("ok", "unreliable")


def test_a_masked_or_switched_off_refinement_still_checks_its_keywords(pair: SimulatedPair) -> None:
    with pytest.raises(ParameterError):
        run(pair, refine=False, half=1)


# Methods as objects


def test_a_matcher_or_a_pipeline_may_stand_for_the_method(pair: SimulatedPair) -> None:
    matcher = FeatureMatcher(
        registry.create("detector", "sar-ofast"),
        registry.create("descriptor", "brief"),
        registry.create("nearest", "brute-force"),
    )
    by_matcher = run(pair, method=matcher)
    assert by_matcher.status == "ok"
    assert by_matcher.provenance["method"] == "FeatureMatcher"
    by_pipeline = run(pair, method=assemble("sar-orb", n_features=700))
    assert_equal(by_pipeline, run(pair, method="sar-orb", n_features=700))
    with pytest.raises(ParameterError, match="alpha"):
        run(pair, method=assemble("sar-orb"), alpha=3.0)
    with pytest.raises(ParameterError, match="model"):
        run(pair, method=assemble("sar-orb"), model="rigid")


class Truth(Matcher):
    """Tie points that follow a given matrix."""

    def __init__(self, truth: NDArray[np.float64], count: int = 200) -> None:
        self.truth, self.count = truth, count

    def match(self, reference: Image, secondary: Image) -> Matches:
        xy = np.random.default_rng(0).uniform(0, 299, (self.count, 2))
        return Matches(xy, xy @ self.truth[:, :2].T + self.truth[:, 2], np.ones(self.count))


def test_any_source_of_tie_points_gets_filters_model_and_trust(pair: SimulatedPair) -> None:
    found = run(pair, method=Truth(pair.truth), refine=False)
    assert found.status == "ok"
    assert grid_rmse(found, pair.truth) < 1e-6
    none = run(pair, method=Truth(pair.truth, 0))
    assert none.status == "unreliable"
    assert len(none.matches) == 0
    assert not none.model


# What is known beforehand


def test_matches_far_from_the_initial_model_are_dropped_first(pair: SimulatedPair) -> None:
    found = run(pair, initial=pair.truth, search_radius=4.0, refine=False)
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
    before = run(pair)
    initial = {"model": before.model, "matrix": before.model.matrix, "registration": before}[form]
    assert run(pair, initial=initial, search_radius=5.0).status == "ok"


def test_a_failed_result_is_no_initial_model(pair: SimulatedPair) -> None:
    failed = run(pair, method=Truth(pair.truth, 0))
    with pytest.raises((ParameterError, InputError)):
        run(pair, initial=failed, search_radius=5.0)


def test_a_wrong_initial_model_gives_no_confident_result(pair: SimulatedPair) -> None:
    found = run(pair, initial=[[1, 0, 80.0], [0, 1, 60.0]], search_radius=3.0)
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
        found = run(made)
        assert found.status == "ok", (angle, found.reason)
        assert grid_rmse(found, made.truth, 400) < 0.3
