"""SAR-SIFT: the SAR-Harris detector and the ratio GLOH descriptor."""

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
from featreg.types import Features, Image
from made.keypoints import at

Texture = Callable[..., NDArray[np.float32]]


def detect(picture: Image, **parameters: Any) -> Features:
    return registry.create("detector", "sar-harris", **parameters).detect_features(picture)


def describe(picture: Image, features: Features, **parameters: Any) -> NDArray[np.float32]:
    found = registry.create("descriptor", "ratio-gloh", **parameters).describe_features(picture, features).descriptors
    assert found is not None
    return found.astype(np.float32)


# Detector


def test_points_follow_a_scene_that_moves_by_a_fraction_of_a_pixel(sar_texture: Texture) -> None:
    from scipy.ndimage import fourier_shift, gaussian_filter

    shift = np.array([0.4, -0.3])
    smooth = gaussian_filter(sar_texture(240, 240).astype(np.float64), 1.2, mode="wrap")
    moved = np.maximum(np.fft.ifft2(fourier_shift(np.fft.fft2(smooth), shift[::-1])).real, 0)
    a, b = (detect(as_image(v.astype(np.float32)), scales=3) for v in (smooth, moved))
    apart = np.hypot(*(a.xy[:, None] + shift - b.xy[None]).transpose(2, 0, 1))
    near = apart.min(axis=1) < 1
    assert near.mean() > 0.8
    found = (b.xy[apart.argmin(axis=1)] - a.xy)[near]
    np.testing.assert_allclose(found.mean(axis=0), shift, atol=0.05)
    assert np.median(np.hypot(*(found - shift).T)) < 0.15


def test_edges_and_flat_areas_are_no_corners() -> None:
    x = np.mgrid[:150, :150][1]
    edge = as_image(np.where(x < 75, 1, 5).astype(np.float32))
    assert len(detect(edge)) == 0


def test_the_scale_follows_the_layer(sar_texture: Texture) -> None:
    found = detect(as_image(sar_texture(300, 300)), n_features=3000, subscale=False)
    assert len(set(found.level)) >= 6
    np.testing.assert_allclose(found.scale, 12 * 2 ** (found.level / 3))
    between = detect(as_image(sar_texture(300, 300)), n_features=3000)
    steps = 3 * np.log2(between.scale / 12) - between.level
    assert np.abs(steps).max() <= 0.5 + 1e-9
    assert (steps != 0).any()


@pytest.mark.parametrize(("n_features", "thin", "step"), [(300, True, 2), (300, False, 1), (2000, True, 1)])
def test_every_other_scale_does_where_there_are_pixels_enough(
    sar_texture: Texture, n_features: int, thin: bool, step: int
) -> None:
    """With 53 pixels for each of 300 keypoints; the scales that are left lie where they would anyway."""
    picture = as_image(sar_texture(126, 126))
    found = detect(picture, n_features=n_features, thin=thin, scales=4, support=6.0)
    np.testing.assert_array_equal(np.unique(found.level), np.arange(0, 4, step))
    around = 6.0 * 2 ** (found.level / 3)
    assert (np.abs(np.log2(found.scale / around)) <= step / 6 + 1e-9).all()


def test_the_smaller_of_a_pair_decides_on_the_scales_of_both(sar_texture: Texture) -> None:
    large, small = as_image(sar_texture(126, 126)), as_image(sar_texture(100, 126))
    found = registry.create("detector", "sar-harris", n_features=300, scales=4, support=6.0)
    for pair, step in (((large, large), 2), ((large, small), 1), ((small, large), 1), ((small, small), 1)):
        for picture in pair:
            levels = found.for_pair(*pair).detect_features(picture).level
            np.testing.assert_array_equal(np.unique(levels), np.arange(0, 4, step))


def test_pixels_without_data_are_not_enough(sar_texture: Texture) -> None:
    mask = np.ones((126, 126), np.bool_)
    mask[:40] = False
    found = detect(as_image(sar_texture(126, 126), mask=mask), n_features=300, scales=4, support=6.0)
    assert set(found.level.tolist()) == {0, 1, 2, 3}


def test_gain_moves_nothing(sar_texture: Texture) -> None:
    first, second = (detect(as_image(sar_texture() * np.float32(gain))) for gain in (1, 1024))
    np.testing.assert_allclose(first.xy, second.xy, atol=1e-3)
    np.testing.assert_allclose(first.score, second.score, rtol=1e-3)


def test_no_support_touches_nodata_and_what_lies_there_has_no_influence(sar_texture: Texture) -> None:
    amplitude = sar_texture(260, 260)
    mask = np.ones(amplitude.shape, np.bool_)
    mask[100:130, 120:150] = False
    first, second = (detect(as_image(a, mask=mask)) for a in (amplitude, np.where(mask, amplitude, 99)))
    np.testing.assert_array_equal(first.xy, second.xy)
    assert len(first) > 50
    y, x = np.nonzero(~np.pad(mask, 1))
    apart = np.hypot(first.xy[:, None, 0] + 1 - x, first.xy[:, None, 1] + 1 - y).min(axis=1)
    assert (apart >= first.scale / 2 ** (1 / 6) - 1.5).all()
    one, two = (describe(as_image(a, mask=mask), first) for a in (amplitude, np.where(mask, amplitude, 99)))
    np.testing.assert_array_equal(one, two)


# Descriptor


