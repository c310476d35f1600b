"""scikit-image's detectors, descriptors, RANSAC, phase correlation and optical flow behind our interfaces."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree
from skimage import feature

import featreg
from featreg import registry
from featreg.geometry import Affine, Rigid, as_model
from featreg.interfaces import FilterContext
from featreg.interop.scikit_image import picture
from featreg.io import as_image
from featreg.simulate import SimulatedPair, sar_pair
from featreg.types import Image, Matches

DETECTORS = [name for name in registry.available("detector") if name.startswith("skimage")]
MATCHERS = ("skimage-phase-correlation", "skimage-ilk", "skimage-tvl1")


@pytest.fixture(scope="module")
def small() -> SimulatedPair:
    return sar_pair((320, 320), rotation_deg=3, seed=3)


@pytest.fixture(scope="module")
def moved() -> SimulatedPair:
    return sar_pair((240, 240), rotation_deg=0, scale=1.0, shift=(8.3, -5.6), seed=0)


def test_the_family_is_there() -> None:
    assert len(DETECTORS) == 11
    assert {"skimage-brief", "skimage-daisy"} <= set(registry.available("descriptor"))
    assert "skimage-ransac" in registry.available("filter")
    assert set(MATCHERS) <= set(registry.available("matcher"))


@pytest.mark.parametrize("name", DETECTORS)
def test_a_quarter_turn_turns_points_and_angles(name: str, small: SimulatedPair) -> None:
    """Counter-clockwise as seen: (x, y) goes to (y, W - 1 - x), an angle grows by a quarter."""
    pixels = small.reference[:160, :160]
    detector = registry.create("detector", name, n_features=10000)
    here, there = (detector.detect_features(as_image(a)) for a in (pixels, np.rot90(pixels)))
    assert len(here) > 20
    turned = np.column_stack([here.xy[:, 1], 159 - here.xy[:, 0]])
    distance, rows = cKDTree(there.xy).query(turned)
    near = np.asarray(distance < 1)
    assert near.mean() > 0.9
    np.testing.assert_allclose((there.xy[rows] - turned)[near].mean(axis=0), 0, atol=0.03)
    if name in ("skimage-orb", "skimage-sift"):
        grown = np.mod(there.angle[rows] - here.angle, 2 * np.pi)[near]
        assert np.median(grown) == pytest.approx(np.pi / 2, abs=0.02)


def test_corners_are_those_of_the_library(small: SimulatedPair) -> None:
    image = as_image(small.reference[:120, :120])
    found = registry.create("detector", "skimage-harris", threshold_rel=0.1, min_distance=3).detect_features(image)
    response = feature.corner_harris(picture(image, "auto"), k=0.05, sigma=1)
    wanted = feature.corner_peaks(response, min_distance=3, threshold_rel=0.1, exclude_border=False)
    assert {tuple(p) for p in found.xy.astype(int)} == {tuple(p[::-1]) for p in wanted}


def test_the_descriptors_of_a_point_are_those_of_the_library(small: SimulatedPair) -> None:
    image = as_image(small.reference[:150, :160])
    points = registry.create("detector", "skimage-harris", n_features=40).detect_features(image)
    brief = registry.create("descriptor", "skimage-brief", seed=5).describe_features(image, points)
    oracle = feature.BRIEF(rng=5)
    oracle.extract(picture(image, "auto"), points.xy[:, ::-1])
    np.testing.assert_array_equal(np.unpackbits(np.asarray(brief.descriptors), axis=1), oracle.descriptors)
    daisy = registry.create("descriptor", "skimage-daisy").describe_features(image, points)
    dense = feature.daisy(picture(image, "auto"), step=1)
    column, row = daisy.xy.astype(int).T
    np.testing.assert_allclose(np.asarray(daisy.descriptors), dense[row - 15, column - 15], atol=1e-5)


@pytest.mark.parametrize(
    ("method", "least"),
    [("skimage-orb", 60), ("skimage-sift", 60), ("skimage-censure-brief", 60), ("skimage-daisy", 15)],
)
def test_presets_register_a_pair(method: str, least: int, small: SimulatedPair) -> None:
    reg = featreg.match(small.reference, small.secondary, method=method, n_features=1500, refine=False)
    scores = featreg.evaluate(reg, small.truth)
    assert scores.ncm > least
    assert scores.grid_rmse < 1.0


@pytest.mark.parametrize("name", MATCHERS)
def test_dense_matchers_find_a_shift(name: str, moved: SimulatedPair) -> None:
    found = registry.create("matcher", name).match(as_image(moved.reference), as_image(moved.secondary))
    assert len(found) > 20
    assert (np.diff(found.score) <= 0).all()
    error = found.secondary_xy - as_model(moved.truth)(found.reference_xy)
    assert np.hypot(*np.median(error, axis=0)) < 0.4
    reg = featreg.match(
        moved.reference, moved.secondary, matcher=name, filters=["skimage-ransac"], model="translation", refine=False
    )
    assert reg.model
    assert (
        np.hypot(*(reg.model(np.array([[120.0, 120.0]])) - as_model(moved.truth)(np.array([[120.0, 120.0]])))[0]) < 0.4
    )


@pytest.mark.parametrize("name", MATCHERS)
def test_dense_matchers_stay_off_nodata_and_survive_nothing(name: str, moved: SimulatedPair) -> None:
    mask = np.ones(moved.reference.shape, np.bool_)
    mask[:, :100] = False
    matcher: Any = registry.create("matcher", name)
    found = matcher.match(as_image(moved.reference, mask=mask), as_image(moved.secondary))
    assert len(found) > 0
    assert (found.reference_xy[:, 0] > 99).all()
    tiny = Image(np.ones((12, 12), np.float32), np.ones((12, 12), np.bool_))
    assert len(matcher.match(tiny, tiny)) == 0


def test_ransac_fits_any_model_of_ours_and_draws_from_the_context() -> None:
    rng = np.random.default_rng(0)
    here = rng.uniform(0, 400, (300, 2))
    truth = Rigid(12.0, 5.0, -7.0)
    there = truth(here) + rng.normal(0, 0.3, here.shape)
    there[200:] = rng.uniform(0, 400, (100, 2))
    matches = Matches(here, there, np.ones(300))
    ransac = registry.create("filter", "skimage-ransac")
    for model in (Rigid, Affine):
        masks = [
            ransac.keep(matches, FilterContext((400, 400), (400, 400), model, np.random.default_rng(4)))
            for _ in range(2)
        ]
        np.testing.assert_array_equal(masks[0], masks[1])
        assert masks[0][:200].mean() > 0.97
        assert masks[0][200:].mean() < 0.05
