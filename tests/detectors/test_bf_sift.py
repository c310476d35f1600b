"""BFSIFT: its detector, its descriptor, and the presets built on them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg import registry
from featreg.errors import ParameterError
from featreg.io import as_image
from featreg.sar.gradients.bilateral import (
    BilateralSpace,
    bilateral_field,
)
from featreg.sar.gradients.gradient_field import from_base
from featreg.sar.keypoints.gradient_histograms import dominant_orientation, gloh, normalised
from featreg.sar.pyramid import pyramid
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


def test_further_directions_make_further_keypoints_at_the_same_places(sar_texture: Texture) -> None:
    picture = as_image(sar_texture(150, 160))
    one, more = (detect(picture, n_features=100_000, second=share) for share in (1.0, 0.8))
    assert len(one) < len(more) < 2 * len(one)
    assert {tuple(p) for p in one.xy} == {tuple(p) for p in more.xy}
    assert {tuple(row) for row in zip(*one.xy.T, one.angle, strict=True)} <= {
        tuple(row) for row in zip(*more.xy.T, more.angle, strict=True)
    }
    assert len(detect(picture, n_features=50, second=0.8)) == 50


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
