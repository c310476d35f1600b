"""An image and the maps derived from it: each is computed once, none can be written to."""

from __future__ import annotations

import pickle
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.types import Image
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
