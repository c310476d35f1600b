"""Two images on one grid: resampling of images longer than OpenCV takes."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from featreg.geometry import Affine, Homography
from featreg.interfaces import Model
from featreg.pipeline import aligned
from featreg.pipeline.aligned import WholeWindows
from featreg.runtime.threads import limited_threads
from featreg.sar.correlation import Peaks
from featreg.types import BoolArray, FloatArray, Image

#: A map that turns, shifts and widens a little, and one that bends as well.
AFFINE = Affine(np.array([[1.02, -0.03, 9.3], [0.03, 0.99, -4.6]]))
BENT = Homography(np.array([[1.02, -0.03, 9.3], [0.03, 0.99, -4.6], [2e-5, -1e-5, 1.0]]))


@pytest.mark.parametrize("model", [AFFINE, BENT])
@pytest.mark.parametrize(
    ("flags", "border"), [(cv2.INTER_LINEAR, cv2.BORDER_REPLICATE), (cv2.INTER_NEAREST, cv2.BORDER_CONSTANT)]
)
def test_parts_give_the_whole(model: Model, flags: int, border: int, monkeypatch: pytest.MonkeyPatch) -> None:
    view = np.random.default_rng(0).random((90, 140), np.float32)
    whole = aligned.warped(view, model, (100, 130), flags, border)
    monkeypatch.setattr(aligned, "MOST_SIDE", 50)
    monkeypatch.setattr(aligned, "PART_SIDE", 37)
    parts = aligned.warped(view, model, (100, 130), flags, border)
    # OpenCV rounds positions to a 32nd of a pixel, an affine map's otherwise than a grid's.
    wrong = np.abs(parts - whole) > 0.1
    assert wrong.mean() < (0.03 if flags == cv2.INTER_NEAREST and model is AFFINE else 0.001)


@pytest.mark.parametrize(
    "matrix",
    [
        [[1.04, -0.11, 19.7], [0.11, 1.03, -47.5]],
        [[1, 0, 0], [0, 1, 0]],
        [[-1, 0.02, 140], [-0.02, -1, 95]],
        [[0.5, 0, -1e6], [0, 2, 3]],
        [[20, 3, -500], [4, 22, -100]],
    ],
)
def test_an_affine_map_is_followed_to_a_thousandth_of_a_pixel(
    matrix: list[list[float]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Turned, as it is, upside down, wholly beyond the rim, and stretched; by parts the same bits."""
    view = np.random.default_rng(0).random((90, 150), np.float32)
    model, shape = Affine(np.array(matrix, np.float64)), (100, 333)
    found = aligned.resampled(view, model, shape)
    x, y = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
    at = np.clip(model(np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)), 0, [149, 89])
    left, top = np.minimum(at.astype(int), [148, 88]).T
    u, v = (at - np.column_stack([left, top])).T
    fine = view.astype(np.float64)
    upper, lower = ((1 - u) * fine[row, left] + u * fine[row, left + 1] for row in (top, top + 1))
    np.testing.assert_allclose(found.ravel(), (1 - v) * upper + v * lower, atol=1e-3)
    monkeypatch.setattr("featreg.runtime.threads.LEAST", 1)
    with limited_threads(2):
        np.testing.assert_array_equal(aligned.resampled(view, model, shape), found)


def test_maps_of_one_row_and_wide_stretches_are_resampled_too() -> None:
    row = np.arange(40, dtype=np.float32)[None]
    shift = Affine(np.array([[1, 0, 0.25], [0, 1, 0]]))
    np.testing.assert_allclose(aligned.resampled(row, shift, (1, 39))[0], np.arange(39) + 0.25, atol=0.02)
    wide = Affine(np.array([[300.0, 0, 0], [0, 300.0, 0]]))
    assert aligned.resampled(np.full((50, 60), 2.5, np.float32), wide, (20, 30)).tolist() == [[2.5] * 30] * 20