def test_turning_image_and_point_by_a_quarter_keeps_the_descriptor(sar_texture: Texture) -> None:
    amplitude = sar_texture()
    xy = np.random.default_rng(0).integers(50, 150, (40, 2)).astype(np.float64)
    turned = np.column_stack([xy[:, 1], amplitude.shape[1] - 1 - xy[:, 0]])
    before = describe(as_image(amplitude), at(xy, angle=0.4))
    after = describe(as_image(np.rot90(amplitude).copy()), at(turned, angle=0.4 + math.pi / 2))
    other = describe(as_image(np.rot90(amplitude).copy()), at(turned, angle=0.4))
    before, after, other = (d / np.linalg.norm(d, axis=1, keepdims=True) for d in (before, after, other))
    assert np.einsum("ij,ij->i", before, after).min() > 0.98
    assert np.einsum("ij,ij->i", before, other).mean() < 0.9


def test_gain_and_nothing(sar_texture: Texture) -> None:
    picture, louder = (as_image(sar_texture() * np.float32(gain)) for gain in (1, 500))
    points = at(np.random.default_rng(1).uniform(0, 200, (30, 2)))
    np.testing.assert_allclose(describe(picture, points), describe(louder, points), atol=2e-3)
    assert describe(picture, Features.empty()).shape == (0, 85)


def test_speckle_leaves_descriptors_of_one_place_alike(sar_texture: Texture) -> None:
    """Fresh speckle on the same scene: the same place is nearer than another one in nearly every case."""
    rng = np.random.default_rng(3)
    scene = sar_texture(300, 300, looks=50.0)
    first, second = (as_image(scene * np.sqrt(rng.gamma(4, 0.25, scene.shape)).astype(np.float32)) for _ in range(2))
    points = at(rng.uniform(60, 240, (80, 2)), scale=30.0)
    likeness = describe(first, points) @ describe(second, points).T
    assert (likeness.argmax(axis=1) == np.arange(80)).mean() > 0.9


def test_an_image_twice_as_large_is_described_alike_in_its_first_octave(sar_texture: Texture) -> None:
    """Halving the image whose pixels are all doubled gives the image back."""
    amplitude, xy = sar_texture(150, 160), np.random.default_rng(0).uniform(30, 120, (20, 2))
    large = as_image(amplitude.repeat(2, axis=0).repeat(2, axis=1))
    angle = np.linspace(0, 6, 20)
    small = describe(as_image(amplitude), at(xy, 24.0, angle))
    np.testing.assert_allclose(describe(large, at(2 * xy + 0.5, 48.0, angle)), small, atol=1e-5)


@pytest.mark.parametrize("scale", [1e-6, 5.0, 40.0, 1e7])
def test_any_scale_can_be_described(sar_texture: Texture, scale: float) -> None:
    assert np.isfinite(describe(as_image(sar_texture()), at([[100, 100]], scale=scale))).all()


@pytest.mark.parametrize(
    ("kind", "name", "parameters"),
    [
        ("detector", "sar-harris", {"scales": 0}),
        ("detector", "sar-harris", {"factor": 1.0}),
        ("detector", "sar-harris", {"alpha": float("nan")}),
        ("detector", "sar-harris", {"d": 0.25}),
        ("detector", "sar-harris", {"threshold": -1.0}),
        ("detector", "sar-harris", {"quota_decay": 0.5}),
        ("descriptor", "ratio-gloh", {"finest": 0.0}),
        ("descriptor", "ratio-gloh", {"step": 0.5}),
        ("descriptor", "ratio-gloh", {"factor": 1.0}),
    ],
    ids=str,
)
def test_impossible_parameters_are_refused(kind: Any, name: str, parameters: dict[str, Any]) -> None:
    with pytest.raises(ParameterError):
        registry.create(kind, name, **parameters)


def test_the_angle_of_a_point_turns_with_the_image(sar_texture: Texture) -> None:
    amplitude = sar_texture(240, 240)
    first = detect(as_image(amplitude), n_features=300)
    second = detect(as_image(np.rot90(amplitude).copy()), n_features=300)
    moved = np.column_stack([first.xy[:, 1], 239 - first.xy[:, 0]])
    apart = np.hypot(*(moved[:, None] - second.xy[None]).transpose(2, 0, 1))
    rows, partner = np.flatnonzero(apart.min(axis=1) < 0.1), apart.argmin(axis=1)
    assert len(rows) > 150
    turn = second.angle[partner[rows]] - first.angle[rows]
    off = np.abs((turn - math.pi / 2 + math.pi) % (2 * math.pi) - math.pi)
    assert (off < math.radians(10)).mean() > 0.85


def test_few_keypoints_of_a_large_image_are_none_of_the_finest_scales(sar_texture: Texture) -> None:
    """Scales finer than `finest` are left out, in both images of a pair or in neither; small images keep all."""
    large, small = as_image(sar_texture(300, 300)), as_image(sar_texture(120, 120))
    detector = registry.create("detector", "sar-harris", n_features=100)
    levels = {name: set(found.level.tolist()) for name, found in {
        "large": detector.detect_features(large),
        "many": registry.create("detector", "sar-harris", n_features=1000).detect_features(large),
        "small": detector.detect_features(small),
        "asked": registry.create("detector", "sar-harris", n_features=100, coarse=False).detect_features(large),
        "pair": detector.for_pair(large, small).detect_features(large),
    }.items()}  # fmt: skip
    assert min(levels["large"]) == 3
    assert {min(levels[name]) for name in ("many", "small", "asked", "pair")} == {0}
    assert detector.for_pair(large, large) is detector
