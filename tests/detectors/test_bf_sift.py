"""BFSIFT: bilateral scale space, its extrema, its descriptor, and the presets built on them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from featreg import registry
from featreg.errors import ParameterError
from featreg.io import as_image
from featreg.sar.gradients import bilateral
from featreg.sar.gradients.bilateral import (
    BilateralSpace,
    bilateral_extrema,
    bilateral_field,
    bilateral_level,
    noise_level,
)
from featreg.sar.gradients.gradient_field import from_base
from featreg.sar.keypoints.gradient_histograms import dominant_orientation, gloh, normalised
from featreg.sar.pyramid import pyramid
from featreg.sar.speckle import log_amplitude
from featreg.types import Features, Image
from made.keypoints import at

Texture = Callable[..., NDArray[np.float32]]


def detect(picture: Image, **parameters: Any) -> Features:
    return registry.create("detector", "bf-sift", **parameters).detect_features(picture)


def describe(picture: Image, features: Features, **parameters: Any) -> Features:
    return registry.create("descriptor", "bf-sift", **parameters).describe_features(picture, features)


def rows(picture: Image, features: Features) -> NDArray[np.float32]:
    found = describe(picture, features).descriptors
    assert found is not None
    return found.astype(np.float32)


def nearest_level(image: Image, space: BilateralSpace, sigma: float) -> tuple[Image, int]:
    """The octave's image and the number of the level whose sigma, in pixels of the image, is nearest by ratio."""
    levels = [
        (abs(math.log(space.sigma_of(k) * 2**octave / sigma)), level, k)
        for octave, level in enumerate(pyramid(image, 2, 2.0))
        for k in range(1, space.intervals + 1)
    ]
    return min(levels, key=lambda entry: entry[0])[1:]


# Scale space


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


def test_further_directions_make_further_keypoints_at_the_same_places(sar_texture: Texture) -> None:
    picture = as_image(sar_texture(150, 160))
    one, more = (detect(picture, n_features=100_000, second=share) for share in (1.0, 0.8))
    assert len(one) < len(more) < 2 * len(one)
    assert {tuple(p) for p in one.xy} == {tuple(p) for p in more.xy}
    assert {tuple(row) for row in zip(*one.xy.T, one.angle, strict=True)} <= {
        tuple(row) for row in zip(*more.xy.T, more.angle, strict=True)
    }
    assert len(detect(picture, n_features=50, second=0.8)) == 50


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


# Detector


@pytest.mark.parametrize("sign", [1, -1])
def test_blobs_are_found_at_their_centre_and_scale(sign: int) -> None:
    y, x = np.mgrid[:160, :160]
    scales = {}
    for sigma in (2.0, 3.5):
        blob = sign * np.exp(-((x - 80.3) ** 2 + (y - 75.6) ** 2) / (2 * sigma**2))
        found = detect(as_image(np.exp(blob).astype(np.float32)), tone=1e4, support=4.0)
        np.testing.assert_allclose(found.xy[0], [80.3, 75.6], atol=0.25)
        scales[sigma] = found.scale[0]
    assert scales[3.5] > scales[2.0]


@pytest.mark.parametrize(
    ("n_features", "thin", "all_scales"), [(727, True, False), (727, False, True), (728, True, True)]
)
def test_the_coarsest_scale_of_an_octave_is_not_needed_where_there_are_pixels_enough(
    sar_texture: Texture, n_features: int, thin: bool, all_scales: bool
) -> None:
    found = detect(as_image(sar_texture(200, 200)), n_features=n_features, thin=thin, quota_decay=1.0, support=4.0)
    assert np.isin([0, 3], found.level).all()
    assert (np.isin([2, 5], found.level) == all_scales).all()


def test_the_smaller_of_a_pair_decides_on_the_scales_of_both(sar_texture: Texture) -> None:
    large, small = as_image(sar_texture(200, 200)), as_image(sar_texture(198, 200))
    found = registry.create("detector", "bf-sift", n_features=725, quota_decay=1.0, support=4.0)
    for pair, all_scales in (((large, large), False), ((large, small), True), ((small, large), True)):
        levels = found.for_pair(*pair).detect_features(large).level
        assert (np.isin([2, 5], levels) == all_scales).all()


def test_gain_changes_nothing(sar_texture: Texture) -> None:
    amplitude = sar_texture(200, 200)
    first, second = (detect(as_image(a), n_features=500) for a in (amplitude, amplitude * np.float32(1000)))
    apart = np.hypot(*(first.xy[:, None] - second.xy[None]).transpose(2, 0, 1)).min(axis=1)
    assert (apart < 0.01).mean() > 0.99


def test_the_orientation_is_that_of_a_ramp_at_any_scale() -> None:
    """A blob on a slope that climbs towards 30 degrees, which outweighs it."""
    y, x = np.mgrid[:160, :160] - 80.0
    slope = 0.03 * (x * math.cos(math.pi / 6) - y * math.sin(math.pi / 6))
    picture = as_image(np.exp(slope + 0.05 * np.exp(-(x**2 + y**2) / 8)).astype(np.float32))
    for scale in (0.5, 1.0, 1.5, 10.0):
        found = detect(picture, tone=1e4, support=4.0, threshold=0.005, orientation_scale=scale)
        middle = np.hypot(*(found.xy - 80).T) < 1
        assert middle.any()
        np.testing.assert_allclose(found.angle[middle] % (2 * math.pi), math.pi / 6, atol=0.1)


