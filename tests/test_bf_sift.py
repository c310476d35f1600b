"""BFSIFT: bilateral scale space, its extrema, its descriptor, and the presets built on them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg import registry
from featreg.errors import ParameterError
from featreg.io import as_image
from featreg.sar.bilateral import BilateralSpace, bilateral_field, bilateral_levels, noise_level
from featreg.sar.speckle import log_amplitude
from featreg.simulate import SimulatedPair
from featreg.types import Features, Image

Texture = Callable[..., NDArray[np.float32]]


def detect(picture: Image, **parameters: Any) -> Features:
    return registry.create("detector", "bf-sift", **parameters).detect_features(picture)


def describe(picture: Image, features: Features, **parameters: Any) -> Features:
    return registry.create("descriptor", "bf-sift", **parameters).describe_features(picture, features)


# Scale space


@pytest.mark.parametrize(("looks", "wanted"), [(1.0, 0.64), (4.0, 0.266), (16.0, 0.126)])
def test_the_noise_is_that_of_the_speckle(looks: float, wanted: float) -> None:
    """Standard deviation of the log amplitude of L-look speckle: half the root of trigamma(L)."""
    speckle = np.sqrt(np.random.default_rng(0).gamma(looks, 1 / looks, (300, 300))).astype(np.float32)
    assert noise_level(as_image(speckle)) == pytest.approx(wanted, rel=0.1)


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


@pytest.mark.parametrize("name", ["bfsift", "bfsift-paper"])
def test_a_known_warp_is_found(pair: SimulatedPair, name: str) -> None:
    found = featreg.match(pair.reference, pair.secondary, method=name, n_features=1500, refine=False)
    assert found.status == "ok"
    assert found.model
    points = np.array([[x, y] for x in (20.0, 150.0, 280.0) for y in (20.0, 150.0, 280.0)])
    error = found.model(points) - (points @ pair.truth[:, :2].T + pair.truth[:, 2])
    assert np.hypot(*error.T).max() < 1.0


@pytest.mark.parametrize(
    ("kind", "parameters"),
    [
        ("detector", {"octaves": 0}),
        ("detector", {"intervals": 0}),
        ("detector", {"tone": 0.0}),
        ("detector", {"sigma": float("nan")}),
        ("detector", {"threshold": -1.0}),
        ("detector", {"quota_decay": 0.9}),
        ("descriptor", {"support": 0.0}),
        ("descriptor", {"coarser": -1.0}),
        ("descriptor", {"step": 1.0}),
    ],
    ids=str,
)
def test_impossible_parameters_are_refused(kind: Any, parameters: dict[str, Any]) -> None:
    with pytest.raises(ParameterError):
        registry.create(kind, "bf-sift", **parameters)
