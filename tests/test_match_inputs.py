"""What `match` takes: files, arrays, gains, masks, images of any size; the caller's arrays stay as they are."""

from __future__ import annotations

import threading
import warnings
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg.errors import InputError
from featreg.simulate import SimulatedPair
from made.matched import assert_same_bits, matched
from made.models import grid_rmse


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


# Determinism


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

    plain = matched(pair)
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
    by_array = matched(pair, reference_mask=mask)
    by_polygon = matched(pair, reference_mask=[(-0.5, -0.5), (199.5, -0.5), (199.5, 299.5), (-0.5, 299.5)])
    assert_same_bits(by_array, by_polygon)
    assert by_array.matches.reference_xy[:, 0].max() < 200 - 15
    assert by_array.matches.secondary_xy[:, 0].max() > 200  # the other image is whole
    other = matched(pair, secondary_mask=mask)
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