@pytest.mark.parametrize("coarser", [1.0, 1.5])
def test_the_orientation_is_read_from_a_level_and_a_disc_that_grow_with_the_point(
    coarser: float, sar_texture: Texture
) -> None:
    picture, space = as_image(sar_texture()), BilateralSpace()
    found = detect(picture, orientation_scale=coarser)
    for scale in np.unique(found.scale):
        some = found.take(np.flatnonzero(found.scale == scale))
        level, k = nearest_level(picture, space, coarser * scale / 8)
        radius = np.full(len(some), 0.5 * coarser * scale * level.shape[1] / picture.shape[1])
        xy = from_base(some.xy, level, picture)
        wanted = dominant_orientation(bilateral_field(level, space, k), xy, radius)
        np.testing.assert_allclose(some.angle, wanted, atol=1e-6)
    assert len(np.unique(found.scale)) > 3


def test_the_budget_is_kept_and_the_best_come_first(sar_texture: Texture) -> None:
    for n_features in (1, 50, 10**5):
        found = detect(as_image(sar_texture()), n_features=n_features)
        assert 0 < len(found) <= n_features
        assert (np.diff(found.score) <= 0).all()
        assert found.score.min() > 0.04


def test_points_follow_a_scene_that_is_turned(sar_texture: Texture) -> None:
    amplitude = sar_texture(240, 240)
    first = detect(as_image(amplitude), n_features=200)
    second = detect(as_image(np.rot90(amplitude).copy()), n_features=200)
    moved = np.column_stack([first.xy[:, 1], 239 - first.xy[:, 0]])
    apart = np.hypot(*(moved[:, None] - second.xy[None]).transpose(2, 0, 1)).min(axis=1)
    assert (apart < 0.1).mean() > 0.9


def test_no_support_touches_nodata_and_what_lies_there_has_no_influence(sar_texture: Texture) -> None:
    amplitude = sar_texture(240, 240)
    mask = np.ones(amplitude.shape, np.bool_)
    mask[100:130, 120:150] = False
    pictures = [as_image(a, mask=mask) for a in (amplitude, np.where(mask, amplitude, 99).astype(np.float32))]
    first, second = (detect(p) for p in pictures)
    np.testing.assert_array_equal(first.xy, second.xy)
    y, x = np.nonzero(~np.pad(mask, 1))
    apart = np.hypot(first.xy[:, None, 0] + 1 - x, first.xy[:, None, 1] + 1 - y).min(axis=1)
    assert (apart >= first.scale - 2).all()
    one, two = (describe(p, first).descriptors for p in pictures)
    np.testing.assert_array_equal(one, two)


# Descriptor


@pytest.mark.parametrize("scale", [8.1, 10.2, 12.8, 16.2, 20.4])
def test_descriptors_are_of_the_level_half_as_coarse_again_as_the_point(scale: float, sar_texture: Texture) -> None:
    picture, space = as_image(sar_texture()), BilateralSpace()
    points = at(np.random.default_rng(0).uniform(30, 170, (20, 2)), scale, 0.4)
    level, k = nearest_level(picture, space, 1.5 * scale / 8)
    smaller = level.shape[1] / picture.shape[1]
    xy = from_base(points.xy, level, picture)
    wanted = normalised(gloh(bilateral_field(level, space, k), xy, points.scale * smaller, points.angle))
    np.testing.assert_allclose(rows(picture, points), wanted, atol=1e-6)


def test_an_image_twice_as_large_is_described_alike_in_its_first_octave(sar_texture: Texture) -> None:
    """Halving the image whose pixels are all doubled gives the image back."""
    amplitude, xy = sar_texture(150, 160), np.random.default_rng(0).uniform(30, 120, (20, 2))
    large = as_image(amplitude.repeat(2, axis=0).repeat(2, axis=1))
    small = rows(as_image(amplitude), at(xy, 12.0, 0.4))
    np.testing.assert_allclose(rows(large, at(2 * xy + 0.5, 24.0, 0.4)), small, atol=1e-5)


def test_turning_image_and_point_by_a_quarter_keeps_the_descriptor(sar_texture: Texture) -> None:
    amplitude = sar_texture()
    xy = np.random.default_rng(0).integers(50, 150, (40, 2)).astype(np.float64)
    turned = np.column_stack([xy[:, 1], amplitude.shape[1] - 1 - xy[:, 0]])
    blank = np.zeros(40)
    pair = [
        describe(picture, Features(at, blank + 12, blank + angle, blank, blank.astype(np.int64))).descriptors
        for picture, at, angle in (
            (as_image(amplitude), xy, 0.4),
            (as_image(np.rot90(amplitude).copy()), turned, 0.4 + math.pi / 2),
        )
    ]
    assert pair[0] is not None
    assert pair[1] is not None
    length = np.linalg.norm(pair[0], axis=1) * np.linalg.norm(pair[1], axis=1)
    assert (np.einsum("ij,ij->i", pair[0], pair[1]) / length).min() > 0.95


@pytest.mark.parametrize(
    ("kind", "parameters"),
    [
        ("detector", {"octaves": 0}),
        ("detector", {"intervals": 0}),
        ("detector", {"tone": 0.0}),
        ("detector", {"sigma": float("nan")}),
        ("detector", {"threshold": -1.0}),
        ("detector", {"quota_decay": 0.9}),
        ("detector", {"orientation_scale": 0.0}),
        ("descriptor", {"support": 0.0}),
        ("descriptor", {"coarser": -1.0}),
        ("descriptor", {"step": 1.0}),
    ],
    ids=str,
)
def test_impossible_parameters_are_refused(kind: Any, parameters: dict[str, Any]) -> None:
    with pytest.raises(ParameterError):
        registry.create(kind, "bf-sift", **parameters)
