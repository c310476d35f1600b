"""What a scene's result says of itself: points at the rims of blocks are seen whole, and wrong models are found out."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg.errors import ParameterError
from featreg.geometry import Affine, Translation, prediction_covariance, refitted_covariance
from featreg.interfaces import REACH, Matcher
from featreg.io import as_image
from featreg.pipeline.assembly import assemble
from featreg.pipeline.feature_matcher import FeatureMatcher
from featreg.pipeline.refine import Refine
from featreg.results.registration import Registration
from featreg.scene.blocks import halo_of
from featreg.scene.merge import Merged, _together, block_errors
from featreg.simulate.scene import simulate_scene
from featreg.types import Image, Matches
from made.scene_results import BLOCK


class Blind(Matcher):
    """Finds nothing, and does not say how far it looks."""

    def match(self, reference: Image, secondary: Image) -> Matches:
        return Matches.empty()


def _matcher(method: str) -> Matcher:
    matcher = assemble(method).matcher
    assert matcher is not None
    return matcher


# ---------------------------------------------------------------- halo


METHODS = ["sar-orb", "sar-orb-paper", "sar-sift", "s-gof", "m-gof", "bfsift", "rift"]


@pytest.mark.parametrize("method", METHODS)
def test_the_halo_holds_the_support_of_every_keypoint(method: str, sar_texture: Any) -> None:
    """Detectors leave out what lies too near to the border: with the halo, nothing of a block is left out."""
    pipeline = assemble(method)
    matcher = pipeline.matcher
    assert isinstance(matcher, FeatureMatcher)
    assert matcher.descriptor is not None
    halo = halo_of(matcher, pipeline.refine)
    image = as_image(sar_texture(400, 420, seed=5))
    found = matcher.detector.detect_features(image)
    assert found.scale.max() <= matcher.detector.reach <= halo
    described = matcher.descriptor.describe_features(image, found)
    lost = np.setdiff1d(np.arange(len(found)), np.arange(len(found)) if described.index is None else described.index)
    room = np.minimum(found.xy, np.array(image.shape[::-1]) - 1 - found.xy).min(axis=1)
    assert not (room[lost] > halo).any()


def test_the_halo_grows_with_the_support_and_is_wide_where_none_is_stated() -> None:
    assert halo_of(_matcher("sar-orb"), None) == 64
    assert halo_of(_matcher("sar-orb-paper"), None) > 64
    assert halo_of(Blind(), None) == REACH
    assert halo_of(_matcher("sar-orb"), Refine(half=60)) >= 60


def test_a_reach_that_is_no_distance_is_refused() -> None:
    class Endless(Blind):
        @property
        def reach(self) -> float:
            return float("nan")

    with pytest.raises(ParameterError, match=r"Endless\.reach"):
        halo_of(Endless(), None)


def test_a_wider_halo_is_read(located_pair: Any) -> None:
    """A point at the rim of a block sees as much of its surroundings as the method asks for."""
    seen: list[tuple[int, int]] = []

    class Watching(Blind):
        reach = 150.0

        def match(self, reference: Image, secondary: Image) -> Matches:
            seen.append(reference.shape)
            return Matches.empty()

    featreg.match(located_pair.reference, located_pair.secondary, method=Watching(), refine=False, **BLOCK)
    assert max(max(shape) for shape in seen) >= 200 * 2 / 3 + 2 * 150


# ---------------------------------------------------------------- what the model is worth


def _bent(height_px: float) -> Merged:
    """Tie points of 5 x 5 blocks of 100 px, exact but for the block in the middle, which is off by so many pixels."""
    rng = np.random.default_rng(0)
    blocks = np.repeat(np.arange(25), 40)
    corner = np.column_stack([blocks % 5, blocks // 5]) * 100.0
    here = corner + rng.uniform(0, 99, (1000, 2))
    there = here + rng.normal(0, 0.05, here.shape)
    there[blocks == 12, 0] += height_px
    points = Matches(here, there, np.ones(1000))
    return Merged(points, {}, blocks, points, blocks, 1000, (150, 150), Matches.empty(), blocks[:0])


@pytest.mark.parametrize(("off", "refined"), [(0.0, True), (3.0, True), (40.0, True), (40.0, False)])
def test_a_block_that_the_model_does_not_follow_is_known(off: float, refined: bool) -> None:
    merged = _bent(off)
    if not refined:
        merged = replace(merged, refined=Matches.empty(), refined_blocks=np.zeros(0, np.int64))
    errors = block_errors(merged, Translation(0.0, 0.0), 26)
    assert errors[12] == pytest.approx(max(off, 0.06), abs=0.05)
    assert np.delete(errors, [12, 25]).max() < 0.1
    assert np.isnan(errors[25])


def test_blocks_whose_unrefined_points_do_not_agree_say_nothing() -> None:
    merged = _bent(0.0)
    there = merged.matches.secondary_xy.copy()
    there[merged.blocks == 3] += np.random.default_rng(1).uniform(-30, 30, (40, 2))
    merged = replace(
        merged,
        matches=replace(merged.matches, secondary_xy=there),
        refined=Matches.empty(),
        refined_blocks=np.zeros(0, np.int64),
    )
    assert np.flatnonzero(np.isnan(block_errors(merged, Translation(0.0, 0.0), 25))).tolist() == [3]


def test_windows_that_are_noisy_themselves_tell_by_what_most_of_a_block_say() -> None:
    """Two of five points lie anywhere, the others about 2 px from the truth; a block is 3.5 px off."""
    merged = _bent(3.5)
    rng = np.random.default_rng(4)
    there = merged.matches.secondary_xy + rng.normal(0, 1.5, (1000, 2))
    wild = rng.random(1000) < 0.4
    there[wild] += rng.uniform(-12, 12, (int(wild.sum()), 2))
    merged = replace(
        merged,
        matches=replace(merged.matches, secondary_xy=there),
        refined=Matches.empty(),
        refined_blocks=np.zeros(0, np.int64),
    )
    errors = block_errors(merged, Translation(0.0, 0.0), 25)
    assert errors[12] == pytest.approx(3.5, abs=1.0)
    others = np.delete(errors, 12)
    assert np.isfinite(others).sum() > 18
    assert np.nanmax(others) < 1.5


@pytest.mark.parametrize(("noise", "wild", "most_off"), [(0.3, 0.6, 0.25), (1.0, 0.4, 0.6), (2.0, 0.0, 1.4)])
def test_a_displaced_block_reads_as_far_off_as_it_is(noise: float, wild: float, most_off: float) -> None:
    """Of 100 windows of a block some lie anywhere within the search, the others about where they belong."""
    rng = np.random.default_rng(3)
    for off in (0.0, 2.0, 5.0):
        said = []
        for _ in range(40):
            away = rng.normal([0.6 * off, 0.8 * off], noise, (100, 2))
            lost = rng.random(100) < wild
            away[lost] = rng.uniform(-6, 6, (int(lost.sum()), 2))
            found = _together(away)
            said.append(np.nan if found is None else np.hypot(*np.median(away[found], axis=0)))
        assert np.isfinite(said).mean() > 0.9
        low, middle = np.nanquantile(said, [0.05, 0.5])
        assert middle == pytest.approx(off, abs=0.8 if off == 0 else 0.15 * max(noise, 1))
        assert low > off - most_off


def test_what_very_many_points_of_a_block_say_needs_little_memory() -> None:
    rng = np.random.default_rng(7)
    away = np.concatenate([rng.normal([3.5, 0], 1.0, (2400, 2)), rng.uniform(-30, 30, (1600, 2))])
    tracemalloc.start()
    found = _together(rng.permutation(away))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found is not None
    assert 1500 < np.count_nonzero(found) < 2400
    assert peak < 100 << 20


@pytest.fixture(scope="module")
def hills(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A pair over 300 m of relief, seen under angles so different that no affine model follows it."""
    folder = tmp_path_factory.mktemp("hills")
    return simulate_scene(folder, (520, 560), relief=300.0, incidence_deg=(35.0, 43.0), seed=2)