def test_an_image_longer_than_opencv_takes_is_resampled() -> None:
    view = np.tile(np.arange(40_000, dtype=np.float32), (3, 1))
    shift = Affine(np.array([[1, 0, 1000.5], [0, 1, 0]]))
    for model in (shift, Homography(shift.matrix)):
        moved = aligned.warped(view, model, (3, 38_000), cv2.INTER_LINEAR, cv2.BORDER_REPLICATE)
        np.testing.assert_allclose(moved[1], np.arange(38_000) + 1000.5, atol=0.02)


@pytest.mark.parametrize("turned", [0.0, 25.0, 45.0])
def test_windows_that_are_whole_hold_nothing_invalid(turned: float) -> None:
    """Against every pixel of every window; with the margin, hardly a whole one is refused."""
    rng = np.random.default_rng(3)
    mask = np.ones((200, 220), np.bool_)
    mask[rng.integers(0, 200, 12), rng.integers(0, 220, 12)] = False
    mask[150:, :40] = False
    pixels = rng.gamma(4, 0.25, mask.shape).astype(np.float32)
    reference, secondary = Image(pixels, np.ones_like(mask)), Image(pixels * mask, mask)
    turn = np.radians(turned)
    linear = 1.1 * np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    model = Affine(np.column_stack([linear, np.array([110.0, 100.0]) - linear @ (110.0, 100.0)]))
    xy = np.column_stack([rng.integers(20, 200, 400), rng.integers(20, 180, 400)])

    def whole(half: int) -> BoolArray:
        away = np.stack(np.meshgrid(*[np.arange(-half, half + 0.1, 0.5)] * 2), -1).reshape(-1, 2)
        x, y = np.rint(model((xy[:, None] + away).reshape(-1, 2))).astype(int).T
        inside = (x >= 0) & (y >= 0) & (x < 220) & (y < 200)
        return np.asarray((inside & mask[np.clip(y, 0, 199), np.clip(x, 0, 219)]).reshape(400, -1).all(axis=1))

    found = WholeWindows(reference, secondary, model, 8).in_secondary(xy)
    assert 20 < found.sum() < 380
    assert whole(8)[found].all()
    assert found[whole(8 + 4 + 5)].all()


def test_a_window_of_which_a_model_knows_nothing_leaves_the_others_as_they_are() -> None:
    class Known:
        """The identity, to the right of x = 50 only."""

        matrix = None

        def __call__(self, xy: FloatArray) -> FloatArray:
            return np.where(xy[:, :1] < 50, np.nan, xy)

    mask = np.ones((120, 200), np.bool_)
    # Away from the middle, the corners and the middles of the sides of the window around it.
    mask[60, 105] = False
    secondary = Image(np.where(mask, np.float32(1), np.float32(0)), mask)
    model: Any = Known()
    whole = WholeWindows(Image(np.ones(mask.shape, np.float32), np.ones_like(mask)), secondary, model, 20)
    found = whole.in_secondary(np.array([[30, 60], [100, 60], [160, 60]]))
    assert found.tolist() == [False, False, True]


def test_covariances_and_lengths_are_those_of_matrices() -> None:
    rng = np.random.default_rng(5)
    root = rng.normal(size=(50, 2, 2))
    curvature = root @ root.swapaxes(1, 2) + 0.1 * np.eye(2)
    found = Peaks(np.zeros((50, 2)), rng.uniform(0.3, 1.0, 50), curvature, np.ones(50, np.bool_))
    xy = rng.uniform(0, 300, (50, 2))
    for model in (AFFINE, BENT):
        linear = aligned.linear_parts(model, xy)
        wanted = (1 - found.height**2)[:, None, None] * (linear @ np.linalg.inv(curvature) @ linear.swapaxes(1, 2))
        covariance = aligned.peak_covariance(found, model, xy)
        np.testing.assert_allclose(covariance, wanted, rtol=1e-9)
    away = rng.normal(size=(50, 2))
    squared = np.einsum("ni,nij,nj->n", away, np.linalg.inv(wanted), away)
    assert aligned.variance_factor(away, covariance) == pytest.approx(np.median(squared) / (2 * np.log(2)), rel=1e-9)
    assert np.isnan(aligned.variance_factor(away, 0 * covariance))
