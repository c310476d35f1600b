"""Arrays that the caller gave are neither locked nor shared, and what nobody writes to is not copied."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.focusing.phase_history import PhaseHistory
from featreg.focusing.result import FocusResult
from featreg.geometry import Translation
from featreg.io import as_image
from featreg.io.raster_source import RasterSource
from featreg.io.window import Window
from featreg.results.registration import Registration
from featreg.simulate.circle import ParkingLot
from featreg.types import Features, Geolocation, Image, Matches, everywhere, kept, read_only


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
        made = Registration(
            Matches(np.ones((3, 2)), np.ones((3, 2)), np.ones(3)), {"fsc": fsc}, inliers, Translation(1, 0), "ok"
        )
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
