"""FeatureMatcher: detect, describe, pair, and one common rotation where there is one."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg import registry
from featreg.errors import ParameterError
from featreg.geometry import Affine
from featreg.interfaces import Detector
from featreg.io import as_image
from featreg.pipeline.assembly import assemble
from featreg.pipeline.feature_matcher import FeatureMatcher, common_rotation, known_rotation
from featreg.simulate import SimulatedPair
from featreg.types import Features, Image, Matches

Texture = Callable[..., NDArray[np.float32]]


def matcher(n_features: int = 2000, common: bool = True, **parameters: Any) -> FeatureMatcher:
    return FeatureMatcher(
        registry.create("detector", "sar-ofast", n_features=n_features),
        registry.create("descriptor", "brief"),
        registry.create("nearest", "brute-force", **parameters),
        n_features,
        common_rotation=common,
    )


def correct(matches: Matches, truth: NDArray[np.float64]) -> NDArray[np.bool_]:
    mapped = matches.reference_xy @ truth[:, :2].T + truth[:, 2]
    return np.asarray(np.hypot(*(mapped - matches.secondary_xy).T) < 1.5)


@dataclass(frozen=True)
class Fixed(Detector):
    """The same points in every image."""

    found: Features

    def detect_features(self, image: Image) -> Features:
        return self.found


@dataclass(frozen=True)
class OfPairs(Fixed):
    """Other points where two images are matched."""

    shared: Features

    def for_pair(self, reference: Image, secondary: Image) -> Self:
        return replace(self, found=self.shared)


def test_both_images_get_the_detector_of_their_pair(sar_texture: Texture) -> None:
    picture, none = as_image(sar_texture(120, 120)), Features.empty()
    points = registry.create("detector", "sar-ofast", n_features=50).detect_features(picture)
    found = replace(matcher(common=False), detector=OfPairs(none, points)).match(picture, picture)
    assert len(found) > 20
    np.testing.assert_array_equal(found.reference_xy, found.secondary_xy)
    assert not len(replace(matcher(common=False), detector=Fixed(none)).match(picture, picture))


def test_a_common_rotation_gives_more_correct_matches_and_is_the_true_one(turned_pair: SimulatedPair) -> None:
    images = as_image(turned_pair.reference), as_image(turned_pair.secondary)
    alone, together = (matcher(common=c).match(*images) for c in (False, True))
    good = [int(correct(m, turned_pair.truth).sum()) for m in (alone, together)]
    assert good[1] > 1.3 * good[0]
    assert together.rotation is not None
    np.testing.assert_allclose(np.degrees(together.rotation), 30.0, atol=3.0)


@pytest.mark.parametrize("quarter", [1, 2, 3])
def test_quarter_turns_are_found(sar_texture: Texture, quarter: int) -> None:
    amplitude = sar_texture(220, 220)
    found = matcher().match(as_image(amplitude), as_image(np.rot90(amplitude, quarter)))
    assert found.rotation is not None
    off = (np.degrees(found.rotation) - 90 * quarter + 180) % 360 - 180
    np.testing.assert_allclose(off, 0, atol=3.0)
    assert len(found) > 200


@pytest.mark.parametrize("angle", [0.0, 1.0, np.pi, -np.pi + 1e-3, 3.0])
def test_angles_that_agree_give_their_angle(angle: float) -> None:
    rng = np.random.default_rng(0)
    noisy = np.concatenate([angle + rng.normal(0, 0.1, 200), rng.uniform(-10, 10, 600)])
    found = common_rotation(rng.permutation(noisy))
    assert found is not None
    assert abs((found - angle + np.pi) % (2 * np.pi) - np.pi) < 0.05


@pytest.mark.parametrize("count", [0, 1, 3, 10, 100, 2000])
def test_random_angles_give_none(count: int) -> None:
    answers = [common_rotation(np.random.default_rng(s).uniform(-np.pi, np.pi, count)) for s in range(50)]
    assert answers.count(None) >= 49


def test_unrelated_images_each_keep_their_own_angles(sar_texture: Texture) -> None:
    found = matcher().match(as_image(sar_texture(seed=1)), as_image(sar_texture(seed=2)))
    assert found.rotation is not None
    assert np.unique(np.round(found.rotation, 3)).size > 10


def test_more_features_vote_where_the_strongest_do_not_agree(
    turned_pair: SimulatedPair, monkeypatch: pytest.MonkeyPatch
) -> None:
    images = as_image(turned_pair.reference), as_image(turned_pair.secondary)
    voted = matcher().match(*images)
    monkeypatch.setattr("featreg.pipeline.feature_matcher.VOTERS", 10)  # too few of them meet
    again = matcher().match(*images)
    assert again.rotation is not None
    np.testing.assert_allclose(np.degrees(again.rotation), 30.0, atol=3.0)
    assert correct(again, turned_pair.truth).sum() > 0.9 * correct(voted, turned_pair.truth).sum()
    monkeypatch.setattr("featreg.pipeline.feature_matcher.MORE_VOTERS", 10)
    alone = matcher().match(*images)
    assert alone.rotation is not None
    assert np.unique(np.round(alone.rotation, 3)).size > 10


def test_the_budget_holds_for_each_image(sar_texture: Texture) -> None:
    """Also where the detector itself knows no budget."""
    rng = np.random.default_rng(0)
    score = rng.uniform(size=300)
    everywhere = Features(
        rng.uniform(30, 170, (300, 2)), np.full(300, 20.0), np.zeros(300), score, np.zeros(300, np.int64)
    )
    made = replace(matcher(50, mutual=False), detector=Fixed(everywhere))
    found = made.match(as_image(sar_texture()), as_image(sar_texture()))
    assert 0 < len(found) <= 50
    best = everywhere.xy[np.argsort(-score)[:50]]
    assert {tuple(p) for p in found.reference_xy} <= {tuple(p) for p in best}


def test_identical_images_match_point_by_point(sar_texture: Texture) -> None:
    image = as_image(sar_texture())
    found = matcher().match(image, image)
    np.testing.assert_array_equal(found.reference_xy, found.secondary_xy)
    np.testing.assert_allclose(found.score, 1.0)
    assert found.scale_ratio is not None
    np.testing.assert_allclose(found.scale_ratio, 1.0)


def test_no_features_give_no_matches(sar_texture: Texture) -> None:
    flat = Image(np.ones((100, 100), np.float32), np.ones((100, 100), np.bool_))
    for pair in ((flat, as_image(sar_texture())), (as_image(sar_texture()), flat), (flat, flat)):
        assert len(matcher().match(*pair)) == 0


def test_a_detector_without_descriptors_needs_a_descriptor(sar_texture: Texture) -> None:
    made = replace(matcher(), descriptor=None)
    with pytest.raises(ParameterError, match="descriptor"):
        made.match(as_image(sar_texture()), as_image(sar_texture(seed=1)))


def test_descriptors_that_come_with_the_points_are_kept(sar_texture: Texture) -> None:
    made = FeatureMatcher(registry.create("detector", "orb"), None, registry.create("nearest", "brute-force"))
    image = as_image(sar_texture())
    found = made.match(image, image)
    assert len(found) > 50
    np.testing.assert_array_equal(found.reference_xy, found.secondary_xy)


@pytest.mark.parametrize("ready", [False, True])
def test_a_descriptor_that_is_asked_for_describes(ready: bool, pair: SimulatedPair) -> None:
    """Also where the detector could do so itself and nobody told it not to."""
    detector = registry.create("detector", "sift") if ready else "sift"
    made = [
        featreg.match(pair.reference, pair.secondary, detector=detector, descriptor=name, refine=False)
        for name in ("brief", "ratio-gloh")
    ]
    assert len(made[0].matches) != len(made[1].matches)
    _, table = featreg.extractor(detector, "brief").detectAndCompute(pair.reference)
    assert table is not None
    assert table.dtype == np.uint8


@dataclass(frozen=True)
class Sized(Detector):
    """One point, at the size of the image that was given."""

    def detect_features(self, image: Image) -> Features:
        size = np.array([image.shape[::-1]], np.float64)
        return Features(size, np.ones(1), np.zeros(1), np.ones(1), np.zeros(1, np.int64), np.ones((1, 4), np.float32))


@pytest.mark.parametrize(
    ("n_features", "pixels_per_feature", "share"),
    [
        (100, 0.0, 1.0),
        (100, 60.0, 0.5),
        (200, 50.0, 0.5),
        (200, 60.0, math.sqrt(0.3)),
        (480, 60.0, math.sqrt(0.72)),
        (490, 60.0, 1.0),
        (700, 60.0, 1.0),
    ],
)
def test_images_are_reduced_to_the_pixels_that_the_features_need(
    n_features: int, pixels_per_feature: float, share: float
) -> None:
    """As far as the smaller of them has them to spare, to half at most, and not for a little."""
    large = Image(np.ones((300, 250), np.float32), np.ones((300, 250), np.bool_))
    mask = np.zeros((210, 220), np.bool_)
    mask[:200, :200] = True
    small = Image(np.where(mask, np.float32(1), np.float32(0)), mask)
    nearest = registry.create("nearest", "brute-force")
    made = FeatureMatcher(Sized(), None, nearest, n_features, False, pixels_per_feature)
    for images in ((large, small), (small, large)):
        found = made.match(*images)
        for (seen,), image in zip((found.reference_xy, found.secondary_xy), images, strict=True):
            height, width = image.shape
            sides = np.array([round(width * share), round(height * share)])
            np.testing.assert_allclose(seen, (sides + 0.5) * [width, height] / sides - 0.5)


@pytest.mark.parametrize(("height", "share"), [(50, 1.0), (74, 1.0), (80, 0.8), (128, 0.5), (256, 0.5)])
def test_no_image_is_reduced_to_a_narrow_strip(height: int, share: float) -> None:
    """Neither is the other one then: both are seen at one scale."""
    shapes = (height, 500), (300, 400)
    strip, large = (Image(np.ones(shape, np.float32), np.ones(shape, np.bool_)) for shape in shapes)
    made = FeatureMatcher(Sized(), None, registry.create("nearest", "brute-force"), 100, False, 60.0)
    for images in ((strip, large), (large, strip)):
        found = made.match(*images)
        for (seen,), image in zip((found.reference_xy, found.secondary_xy), images, strict=True):
            sides = np.array([round(side * share) for side in image.shape[::-1]])
            np.testing.assert_allclose(seen, (sides + 0.5) * image.shape[::-1] / sides - 0.5)


def test_reduced_images_give_positions_in_pixels_of_the_images(turned_pair: SimulatedPair) -> None:
    images = as_image(turned_pair.reference), as_image(turned_pair.secondary)
    found = replace(matcher(400), pixels_per_feature=60.0).match(*images)
    found = found.take(correct(found, turned_pair.truth))
    assert len(found) > 100
    mapped = found.reference_xy @ turned_pair.truth[:, :2].T + turned_pair.truth[:, 2]
    assert np.abs(np.mean(mapped - found.secondary_xy, axis=0)).max() < 0.25


def test_a_few_features_of_rift_match_more_often_in_a_reduced_image(turned_pair: SimulatedPair) -> None:
    images, truth = (turned_pair.reference, turned_pair.secondary), turned_pair.truth
    both = [
        featreg.match(*images, method="rift", n_features=300, refine=False, pixels_per_feature=p) for p in (0.0, 60.0)
    ]
    good = [int(correct(r.matches.take(r.inliers), truth).sum()) for r in both]
    assert good[1] > 2 * good[0]
    assert both[1].status == "ok"


def test_keypoints_are_those_of_an_image_compared_with_one_of_its_size(sar_texture: Texture) -> None:
    image = as_image(sar_texture(200, 200))
    made = replace(matcher(200), pixels_per_feature=60.0)
    found = made.match(image, image)
    own = {tuple(point) for point in made.keypoints(image)}
    assert len(found) > 20
    assert {tuple(point) for point in found.reference_xy} <= own


def test_near_a_known_model_features_are_described_in_its_direction(turned_pair: SimulatedPair) -> None:
    images, truth = (as_image(turned_pair.reference), as_image(turned_pair.secondary)), turned_pair.truth
    made = matcher(800)
    voted, known = made.match(*images), made.match_near(*images, Affine(truth), 5.0)
    assert correct(known, truth).sum() > 0.95 * correct(voted, truth).sum() > 50
    assert known.rotation is not None
    assert np.ptp(known.rotation) < 1e-9
    turn = known_rotation(Affine(truth), images[0].shape, 5.0)
    assert turn == pytest.approx(float(known.rotation[0]))
    assert voted.rotation is not None
    assert turn == pytest.approx(float(voted.rotation[0]), abs=math.radians(4))
    # So far off the model a point may lie only where the rotation is open; a mirrored image has none.
    assert known_rotation(Affine(truth), images[0].shape, 60.0) is None
    assert known_rotation(Affine(np.array([[-1.0, 0, 0], [0, 1, 0]])), images[0].shape, 5.0) is None
    again = made.match_near(*images, Affine(truth), 60.0)
    np.testing.assert_array_equal(again.secondary_xy, voted.secondary_xy)
    # Directions of their own are kept where that was asked for.
    own = matcher(800, common=False)
    np.testing.assert_array_equal(own.match_near(*images, Affine(truth), 5.0).rotation, own.match(*images).rotation)


def test_only_positions_that_are_measured_again_are_found_in_reduced_images() -> None:
    def used(**keywords: Any) -> Any:
        return assemble("rift", **keywords).parameters["pixels_per_feature"]

    assert used() == used(refine=False) == used(locate=False) > 0
    assert used(locate=False, refine=False) == used(blocks=True) == 0
    assert used(locate=False, refine=False, pixels_per_feature=40.0) == 40.0
    assert used(pixels_per_feature=0) == 0
