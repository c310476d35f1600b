"""Corner kernels: FAST as OpenCV has it, orientation of turned images, shares of levels."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.sar.keypoints import corner_kernels
from featreg.sar.keypoints.corners import fast_corners, orient_level, orientation
from featreg.sar.pyramid import share_out
from made.edge_pictures import U8, pictures, random_picture, smooth_picture

Texture = Callable[..., NDArray[np.float32]]
thresholds = pytest.mark.parametrize("threshold", [0, 1, 10, 40, 120, 254])


def scores(picture: U8, threshold: int) -> U8:
    out = np.zeros(picture.shape, np.uint8)
    corner_kernels.fast_scores(picture, threshold, 0, out)
    return out


def opencv(picture: U8, threshold: int, suppress: bool) -> list[Any]:
    fast = cv2.FastFeatureDetector.create(threshold, suppress, cv2.FAST_FEATURE_DETECTOR_TYPE_9_16)
    return list(fast.detect(picture))


@pictures
@thresholds
def test_the_corners_are_those_of_opencv(picture: U8, threshold: int) -> None:
    theirs = {(int(k.pt[0]), int(k.pt[1])) for k in opencv(picture, threshold, False)}
    y, x = np.nonzero(scores(picture, threshold))
    assert set(zip(x.tolist(), y.tolist(), strict=True)) == theirs


@pictures
@pytest.mark.parametrize("threshold", [1, 10, 40])
def test_the_score_is_opencvs_response_plus_one(picture: U8, threshold: int) -> None:
    found = scores(picture, threshold)
    theirs = opencv(picture, threshold, True)
    assert theirs or picture.max() - picture.min() < 80
    for k in theirs:
        assert found[int(k.pt[1]), int(k.pt[0])] == k.response + 1


def test_some_rows_can_be_asked_for() -> None:
    picture = random_picture()
    some = np.full((9, picture.shape[1]), 7, np.uint8)
    some[:, :3], some[:, -3:] = 0, 0
    corner_kernels.fast_scores(picture, 10, 54, some[:7])
    np.testing.assert_array_equal(some[:7], scores(picture, 10)[54:])
    assert (some[7:, 3:-3] == 7).all()


def test_the_highest_are_the_first_of_all_in_their_order() -> None:
    picture = np.asarray(cv2.resize(random_picture(), (400, 300)), np.uint8)
    allowed = np.ones(picture.shape, np.bool_)
    xy, score = fast_corners(picture, 5, allowed, picture.size)
    order = np.lexsort((xy[:, 1] * picture.shape[1] + xy[:, 0], -score.astype(int)))
    np.testing.assert_array_equal(order, np.arange(len(xy)))
    for count in (0, 1, 17, len(xy) // 2, len(xy) - 1):
        some, their_score = fast_corners(picture, 5, allowed, count)
        np.testing.assert_array_equal(some, xy[:count])
        np.testing.assert_array_equal(their_score, score[:count])


@pictures
def test_maxima_hold_no_two_neighbours_and_miss_none(picture: U8) -> None:
    found = scores(picture, 10).astype(int)
    allowed = np.random.default_rng(0).random(picture.shape) < 0.8
    xy, score = fast_corners(picture, 10, allowed, 10**6)
    assert allowed[xy[:, 1], xy[:, 0]].all()
    np.testing.assert_array_equal(score, found[xy[:, 1], xy[:, 0]])
    marked = np.zeros(picture.shape, np.bool_)
    marked[xy[:, 1], xy[:, 0]] = True
    largest = cv2.dilate(found.astype(np.uint8), np.ones((3, 3), np.uint8))
    assert (found == largest)[marked].all()
    padded = np.pad(found, 1)
    around = [
        padded[1 + dy : padded.shape[0] - 1 + dy, 1 + dx : padded.shape[1] - 1 + dx]
        for dy in (-1, 0, 1) for dx in (-1, 0, 1) if (dx, dy) != (0, 0)
    ]  # fmt: skip
    assert (np.diff(score.astype(int)) <= 0).all()
    few = fast_corners(picture, 10, allowed, 5)
    np.testing.assert_array_equal(few[0], xy[:5])
    alone = (found > 0) & np.all([found > a for a in around], axis=0)  # strictly above all eight
    assert marked[alone & allowed].all()
    assert cv2.filter2D(marked.astype(np.float32), -1, np.ones((3, 3), np.float32))[marked].max() < 1.5


@pytest.mark.parametrize("shape", [(1, 1), (6, 6), (7, 7), (3, 40), (40, 3), (6, 64), (7, 64)])
def test_tiny_maps_have_few_or_no_corners(shape: tuple[int, int]) -> None:
    xy, score = fast_corners(np.zeros(shape, np.uint8), 10, np.ones(shape, np.bool_), 100)
    assert xy.shape == (0, 2)
    assert score.shape == (0,)


def test_the_smallest_map_with_a_corner() -> None:
    dot = np.zeros((7, 7), np.uint8)
    dot[3, 3] = 200
    xy, score = fast_corners(dot, 10, np.ones((7, 7), np.bool_), 100)
    assert (xy.tolist(), score.tolist()) == ([[3, 3]], [200.0])


# Orientation


def difference(a: Any, b: Any) -> NDArray[np.float64]:
    return np.asarray((np.asarray(a) - b + np.pi) % (2 * np.pi) - np.pi)


@pytest.mark.parametrize("towards", [0.0, 0.7, 2.0, -2.5, np.pi / 2])
def test_the_angle_points_to_the_brighter_side_counter_clockwise_as_seen(towards: float) -> None:
    y, x = np.mgrid[:41, :41].astype(np.float64)
    ramp = (np.cos(towards) * (x - 20) - np.sin(towards) * (y - 20)).astype(np.float32)
    assert difference(orientation(ramp, np.array([[20, 20]]), 15), towards) == pytest.approx(0.0, abs=1e-6)


def test_turning_the_image_by_a_quarter_adds_a_quarter(sar_texture: Texture) -> None:
    picture = sar_texture(90, 120)
    xy = np.random.default_rng(0).integers(20, 70, (50, 2))
    before = orientation(picture, xy, 15)
    after = orientation(np.ascontiguousarray(np.rot90(picture)), np.column_stack([xy[:, 1], 119 - xy[:, 0]]), 15)
    np.testing.assert_allclose(difference(after, before + np.pi / 2), 0, atol=1e-4)


def test_a_constant_added_to_the_map_does_not_turn_the_points(sar_texture: Texture) -> None:
    picture = sar_texture(90, 120)
    xy = np.random.default_rng(0).integers(20, 70, (50, 2))
    turned = difference(orientation(picture + 5, xy, 15), orientation(picture, xy, 15))
    np.testing.assert_allclose(turned, 0, atol=1e-3)


# Shares of the levels


@pytest.mark.parametrize("decay", [1.0, 1.2, 2.5])
@pytest.mark.parametrize("supply", [[1000] * 8, [50, 3, 100, 0, 7, 7, 7, 1000], [0, 0, 0], [5]])
def test_the_shares_are_exactly_the_budget_or_all_there_is(decay: float, supply: list[int]) -> None:
    for total in (1, 2, 3, 4, 5, 7, 12, 20, 100, 999):
        shares = share_out(total, supply, decay)
        assert all(0 <= share <= there for share, there in zip(shares, supply, strict=True))
        assert sum(shares) == min(total, sum(supply)), total


def test_finer_levels_get_the_larger_shares() -> None:
    shares = share_out(1000, [1000] * 6, 1.5)
    assert shares == sorted(shares, reverse=True)
    assert shares[0] / shares[1] == pytest.approx(1.5, rel=0.02)


def test_directions_of_the_points_of_a_level_are_those_of_their_pixels() -> None:
    level, rng = smooth_picture(), np.random.default_rng(6)
    shape = (140, 142)
    xy, numbers = rng.uniform(0, 139, (60, 2)), rng.integers(0, 3, 60)
    angle = np.full(60, 9.0)
    orient_level(level, xy, shape, numbers, 1, 15, angle)
    own = numbers == 1
    at = np.rint((xy[own] + 0.5) * 0.5 - 0.5).astype(np.int64)
    np.testing.assert_array_equal(angle[own], orientation(level, at, 15))
    assert (angle[~own] == 9.0).all()
