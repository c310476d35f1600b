"""The bilateral scale space of BFSIFT: its noise, its levels, their extrema and gradients."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.io import as_image
from featreg.sar.gradients import bilateral
from featreg.sar.gradients.bilateral import (
    BilateralSpace,
    bilateral_extrema,
    bilateral_field,
    bilateral_level,
    noise_level,
)
from featreg.sar.speckle import log_amplitude
from featreg.types import Image

Texture = Callable[..., NDArray[np.float32]]


def bilateral_levels(picture: Image, space: BilateralSpace) -> NDArray[np.float32]:
    """All levels of an octave, one behind the other."""
    return np.stack([bilateral_level(picture, space, k) for k in range(space.intervals + 3)])


@pytest.mark.parametrize(("looks", "wanted"), [(1.0, 0.576), (4.0, 0.259), (16.0, 0.126)])
def test_the_noise_is_that_of_the_speckle(looks: float, wanted: float) -> None:
    """By the median difference of log-amplitudes, for one look 1.4826 / sqrt(2) * log(3) / 2 of a logistic law.

    The standard deviation itself, half the root of trigamma(L), is 0.641, 0.266 and 0.127.
    """
    speckle = np.sqrt(np.random.default_rng(0).gamma(looks, 1 / looks, (300, 300))).astype(np.float32)
    assert noise_level(as_image(speckle)) == pytest.approx(wanted, rel=0.05)


def test_the_exact_filter_takes_the_noise_of_all_pixels() -> None:
    """Of columns that look the same in pairs, of which some differences are seen and not others."""
    picture = as_image(np.repeat(np.random.default_rng(0).gamma(2.0, size=(200, 100)), 2, axis=1))
    view = log_amplitude(picture)
    both = np.concatenate([np.abs(np.diff(view, axis=axis)).ravel() for axis in (0, 1)])
    wanted = 1.4826 / math.sqrt(2) * np.median(both)
    assert noise_level(picture, whole=True) == pytest.approx(wanted, rel=1e-6)
    assert noise_level(picture) != pytest.approx(wanted, rel=1e-3)
    level = bilateral_level(picture, BilateralSpace(tone=0.7, exact=True), 0)
    np.testing.assert_array_equal(level, cv2.bilateralFilter(view, 5, 0.7 * wanted, 1.2))


@pytest.mark.parametrize("exact", [True, False])
def test_levels_get_smoother_and_keep_a_strong_edge(exact: bool) -> None:
    rng = np.random.default_rng(0)
    speckle = np.sqrt(rng.gamma(16, 1 / 16, (120, 120)))
    step = np.where(np.arange(120) < 60, 1.0, 20.0)
    picture = as_image((speckle * step).astype(np.float32))
    levels = bilateral_levels(picture, BilateralSpace(exact=exact))
    spread = levels[:, 20:100, 10:45].std(axis=(1, 2))
    assert (np.diff(spread) < 0).all()
    jump = levels[:, 20:100, 61] - levels[:, 20:100, 58]
    assert (jump.mean(axis=1) > 0.9 * math.log(20)).all()


@pytest.mark.parametrize("shape", [(50, 61), (16, 16), (17, 128)], ids=str)
@pytest.mark.parametrize(("sigma", "tone"), [(1.2, 5.0), (4.0, 0.5), (12.0, 2.0)])
def test_the_first_level_of_the_cascade_is_the_weighted_mean_that_it_is_said_to_be(
    shape: tuple[int, int], sigma: float, tone: float
) -> None:
    """Against the sums over the disc, pixel by pixel, also where the window is larger than the image."""
    amplitude = np.sqrt(np.random.default_rng(0).gamma(1.0, 1.0, shape)).astype(np.float32)
    picture = as_image(amplitude)
    found = bilateral_levels(picture, BilateralSpace(sigma=sigma, tone=tone))[0]
    image, scale, reach = log_amplitude(picture).astype(np.float64), tone * noise_level(picture), round(1.5 * sigma)
    padded = np.pad(image, reach, mode="reflect")
    total, weights = np.zeros(shape), np.zeros(shape)
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            if dx * dx + dy * dy > reach * reach:
                continue
            value = padded[reach + dy :, reach + dx :][: shape[0], : shape[1]]
            far = np.maximum(0, 1 - ((value - image) / scale) ** 2 / 16) ** 8
            weight = math.exp(-(dx * dx + dy * dy) / (2 * sigma * sigma)) * far
            total += weight * value
            weights += weight
    np.testing.assert_allclose(found, total / weights, atol=1e-5)


def test_the_cascade_is_opencvs_bilateral_filter_again_and_again(sar_texture: Texture) -> None:
    """Its weight of differences falls off a little sooner than a Gaussian, which shows at single pixels only."""
    import cv2

    picture = as_image(sar_texture(120, 150))
    space = BilateralSpace()
    wanted: Any = log_amplitude(picture)
    held = 0.0
    for k, found in enumerate(bilateral_levels(picture, space)):
        missing = math.sqrt(space.sigma_of(k) ** 2 - held**2)
        side, tone = 2 * round(1.5 * missing) + 1, space.tone * noise_level(picture)
        wanted = cv2.bilateralFilter(wanted, side, tone, missing, borderType=cv2.BORDER_REFLECT_101)
        held = space.sigma_of(k)
        assert np.abs(found - wanted).max() < 0.05
        assert (found - wanted).std() < 0.01 * wanted.std()


@pytest.mark.parametrize("axis", [0, 1])
def test_the_levels_of_a_mirrored_image_are_mirrored(axis: int) -> None:
    """Of a periodic image, whose noise is read from the same differences either way."""
    row = np.random.default_rng(0).uniform(0.5, 1.5, (41, 47))
    amplitude = (row + row[::-1] + row[:, ::-1] + row[::-1, ::-1]) * np.linspace(1, 3, 47)
    space = BilateralSpace(tone=1e4)
    first, second = (
        bilateral_levels(as_image(a.astype(np.float32)), space) for a in (amplitude, np.flip(amplitude, axis))
    )
    np.testing.assert_allclose(first, np.flip(second, axis + 1), atol=1e-6)


@pytest.mark.parametrize("sigma", [1.2, 3.5])
@pytest.mark.parametrize("axis", [0, 1])
def test_smoothing_a_mirrored_image_mirrors_the_result_to_the_bit(sigma: float, axis: int) -> None:
    values = np.random.default_rng(0).normal(size=(41, 150)).astype(np.float32)
    first, second = np.empty_like(values), np.empty_like(values)
    bilateral._smooth(values, sigma, 0.8, first)
    bilateral._smooth(np.flip(values, axis).copy(), sigma, 0.8, second)
    np.testing.assert_array_equal(np.flip(second, axis), first)


@pytest.mark.parametrize("tone", [1e-40, 1e40])
def test_the_tone_may_be_next_to_nothing_and_without_end(tone: float, sar_texture: Texture) -> None:
    picture = as_image(sar_texture(60, 60))
    levels = bilateral_levels(picture, BilateralSpace(tone=tone))
    assert np.isfinite(levels).all()
    unchanged = np.array_equal(levels[0], log_amplitude(picture))
    assert unchanged == (tone < 1)


@pytest.mark.parametrize("tied", [False, True])
@pytest.mark.parametrize("shape", [(4, 90, 67), (6, 64, 200), (5, 3, 9), (5, 2, 50), (5, 50, 2)], ids=str)
def test_extrema_are_those_among_26_neighbours(shape: tuple[int, int, int], tied: bool) -> None:
    """Against the filters of scipy, also where many neighbours are equal, of which the first counts."""
    from scipy.ndimage import maximum_filter

    from featreg.sar.gradients import bilateral_kernels

    rng = np.random.default_rng(0)
    levels = (rng.integers(0, 4, shape) if tied else rng.normal(size=shape)).astype(np.float32)
    differences = levels[1:] - levels[:-1]
    earlier = np.array([[1, 1, 1], [1, 0, 0], [0, 0, 0]], np.bool_)
    at, some = np.empty(shape[1] * shape[2], np.int64), 0
    for k in range(1, shape[0] - 2):
        first, finer, coarser, last = levels[k - 1 : k + 3]
        count = bilateral_kernels.extrema(first, finer, coarser, last, np.float32(0.5), at)
        some += count
        wanted = np.zeros(shape[1:], np.bool_)
        for sign in (1, -1):
            here = sign * differences[k]
            top = maximum_filter(sign * differences[k - 1 : k + 2], size=3, mode="nearest")[1]
            wanted |= (here >= top) & (here > maximum_filter(here, footprint=earlier)) & (here > 0.5)
        wanted[[0, -1]] = False
        wanted[:, [0, -1]] = False
        np.testing.assert_array_equal(at[:count], np.flatnonzero(wanted))
    assert some or min(shape) < 4


def test_extrema_of_an_image_lie_in_its_own_levels(sar_texture: Texture) -> None:
    picture, space = as_image(sar_texture(60, 80)), BilateralSpace()
    levels = bilateral_levels(picture, space)
    found = [bilateral_extrema(picture, space, interval, 0.05) for interval in range(space.intervals)]
    assert sum(map(len, found)) > 0
    for k, flat in enumerate(found, start=1):
        assert (np.abs((levels[k + 1] - levels[k]).ravel()[flat]) > 0.05).all()


def test_a_wide_tone_is_a_gaussian(sar_texture: Texture) -> None:
    """Without the weight of the differences, the exact filter is a truncated, normalised Gaussian in a disc."""
    from scipy.ndimage import correlate

    picture = as_image(sar_texture(60, 60))
    found = bilateral_levels(picture, BilateralSpace(sigma=2.0, tone=1e4, exact=True))[0]
    y, x = np.mgrid[-3:4, -3:4]
    kernel = np.exp(-(x**2 + y**2) / 8.0) * (x**2 + y**2 <= 9)
    wanted = correlate(log_amplitude(picture).astype(np.float64), kernel / kernel.sum(), mode="mirror")
    np.testing.assert_allclose(found, wanted, atol=2e-3)


def test_gradients_point_up_a_ramp() -> None:
    x = np.mgrid[:60, :60][1]
    field = bilateral_field(as_image(np.exp(0.05 * x).astype(np.float32)), BilateralSpace(), 1)
    np.testing.assert_allclose(field.x[20:40, 20:40], 0.05, rtol=0.05)
    assert np.abs(field.y[20:40, 20:40]).max() < 0.02 * 0.05


def test_gradients_beside_nodata_are_none(sar_texture: Texture) -> None:
    mask = np.ones((60, 70), np.bool_)
    mask[20:30, 35:42] = False
    y, x = np.mgrid[:60, :70]
    apart = np.maximum(np.maximum(20 - y, y - 29), np.maximum(35 - x, x - 41))
    field = bilateral_field(as_image(sar_texture(60, 70), mask=mask), BilateralSpace(), 1)
    length = np.hypot(field.x, field.y)
    assert not length[apart <= 1].any()
    assert (length[apart == 2] > 0).all()