def _off(got: Registration, hills: Any) -> NDArray[np.float64]:
    x, y = np.meshgrid(np.linspace(80, 480, 9), np.linspace(80, 440, 9))
    inside = np.column_stack([x.ravel(), y.ravel()])
    assert got.model
    return np.asarray(np.hypot(*(got.model(inside) - hills.truth(inside)).T))


def test_a_model_that_is_pixels_off_somewhere_is_unreliable(hills: Any) -> None:
    got = featreg.match(hills.reference, hills.secondary, **BLOCK)
    assert _off(got, hills).max() > 3
    assert got.status == "unreliable"
    assert "block_error" in got.reason
    # What it says of the worst block is about what is true.
    assert got.provenance["accuracy"]["blocks_px"]["worst"] > 0.5 * np.percentile(_off(got, hills), 95)


def test_a_model_that_follows_the_relief_is_trusted(hills: Any) -> None:
    got = featreg.match(hills.reference, hills.secondary, **BLOCK, model="rpc-bias", dem=hills.dem)
    assert got.status == "ok", got.reason
    assert got.provenance["accuracy"]["blocks_px"]["worst"] < 1
    # About 60 tie points: over scenes of 14 seeds RMS errors are 0.05 to 0.25 px, the largest 0.08 to 0.57.
    off = _off(got, hills)
    assert np.sqrt(np.mean(off**2)) < 0.2
    assert off.max() < 0.45


