"""What flows: checked where it is made, read-only, picklable; derived maps are computed once."""

from __future__ import annotations

import pickle
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.focusing.phase_history import PhaseHistory
from featreg.focusing.result import FocusResult
from featreg.geometry import Translation
from featreg.interfaces import FailedFit
from featreg.io import as_image
from featreg.io.raster_source import RasterSource
from featreg.io.window import Window
from featreg.results.registration import Registration
from featreg.simulate.circle import ParkingLot
from featreg.types import Features, Geolocation, Image, Matches, everywhere, kept, read_only
from featreg.types.arrays import middle
from featreg.types.derived import DerivedMaps

CALLS: list[tuple[str, float]] = []


def slow_map(image: Image, factor: float = 1.0) -> NDArray[np.float32]:
    CALLS.append(("slow_map", factor))
    time.sleep(0.02)
    return np.asarray(image.amplitude * np.float32(factor))


def failing_map(image: Image) -> NDArray[np.float32]:
    CALLS.append(("failing_map", 0.0))
    raise InputError("cannot")


def image(height: int = 20, width: int = 30) -> Image:
    return Image(np.ones((height, width), np.float32), np.ones((height, width), np.bool_))


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


# Image


@pytest.mark.parametrize(
    ("pixels", "mask"),
    [
        (np.zeros((3, 4, 2), np.float32), np.ones((3, 4, 2), np.bool_)),
        (np.zeros((0, 4), np.float32), np.ones((0, 4), np.bool_)),
        (np.zeros((3, 4), np.float64), np.ones((3, 4), np.bool_)),
        (np.zeros((3, 4), np.uint8), np.ones((3, 4), np.bool_)),
        (np.zeros((3, 4), np.float32), np.ones((4, 3), np.bool_)),
        (np.zeros((3, 4), np.float32), np.ones((3, 4), np.uint8)),
    ],
)
def test_an_impossible_image_is_refused(pixels: Any, mask: Any) -> None:
    with pytest.raises(InputError):
        Image(pixels, mask)


def test_amplitude_of_a_complex_image_is_its_modulus() -> None:
    rng = np.random.default_rng(0)
    z = (rng.normal(size=(20, 30)) + 1j * rng.normal(size=(20, 30))).astype(np.complex64)
    made = Image(z, np.ones(z.shape, np.bool_))
    assert made.is_complex
    assert made.amplitude.dtype == np.float32
    np.testing.assert_allclose(made.amplitude, np.abs(z), rtol=1e-6)


def test_pixels_mask_and_derived_maps_are_read_only() -> None:
    made = image()
    for array in (made.pixels, made.mask, made.derive(slow_map, factor=7.0)):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 0


def test_a_map_is_computed_once_under_eight_threads() -> None:
    made = image()
    CALLS.clear()
    gate = threading.Barrier(8)

    def ask() -> NDArray[np.float32]:
        gate.wait()
        return made.derive(slow_map, factor=2.0)

    with ThreadPoolExecutor(8) as pool:
        maps = [f.result() for f in [pool.submit(ask) for _ in range(8)]]
    assert len(CALLS) == 1
    assert all(m is maps[0] for m in maps)


def test_parameters_are_part_of_the_key() -> None:
    made = image()
    CALLS.clear()
    assert made.derive(slow_map, factor=2.0)[0, 0] == 2
    assert made.derive(slow_map, factor=3.0)[0, 0] == 3
    assert made.derive(slow_map, factor=2.0)[0, 0] == 2
    assert CALLS == [("slow_map", 2.0), ("slow_map", 3.0)]


def test_a_default_spelt_out_is_the_same_map() -> None:
    made = image()
    CALLS.clear()
    assert made.derive(slow_map) is made.derive(slow_map, factor=1.0)
    assert len(CALLS) == 1


def test_a_failure_is_raised_each_time_and_not_kept() -> None:
    made = image()
    CALLS.clear()
    for _ in range(2):
        with pytest.raises(InputError, match="cannot"):
            made.derive(failing_map)
    assert len(CALLS) == 2


@pytest.mark.parametrize("function", [lambda image: image.pixels, lambda image: 1])
def test_derive_needs_a_function_of_a_module(function: Callable[..., Any]) -> None:
    with pytest.raises(TypeError, match="module-level"):
        image().derive(function)


