"""Views of the amplitude against the same by OpenCV."""

from __future__ import annotations

import math
from functools import partial

import cv2
import numpy as np
import pytest

from featreg.sar.speckle import (
    BELOW_MEAN,
    FLOOR,
    despeckled,
    despeckled_bytes,
    despeckled_bytes_around,
    filled_amplitude,
    log_amplitude,
    mean_amplitude,
)
from featreg.types import Image


def speckled(height: int, width: int, *, holed: bool = False) -> Image:
    rng = np.random.default_rng(height)
    pixels = np.sqrt(rng.gamma(2, 0.5, (height, width))).astype(np.float32)
    valid = np.ones(pixels.shape, np.bool_)
    if holed:
        valid[5:20, 7:30] = False
    return Image(np.where(valid, pixels, 0).astype(np.float32), valid)


@pytest.mark.parametrize("shape", [(300, 600), (40, 70_000), (1, 50), (400, 9), (3, 3)])
@pytest.mark.parametrize("sigma", [0.7, 1.0, 2.5])
def test_views_are_those_of_opencv(shape: tuple[int, int], sigma: float) -> None:
    image = speckled(*shape, holed=min(shape) > 30)
    floor = FLOOR * mean_amplitude(image)
    log = cv2.log(np.maximum(filled_amplitude(image), np.float32(floor)))
    side = 2 * round(2.5 * sigma) + 1
    smooth = cv2.GaussianBlur(log, (side, side), sigma, borderType=cv2.BORDER_REFLECT_101)
    np.testing.assert_allclose(log_amplitude(image), log.reshape(shape), atol=1e-6)
    np.testing.assert_allclose(despeckled(image, sigma), smooth.reshape(shape), atol=2e-6)


def test_bytes_are_steps_around_the_mean_level() -> None:
    image = speckled(200, 300)
    view, steps = despeckled(image), despeckled_bytes(image)
    middle = math.log(mean_amplitude(image)) - BELOW_MEAN
    np.testing.assert_allclose(steps, 128 + 28 * (view - middle), atol=0.51)
    assert abs(float(steps.mean()) - 128) < 5


def test_the_darkest_and_brightest_pixels_do_not_fold_over() -> None:
    pixels = np.ones((60, 60), np.float32)
    pixels[:, 30:], pixels[:10, :10] = 1e-6, 1e3
    steps = despeckled_bytes(Image(pixels, np.ones(pixels.shape, np.bool_)))
    assert steps[5, 5] > steps[40, 10] >= steps[40, 50]


@pytest.mark.parametrize("shape", [(97, 61), (400, 333)])
def test_bytes_around_points_are_those_of_the_whole_view(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(3)
    pixels, mask = rng.gamma(1.0, 1.0, shape).astype(np.float32), rng.random(shape) > 0.02
    whole, image = despeckled_bytes(Image(pixels * mask, mask)), Image(pixels * mask, mask)
    corner = np.array(shape[::-1]) - 1
    points = np.array([[0, 0], corner, corner // 2])
    for some in (points[:0], points[:1], points, np.repeat(points, 99, axis=0)):
        found = despeckled_bytes_around(image, partial(np.asarray, some), len(some), 9)
        for x, y in some.tolist():
            around = np.s_[max(y - 9, 0) : y + 10, max(x - 9, 0) : x + 10]
            np.testing.assert_array_equal(found[around], whole[around])
        assert not found.flags.writeable
    np.testing.assert_array_equal(found, whole)
    np.testing.assert_array_equal(despeckled_bytes(image), whole)
