"""Corner kernels: FAST as OpenCV has it, sub-pixel corners at known places, orientation of turned images."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.sar.keypoints import corner_kernels
from featreg.sar.keypoints.corners import fast_corners, orient_level, orientation, refine_centroid, refine_corner
from featreg.sar.pyramid import share_out

cv2 = pytest.importorskip("cv2")
Texture = Callable[..., NDArray[np.float32]]
U8 = NDArray[np.uint8]


def random_picture() -> U8:
    return np.random.default_rng(0).integers(0, 256, (61, 83)).astype(np.uint8)


def structured_picture() -> U8:
    picture = np.full((90, 110), 60, np.uint8)
    rng = np.random.default_rng(1)
    for _ in range(25):
        x, y, w, h = (int(rng.integers(k)) for k in (100, 80, 30, 30))
        cv2.rectangle(picture, (x, y), (x + w, y + h), int(rng.integers(256)), -1)
    return picture


def extreme_picture() -> U8:
    return np.where(np.random.default_rng(2).random((50, 70)) < 0.5, 0, 255).astype(np.uint8)


def smooth_picture() -> U8:
    return cv2.GaussianBlur(np.random.default_rng(3).integers(0, 256, (70, 71)).astype(np.uint8), (0, 0), 1.5)  # type: ignore[no-any-return]


pictures = pytest.mark.parametrize(
    "picture", [random_picture(), structured_picture(), extreme_picture(), smooth_picture()],
    ids=["random", "structured", "extreme", "smooth"],
)  # fmt: skip
thresholds = pytest.mark.parametrize("threshold", [0, 1, 10, 40, 120, 254])


def scores(picture: U8, threshold: int) -> U8:
    out = np.zeros(picture.shape, np.uint8)
    corner_kernels.fast_scores(picture, threshold, 0, out)
    return out


def opencv(picture: U8, threshold: int, suppress: bool) -> list[Any]:
    fast = cv2.FastFeatureDetector_create(threshold, suppress, cv2.FAST_FEATURE_DETECTOR_TYPE_9_16)
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
    picture = cv2.resize(random_picture(), (400, 300))
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


# Sub-pixel

OFFSETS = [(0.0, 0.0), (0.3, -0.2), (-0.45, 0.4), (0.1, 0.49), (-0.25, -0.35)]
offsets = pytest.mark.parametrize("offset", OFFSETS)


def grid() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    y, x = np.mgrid[:31, :33].astype(np.float64)
    return x, y


@offsets
@pytest.mark.parametrize("start", [(0, 0), (1, 0), (0, -1)])
def test_a_saddle_corner_is_found_by_its_gradients(offset: tuple[float, float], start: tuple[int, int]) -> None:
    x, y = grid()
    q = np.array([16.0, 15.0]) + offset
    u, v = (x - q[0]) / 1.5, (y - q[1]) / 1.5
    gx, gy = (np.tanh(v) / np.cosh(u) ** 2).astype(np.float32), (np.tanh(u) / np.cosh(v) ** 2).astype(np.float32)
    found, _ = refine_corner(gx, gy, np.array([[16 + start[0], 15 + start[1]]]), 2.0)
    np.testing.assert_allclose(found[0], q, atol=0.05)


@offsets
def test_two_edges_that_meet_are_perpendicular_to_their_gradients(offset: tuple[float, float]) -> None:
    """Eq. 6 for ideal thin edges: every gradient is orthogonal to the line to the corner, so the answer is exact."""
    x, y = grid()
    q = np.array([16.0, 15.0]) + offset
    angle = np.arctan2(y - q[1], x - q[0])
    strength = np.cos(2 * angle) ** 2
    gx, gy = (-np.sin(angle) * strength).astype(np.float32), (np.cos(angle) * strength).astype(np.float32)
    found, _ = refine_corner(gx, gy, np.array([[16, 15]]), 2.0)
    np.testing.assert_allclose(found[0], q, atol=1e-3)


def test_a_corner_that_runs_away_or_is_no_corner_stays_at_its_pixel() -> None:
    x, y = grid()
    angle = np.arctan2(y - 15.0, x - 19.0)  # three pixels to the right of the start
    far = (-np.sin(angle)).astype(np.float32), np.cos(angle).astype(np.float32)
    edge = np.ones(x.shape, np.float32), np.zeros(x.shape, np.float32)
    flat = np.zeros(x.shape, np.float32), np.zeros(x.shape, np.float32)
    for gx, gy in (far, edge, flat):
        stays, stable = refine_corner(gx, gy, np.array([[16, 15]]), 2.0)
        np.testing.assert_array_equal(stays, [[16.0, 15.0]])
        assert not stable.any()


@offsets
@pytest.mark.parametrize("form", ["bright", "ring"])
def test_a_blob_of_edges_is_centred(offset: tuple[float, float], form: str) -> None:
    x, y = grid()
    q = np.array([16.0, 15.0]) + offset
    r = np.hypot(x - q[0], y - q[1])
    values = np.exp(-0.5 * (r / 1.0) ** 2) if form == "bright" else np.exp(-0.5 * ((r - 2.5) / 0.8) ** 2)
    edges = np.rint(240 * values).astype(np.uint8)
    found, _ = refine_centroid(edges, np.array([[16, 15]]), 1.0)
    np.testing.assert_allclose(found[0], q, atol=0.05)


def plain_centroid(edges: U8, start: tuple[int, int], sigma: float, reach: float) -> tuple[float, float] | None:
    """The iterated centroid of one point, term by term; None where it runs away."""
    ys, xs = np.mgrid[-3:4, -3:4]
    q = np.array(start, np.float64)
    first = edges[start[1] - 3 : start[1] + 4, start[0] - 3 : start[0] + 4].astype(np.float64)
    ring = (first.sum() - first[1:6, 1:6].sum()) / 24
    for _ in range(8):
        cx, cy = np.rint(q).astype(int)
        if not (3 <= cx < edges.shape[1] - 3 and 3 <= cy < edges.shape[0] - 3):
            return None
        near = edges[cy - 3 : cy + 4, cx - 3 : cx + 4].astype(np.float64)
        near = near.max() - near if first[3, 3] < ring else near - near.min()
        weight = near * np.exp(-((xs + cx - q[0]) ** 2 + (ys + cy - q[1]) ** 2) / (2 * sigma**2))
        if not weight.sum() > 0:
            return None
        moved = np.array([cx + (weight * xs).sum() / weight.sum(), cy + (weight * ys).sum() / weight.sum()])
        if np.hypot(*(moved - start)) > reach:
            return None
        step, q = np.abs(moved - q).sum(), moved
        if step < 1e-2:
            break
    return float(q[0]), float(q[1])


@pictures
@pytest.mark.parametrize(("sigma", "close"), [(1.0, 1e-5), (0.4, 1e-3)])  # sums in float32, weights to 1e-4
def test_the_centroid_is_that_of_the_plain_sums(picture: U8, sigma: float, close: float) -> None:
    rng = np.random.default_rng(5)
    at = rng.integers(3, np.array(picture.shape[::-1]) - 3, (150, 2))
    found, good = refine_centroid(picture, at, sigma)
    for start, place, stable in zip(at, found, good, strict=True):
        wanted = plain_centroid(picture, (int(start[0]), int(start[1])), sigma, 2.0)
        assert stable == (wanted is not None)
        np.testing.assert_allclose(place, start if wanted is None else wanted, atol=close)


def test_a_blob_far_away_or_no_blob_leaves_the_point() -> None:
    x, y = grid()
    for edges in (np.rint(240 * np.exp(-0.5 * ((x - 20) ** 2 + (y - 15) ** 2) / 4)), np.full(x.shape, 7)):
        found, _ = refine_centroid(edges.astype(np.uint8), np.array([[16, 15]]), 3.0)
        np.testing.assert_array_equal(found, [[16.0, 15.0]])


@pytest.mark.parametrize("at", [(0, 0), (2, 15), (32, 30), (16, 1)])
def test_points_beside_the_border_stay(at: tuple[int, int]) -> None:
    edges = np.random.default_rng(0).integers(0, 256, (31, 33)).astype(np.uint8)
    g = np.random.default_rng(1).normal(size=(2, 31, 33)).astype(np.float32)
    np.testing.assert_array_equal(refine_corner(g[0], g[1], np.array([at]), 2.0)[0], [at])
    np.testing.assert_array_equal(refine_centroid(edges, np.array([at]), 1.0)[0], [at])


def test_no_points_give_no_points() -> None:
    none = np.zeros((0, 2), np.int64)
    flat = np.zeros((20, 20), np.float32)
    assert refine_corner(flat, flat, none, 2.0)[0].shape == (0, 2)
    assert refine_centroid(flat.astype(np.uint8), none, 1.0)[0].shape == (0, 2)
    assert orientation(flat, none, 15).shape == (0,)


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