def test_what_a_dataclass_of_maps_holds_counts_as_memory() -> None:
    """Kept by their sizes, the older of two goes; arrays of a dataclass are as read-only as others."""
    from featreg.sar.gradients.gradient_field import GradientField

    def field(image: None, number: int) -> GradientField:
        made.append(number)
        return GradientField(*np.full((2, 100, 100), number, np.float32))

    made: list[int] = []
    field.__qualname__ = "field"
    maps = DerivedMaps(max_bytes=100_000)
    for number in (1, 2, 2, 1):
        found = maps.get(None, field, {"number": number})
        assert not found.x.flags.writeable
    assert made == [1, 2, 1]


def test_views_made_in_parts_count_as_memory() -> None:
    from featreg.sar.speckle import _byte_view

    maps, picture = DerivedMaps(max_bytes=15_000), image(100, 100)
    first = maps.get(picture, _byte_view, {"sigma": 1.0})
    assert maps.get(picture, _byte_view, {"sigma": 1.0}) is first
    maps.get(picture, _byte_view, {"sigma": 2.0})
    assert maps.get(picture, _byte_view, {"sigma": 1.0}) is not first


def test_derived_maps_stay_out_of_the_pickle() -> None:
    made = image(100, 100)
    before = len(pickle.dumps(made))
    made.derive(slow_map, factor=5.0)
    data = pickle.dumps(made)
    assert len(data) == before
    again = pickle.loads(data)
    np.testing.assert_array_equal(again.pixels, made.pixels)
    assert again.shape == (100, 100)
    CALLS.clear()
    again.derive(slow_map, factor=5.0)
    assert len(CALLS) == 1
    with pytest.raises(ValueError, match="read-only"):
        again.pixels[0, 0] = 0


def test_release_forgets_every_map() -> None:
    made = image()
    CALLS.clear()
    first = made.derive(slow_map, factor=4.0)
    made.release()
    assert made.derive(slow_map, factor=4.0) is not first
    assert len(CALLS) == 2


def test_the_store_is_bounded_and_drops_the_least_recently_used() -> None:
    made = image(10, 10)
    store = DerivedMaps(max_bytes=1000)  # a map of 10 x 10 floats has 400
    CALLS.clear()
    for factor in (1.0, 2.0, 1.0, 3.0, 1.0, 2.0):
        store.get(made, slow_map, {"factor": factor})
    assert [f for _, f in CALLS] == [1.0, 2.0, 3.0, 2.0]


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


# The caller's arrays


def an_image() -> tuple[dict[str, NDArray[Any]], Callable[..., Any]]:
    return {"pixels": np.ones((3, 4), np.float32), "mask": np.ones((3, 4), np.bool_)}, Image


def a_geolocation() -> tuple[dict[str, NDArray[Any]], Callable[..., Any]]:
    return {"gcps": np.ones((4, 5))}, Geolocation


def some_features() -> tuple[dict[str, NDArray[Any]], Callable[..., Any]]:
    given: dict[str, NDArray[Any]] = {name: np.ones(3) for name in ("scale", "angle", "score")}
    given |= {"level": np.ones(3, np.int64), "index": np.ones(3, np.int64), "subpixel": np.ones(3, np.bool_)}
    return {"xy": np.ones((3, 2)), "descriptors": np.ones((3, 8), np.float32), **given}, Features


def some_matches() -> tuple[dict[str, NDArray[Any]], Callable[..., Any]]:
    points: dict[str, NDArray[Any]] = {name: np.ones((3, 2)) for name in ("reference_xy", "secondary_xy")}
    columns: dict[str, NDArray[Any]] = {name: np.ones(3) for name in ("score", "rotation", "scale_ratio")}
    return {**points, **columns, "covariance": np.ones((3, 2, 2)), "origin": np.ones(3, np.int64)}, Matches


def a_registration() -> tuple[dict[str, NDArray[Any]], Callable[..., Any]]:
    def make(inliers: NDArray[Any], fsc: NDArray[Any]) -> Any:
        made = Registration(matches(3), {"fsc": fsc}, inliers, Translation(1, 0), "ok")
        return SimpleNamespace(inliers=made.inliers, fsc=made.stages["fsc"])

    return {"inliers": np.ones(3, np.bool_), "fsc": np.ones(3, np.bool_)}, make


def a_phase_history() -> tuple[dict[str, NDArray[Any]], Callable[..., Any]]:
    given: dict[str, NDArray[Any]] = {"samples": np.ones((3, 2), np.complex64), "frequencies": np.array([1.0, 2.0])}
    given |= {name: np.ones(3) for name in ("r0", "azimuth_deg", "autofocus_range", "autofocus_phase")}
    return {**given, "positions": np.ones((3, 3))}, PhaseHistory