def test_a_residual_field_says_how_sure_it_is(located_pair: Any) -> None:
    got = featreg.match(located_pair.reference, located_pair.secondary, **BLOCK, model="residual-field")
    assert got.status == "ok", got.reason
    corners = got.provenance["accuracy"]["standard_error_corners_px"]
    assert min(corners) > 0
    uncertainty = got.gates["uncertainty"].value
    assert uncertainty is not None
    x, y = np.meshgrid(np.linspace(0, 450, 9), np.linspace(0, 450, 9))
    # Not in the corner without data, where a smoothed field goes on as it may: eight scenes are 0.02 to 0.08 px off
    # outside it.
    grid = np.column_stack([x.ravel(), y.ravel()])[(x.ravel() >= 280) | (y.ravel() >= 280)]
    actual = np.sqrt((Affine(located_pair.truth).residuals(grid, got.model(grid)) ** 2).mean())
    assert actual < 0.1
    # On the safe side: fits to fifteen sixteenths of the points choose a smoothing of their own each.
    assert actual / 2 < uncertainty < 0.3
    # Its derivatives are not known: nothing is said of what leaving out a region would do, rather than 0.
    assert "stability" not in got.gates


def test_errors_of_refitted_models_are_those_of_the_derivatives() -> None:
    rng = np.random.default_rng(0)
    here = rng.uniform(0, 1000, (800, 2))
    there = here + rng.normal(0, 0.5, here.shape)
    model = Affine.from_estimate(here, there)
    assert model
    at = np.array([[500.0, 500.0], [0.0, 0.0], [1000.0, 0.0]])
    known, refitted = prediction_covariance(model, here, there, at=at), refitted_covariance(model, here, there, at=at)
    assert isinstance(known, np.ndarray)
    assert isinstance(refitted, np.ndarray)
    ratio = np.sqrt(np.trace(refitted, axis1=1, axis2=2) / np.trace(known, axis1=1, axis2=2))
    # Sixteen groups tell a standard deviation to a fifth or so.
    assert ((ratio > 0.5) & (ratio < 2.0)).all()
    assert not refitted_covariance(model, here[:3], there[:3], at=at)
