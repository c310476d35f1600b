"""Views in windows around points: the same as those of whole images."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.geometry import Affine
from featreg.io import as_image
from featreg.pipeline.aligned import local_affines, resampled
from featreg.runtime.threads import limited_threads
from featreg.sar.correlation_filter import correlation_filter, filter_of_squares, square_corners
from featreg.sar.speckle import despeckled, despeckled_halved, log_amplitude
from featreg.sar.windows import (
    MOST_STRETCHED,
    aligned_windows,
    as_map,
    compact,
    few,
    gaussian,
    log_windows,
    places,
)
from featreg.types import Image

SIDE = 21


@pytest.fixture(scope="module")
def image() -> Image:
    return as_image(np.random.default_rng(0).gamma(2.0, 1.0, (130, 151)).astype(np.float32))


def corners(count: int = 40, shape: tuple[int, int] = (130, 151)) -> NDArray[np.int64]:
    """Corners of windows in an image, of which some reach beyond its rim by less than half."""
    rng = np.random.default_rng(1)
    return np.column_stack([rng.integers(-8, n - SIDE + 8, count) for n in shape[::-1]])


def cut(view: NDArray[np.float32], at: NDArray[np.int64]) -> NDArray[np.float32]:
    """The windows of a whole map, mirrored beyond its rim."""
    wide = np.pad(view, SIDE, mode="reflect")
    return np.stack([wide[y + SIDE : y + 2 * SIDE, x + SIDE : x + 2 * SIDE] for x, y in at])


def test_windows_of_the_log_amplitude_are_those_of_the_whole_map(image: Image) -> None:
    found = log_windows(image, corners(), SIDE)
    np.testing.assert_allclose(found, cut(log_amplitude(image), corners()), atol=1e-5)


def test_smoothed_windows_are_those_of_the_whole_map(image: Image) -> None:
    for sigma in (0.7, 1.0):
        found = log_windows(image, corners(), SIDE, gaussian(sigma))
        np.testing.assert_allclose(found, cut(despeckled(image, sigma), corners()), atol=1e-5)


@pytest.mark.parametrize(
    "matrix",
    [
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        [[0.98, 0.2, -3.3], [-0.19, 1.03, 9.7]],
        [[0.0, -1.2, 160.0], [1.2, 0.0, -20.0]],
    ],
)
def test_windows_on_another_grid_are_those_of_the_resampled_map(image: Image, matrix: list[list[float]]) -> None:
    """Also where the grid is another size, and where what it maps to lies beyond the rim of the image."""
    model, shape = Affine(np.array(matrix)), (110, 140)
    at = corners(shape=shape)
    maps = local_affines(model, at.astype(np.float64) + (SIDE - 1) / 2)
    found = aligned_windows(image, maps, shape, at, SIDE, gaussian(1.0))
    wanted = cut(resampled(despeckled(image), model, shape), at)
    # OpenCV 4 interpolates at steps of 1/32 px.
    assert np.abs(found - wanted).max() < 0.05
    assert np.sqrt(np.mean((found - wanted) ** 2)) < 0.01


@pytest.mark.parametrize(("x", "y"), [(5000, -5000), (-5000, 30), (170, 5000), (-45, -60)])
def test_windows_that_lie_wholly_beyond_the_image_are_its_rim(image: Image, x: int, y: int) -> None:
    at, smooth = np.array([[10, 10], [11, 14]]), despeckled(image)
    far = np.tile([[[1.0, 0.0, x], [0.0, 1.0, y]]], (2, 1, 1))
    found = aligned_windows(image, far, image.shape, at, SIDE, gaussian(1.0))
    for window, (left, top) in zip(found, at, strict=True):
        columns = np.clip(x + left + np.arange(SIDE), 0, 150)
        rows = np.clip(y + top + np.arange(SIDE), 0, 129)
        np.testing.assert_allclose(window, smooth[np.ix_(rows, columns)], atol=1e-2)


def test_filtered_windows_are_those_of_the_filtered_map(image: Image) -> None:
    noise = np.random.default_rng(2).gamma(4.0, 0.25, image.shape).astype(np.float32)
    other = log_amplitude(as_image(image.amplitude * noise))
    view = log_amplitude(image)
    best = correlation_filter(view, other, square_corners(view.shape))
    assert best is not None
    at = square_corners(image.shape)
    squares = (np.stack([v[y : y + 32, x : x + 32] for x, y in at]) for v in (view, other))
    again = filter_of_squares(*squares)
    assert again is not None
    np.testing.assert_array_equal(again.across, best.across)
    found = log_windows(image, corners(), SIDE, filtered=best.taps)
    np.testing.assert_allclose(found, cut(best.applied(view), corners()), atol=2e-4)


def test_the_same_bits_on_any_number_of_threads(image: Image) -> None:
    at = np.tile(corners(), (5, 1))
    maps = local_affines(Affine(np.array([[0.98, 0.2, -3.3], [-0.19, 1.03, 9.7]])), at.astype(np.float64) + 10)
    one = aligned_windows(image, maps, image.shape, at, SIDE)
    for threads in (2, 3):
        with limited_threads(threads):
            np.testing.assert_array_equal(aligned_windows(image, maps, image.shape, at, SIDE), one)


def test_a_map_of_windows_holds_each_at_its_place(image: Image) -> None:
    found = log_windows(image, corners(), SIDE)
    x, y = places(len(found), SIDE, 4).T
    np.testing.assert_array_equal(as_map(found)[y, x], found[:, 4, 4])


def test_no_points_no_windows(image: Image) -> None:
    nothing = np.zeros((0, 2), np.int64)
    assert log_windows(image, nothing, SIDE).shape == (0, SIDE, SIDE)
    assert aligned_windows(image, np.zeros((0, 2, 3)), image.shape, nothing, SIDE).shape == (0, SIDE, SIDE)


def test_windows_are_for_few_points_and_maps_that_stretch_little() -> None:
    assert few(10, 20, (100, 100))
    assert not few(25, 20, (100, 100))
    plain = np.tile(np.eye(2, 3), (2, 1, 1))
    wide, unknown = plain[:1] * 1.01 * MOST_STRETCHED, np.where(plain[:1] > 0, np.nan, plain[:1])
    assert compact(np.concatenate([plain, wide, unknown])).tolist() == [True, True, False, False]


@pytest.mark.parametrize("shape", [(64, 64), (65, 77)])
def test_the_despeckled_view_at_half_size_is_its_mean_over_squares(shape: tuple[int, int]) -> None:
    image = as_image(np.random.default_rng(0).gamma(2.0, 1.0, shape).astype(np.float32))
    height, width = (n // 2 for n in shape)
    whole = despeckled(image)[: 2 * height, : 2 * width].reshape(height, 2, width, 2)
    np.testing.assert_allclose(despeckled_halved(image), whole.mean(axis=(1, 3)), atol=1e-5)