def a_focus_result() -> tuple[dict[str, NDArray[Any]], Callable[..., Any]]:
    def make(**arrays: Any) -> FocusResult:
        rest: dict[str, Any] = {"status": "ok", "reason": "", "deviation": 0.1, "image_entropy": (2.0, 1.0)}
        return FocusResult(**arrays, iterations=1, **rest)

    given: dict[str, NDArray[Any]] = {name: np.ones(2) for name in ("phase", "entropy", "cells")}
    return {"image": np.ones((3, 4), np.complex64), **given}, make


def a_parking_lot() -> tuple[dict[str, NDArray[Any]], Callable[..., Any]]:
    given: dict[str, NDArray[Any]] = {name: np.ones(2) for name in ("amplitude", "aspect_deg", "persistence_deg")}
    return {"positions": np.ones((2, 3)), **given, "vehicles": np.ones((1, 5)), "targets": np.ones((1, 2))}, ParkingLot


@pytest.mark.parametrize(
    "case",
    [an_image, a_geolocation, some_features, some_matches, a_registration, a_phase_history, a_focus_result,
     a_parking_lot],
)  # fmt: skip
def test_the_caller_keeps_writing_to_what_was_given_and_changes_nothing(case: Callable[[], Any]) -> None:
    given, make = case()
    before = {name: array.copy() for name, array in given.items()}
    made = make(**given)
    for name, array in given.items():
        array[...] = 0
        np.testing.assert_array_equal(getattr(made, name), before[name], err_msg=name)
        with pytest.raises(ValueError, match="read-only"):
            getattr(made, name)[...] = 0


def test_what_is_locked_is_shared_and_what_is_a_view_of_the_open_is_not() -> None:
    pixels, mask = read_only(np.ones((3, 4), np.float32)), read_only(np.ones((3, 4), np.bool_))
    made = Image(pixels, mask)
    assert made.pixels is pixels
    assert made.mask is mask
    assert replace(made, name="again").pixels is pixels
    whole = np.ones((6, 4), np.float32)
    view = whole[:3]
    view.flags.writeable = False
    part = Image(view, mask)
    whole[:] = 0
    assert (part.pixels == 1).all()
    assert Image(pixels[1:], mask[1:]).pixels.base is pixels


def test_readers_give_their_arrays_away(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """An image is not copied once more where it is read, in whole or by windows, inside the scene or over its rim."""
    np.save(tmp_path / "scene.npy", np.arange(1.0, 1601.0, dtype=np.float32).reshape(40, 40))
    shared = []

    def seen(array: NDArray[Any]) -> NDArray[Any]:
        shared.append(kept(array) is array)
        return array

    monkeypatch.setattr("featreg.types.image.kept", seen)
    as_image(str(tmp_path / "scene.npy"))
    as_image(np.arange(1600.0).reshape(40, 40))
    source = RasterSource(str(tmp_path / "scene.npy"))
    for window in (Window(0, 0, 40, 40), Window(5, 5, 20, 20), Window(-5, 30, 20, 20)):
        source.read(window)
    assert shared == [True] * 10


def test_maps_that_are_true_everywhere_share_memory_that_nobody_writes_to() -> None:
    small, large = everywhere((3, 5)), everywhere((40, 50))
    assert small.shape == (3, 5)
    assert large.shape == (40, 50)
    assert all(one.all() and one.flags.c_contiguous and not one.flags.writeable for one in (small, large))
    assert np.shares_memory(everywhere((40, 50)), everywhere((7, 9)))
    assert kept(small) is small


def test_columns_are_shared_where_nobody_can_write_to_them_and_copied_elsewhere() -> None:
    own, free = np.zeros((3, 2)), np.zeros((3, 2))
    own.setflags(write=False)
    matches = Matches(own, free, np.zeros(3))
    assert matches.reference_xy is own
    free[0, 0] = 9.0
    assert matches.secondary_xy[0, 0] == 0.0
    view = free[:]
    view.setflags(write=False)
    turned = np.asfortranarray(own)
    turned.setflags(write=False)
    for other in (view, turned, own.astype(np.float32)):
        made = Matches(other, other, np.zeros(3)).reference_xy
        assert made is not other
        assert made.dtype == np.float64
    free[0, 0] = 5.0
    assert Matches(view, view, np.zeros(3)).reference_xy[0, 0] == 5.0


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
