"""Features, matches and registrations: checked where they are made, read-only, picklable."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError
from featreg.geometry import Translation
from featreg.interfaces import FailedFit
from featreg.results.registration import Registration
from featreg.types import Features, Image, Matches, read_only
from featreg.types.arrays import middle


def features(n: int = 5) -> Features:
    rng = np.random.default_rng(0)
    return Features(
        rng.uniform(0, 9, (n, 2)),
        np.ones(n),
        np.zeros(n),
        np.arange(float(n)),
        np.zeros(n, np.int64),
        np.zeros((n, 8), np.float32),
    )


def matches(n: int = 5, **more: Any) -> Matches:
    rng = np.random.default_rng(1)
    return Matches(rng.uniform(0, 9, (n, 2)), rng.uniform(0, 9, (n, 2)), rng.uniform(size=n), **more)


# Features


def test_features_are_checked_where_they_are_made() -> None:
    good = features()
    for change in (
        {"xy": np.zeros((5, 3))},
        {"xy": np.full((5, 2), np.nan)},
        {"scale": np.ones(4)},
        {"norm": "l1"},
        {"norm": "hamming"},  # float descriptors
        {"descriptors": np.zeros((4, 8), np.float32)},
        {"descriptors": np.zeros((5, 8), np.float64)},
        {"descriptors": [[0.0] * 8] * 5},
        {"xy": "here"},
        {"scale": [[1], [2, 3]]},
        {"level": np.nan},
        {"index": np.arange(4)},
    ):
        fields = {name: getattr(good, name) for name in good.__dataclass_fields__} | change
        with pytest.raises(InputError):
            Features(**fields)


@pytest.mark.parametrize("name", ["scale", "angle", "score"])
def test_features_hold_finite_numbers(name: str) -> None:
    columns = {"scale": np.ones(3), "angle": np.ones(3), "score": np.ones(3)}
    columns[name] = np.array([1.0, np.nan, 1.0])
    with pytest.raises(InputError):
        Features(np.ones((3, 2)), level=np.zeros(3), **columns)  # type: ignore[arg-type]


def test_one_number_stands_for_all_rows() -> None:
    made = Features(np.ones((3, 2)), 2.0, 0.5, 1.0, 0)
    assert made.scale.tolist() == [2.0] * 3
    assert made.level.dtype == np.int64


@pytest.mark.parametrize("count", [2, 5, 9])
def test_best_gives_the_highest_scores_best_first(count: int) -> None:
    score = np.array([1.0, 3.0, 2.0, 3.0, 0.0])
    made = Features(np.arange(10).reshape(5, 2), np.ones(5), np.zeros(5), score, np.zeros(5))
    found = made.best(count)
    assert found.score.tolist() == sorted(score, reverse=True)[:count]
    if count >= 2:
        assert found.xy[:2, 0].tolist() == [2.0, 6.0]  # the tie in the order given


def test_take_picks_the_same_rows_of_everything() -> None:
    made = features(6)
    rows = np.array([4, 1])
    taken = made.take(rows)
    for name in ("xy", "scale", "angle", "score", "level", "descriptors"):
        np.testing.assert_array_equal(getattr(taken, name), getattr(made, name)[rows])


@pytest.mark.parametrize("rows", [[4], (4,), (1, 4), [], slice(2, 5), np.arange(6) > 2, range(3)])
def test_rows_are_rows_however_they_are_listed(rows: Any) -> None:
    made = features(6)
    matches = Matches(made.xy, made.xy + 1, made.score)
    at = np.arange(6)[list(rows) if isinstance(rows, tuple) else rows]
    for found in (made.take(rows), matches.take(rows)):
        np.testing.assert_array_equal(found.score, made.score[at])
        assert len(found) == len(at)
    np.testing.assert_array_equal(matches.take(rows).secondary_xy, made.xy[at] + 1)


@pytest.mark.parametrize("rows", [3, "3", np.eye(6) > 0, [[1, 2]], None])
def test_what_is_no_list_of_rows_is_refused(rows: Any) -> None:
    made = features(6)
    for take in (made.take, Matches(made.xy, made.xy, made.score).take):
        with pytest.raises(InputError, match="rows must be"):
            take(rows)


def test_concatenated_and_empty_features() -> None:
    joined = Features.concatenate([features(2), Features.empty(), features(3)])
    assert len(joined) == 5
    assert len(Features.concatenate([])) == 0
    assert Features.empty().xy.shape == (0, 2)


def test_keypoints_and_back() -> None:
    rng = np.random.default_rng(3)
    made = Features(
        xy=rng.uniform(0, 500, (20, 2)),
        scale=rng.uniform(1, 30, 20),
        angle=rng.uniform(0, 6.2, 20),
        score=rng.uniform(0, 9, 20),
        level=np.arange(20) % 5,
    )
    again = Features.from_keypoints(made.to_keypoints())
    for name in ("xy", "scale", "angle", "score", "level"):
        np.testing.assert_allclose(getattr(again, name), getattr(made, name), rtol=1e-5, atol=1e-5)


def test_opencv_angles_run_the_other_way() -> None:
    made = Features(np.ones((1, 2)), np.ones(1), np.array([np.pi / 2]), np.ones(1), np.zeros(1, np.int64))
    assert made.to_keypoints()[0].angle == pytest.approx(270.0)
    assert made.to_keypoints()[0].size == pytest.approx(2.0)


# Matches


def test_matches_are_checked_where_they_are_made() -> None:
    a = np.zeros((4, 2))
    with pytest.raises(InputError, match="as many"):
        Matches(a, a[:3], np.ones(4))
    with pytest.raises(InputError, match="covariance"):
        Matches(a, a, np.ones(4), covariance=np.zeros((4, 2)))
    with pytest.raises(InputError, match="finite"):
        Matches(a, a + np.inf, np.ones(4))
    with pytest.raises(InputError, match="score"):
        Matches(a, a, np.ones(3))
    with pytest.raises(InputError, match=r"Matches\.covariance must be an array of float64"):
        Matches(a, a, np.ones(4), covariance="wide")
    with pytest.raises(InputError, match=r"Matches\.origin must be an array of int64"):
        Matches(a, a, np.ones(4), origin=np.nan)


def test_appended_matches_keep_what_is_known() -> None:
    first, more = (
        matches(3, rotation=np.full(3, 0.25)),
        matches(2, covariance=np.tile(np.eye(2), (2, 1, 1)), origin=[0, 2]),
    )
    joined = first.appended(more)
    assert len(joined) == 5
    assert joined.origin.tolist() == [-1, -1, -1, 0, 2]
    assert joined.covariance is not None
    assert joined.rotation is not None
    assert np.isnan(joined.covariance[:3]).all()
    np.testing.assert_array_equal(joined.covariance[3:], more.covariance)
    np.testing.assert_array_equal(joined.rotation[:3], 0.25)
    assert np.isnan(joined.rotation[3:]).all()
    np.testing.assert_array_equal(joined.reference_xy[3:], more.reference_xy)


def test_the_callers_arrays_are_not_locked_or_shared() -> None:
    xy = np.zeros((3, 2))
    made = Matches(xy, xy, np.ones(3))
    xy[:] = 5
    assert made.reference_xy.max() == 0


@pytest.mark.parametrize("made", [features(), matches()], ids=["features", "matches"])
def test_arrays_stay_read_only_after_pickling(made: Any) -> None:
    for thing in (made, pickle.loads(pickle.dumps(made))):
        for name in thing.__dataclass_fields__:
            value = getattr(thing, name)
            if isinstance(value, np.ndarray):
                assert not value.flags.writeable, name


# Registration


def test_registration_is_checked_where_it_is_made() -> None:
    found = matches(4)
    model = Translation(1.0, 2.0)
    with pytest.raises(InputError, match="reason"):
        Registration(found, {}, np.ones(4, np.bool_), model, "unreliable")
    with pytest.raises(InputError, match="status"):
        Registration(found, {}, np.ones(4, np.bool_), model, "good")
    with pytest.raises(InputError, match="gms"):
        Registration(found, {"gms": np.ones(3, np.bool_)}, np.ones(4, np.bool_), model, "ok")


def test_residuals_of_a_registration() -> None:
    found = Matches(np.zeros((2, 2)), np.array([[1.0, 2.0], [4.0, 6.0]]), np.ones(2))
    made = Registration(found, {}, np.ones(2, np.bool_), Translation(1.0, 2.0), "ok")
    np.testing.assert_allclose(made.residuals(), [0.0, 5.0])
    failed = Registration(found, {}, np.zeros(2, np.bool_), FailedFit("too few"), "unreliable", "too few")
    assert np.isnan(failed.residuals()).all()


def test_rows_of_each_kind_are_those_of_indexing() -> None:
    rng = np.random.default_rng(1)
    xy, descriptors = rng.random((9, 2)), rng.random((9, 4)).astype(np.float32)
    features = Features(xy, xy[:, 0], xy[:, 1], xy[:, 0], np.arange(9), descriptors)
    mask = xy[:, 0] > 0.5
    for rows in (np.array([3, -1, 0]), np.array([2, 4], np.int32), mask, slice(2, 5), [1, 1], np.zeros(0, np.int64)):
        taken = features.take(rows)  # type: ignore[arg-type]  # slices and lists are taken too
        assert np.array_equal(taken.xy, xy[rows])
        assert np.array_equal(taken.level, np.arange(9)[rows])
        assert np.array_equal(taken.descriptors, descriptors[rows])  # type: ignore[arg-type]  # they are described
        assert taken.xy.flags.c_contiguous
    for wrong in (np.array([9]), np.ones(8, np.bool_)):
        with pytest.raises(IndexError):
            features.take(wrong)


def test_points_put_side_by_side_lie_in_memory_as_kernels_take_them() -> None:
    """Of two columns that a transpose joins, or `numpy.argwhere`, every kernel would be compiled anew, for seconds."""
    xy = np.array([np.arange(5.0), np.arange(5.0) + 7]).T
    assert not xy.flags.c_contiguous
    features, matches = Features(xy, 1.0, 0.0, 1.0, 0), Matches(xy, read_only(xy.copy(order="F")), 1.0)
    for held in (features.xy, matches.reference_xy, matches.secondary_xy):
        np.testing.assert_array_equal(held, xy)
        assert held.flags.c_contiguous
    turned = read_only(np.arange(12, dtype=np.float32).reshape(3, 4).T)
    image = Image(turned, read_only(turned > 3))
    np.testing.assert_array_equal(image.pixels, turned)
    assert image.pixels.flags.c_contiguous
    assert image.mask.flags.c_contiguous


def test_features_with_another_column_are_checked_as_new_ones_are() -> None:
    some = Features(np.zeros((3, 2)), np.ones(3), np.zeros(3), np.arange(3.0), np.zeros(3, np.int64))
    bits = np.zeros((3, 32), np.uint8)
    described = some.having(angle=1.0, descriptors=bits, norm="hamming", index=[2, 1, 0])
    np.testing.assert_array_equal(described.angle, np.ones(3))
    np.testing.assert_array_equal(described.index, [2, 1, 0])
    assert described.score is some.score
    assert described.norm == "hamming"
    assert not described.angle.flags.writeable
    assert described.having(xy=np.ones((3, 2))).xy.tolist() == [[1, 1]] * 3
    for wrong in (
        {"angle": np.nan}, {"angle": np.zeros(4)}, {"score": None}, {"norm": "l1"}, {"norm": "l2"}, {"descriptors": 1},
        {"xy": np.zeros((2, 2))},
    ):  # fmt: skip
        with pytest.raises(InputError):
            described.having(**wrong)
    with pytest.raises(TypeError):
        some.having(colour=1)


@pytest.mark.parametrize("count", [1, 2, 7, 8])
def test_the_middle_is_the_median(count: int) -> None:
    values = np.random.default_rng(count).normal(size=count)
    assert middle(values) == np.median(values)
    values[0] = np.nan
    assert np.isnan(middle(values))
