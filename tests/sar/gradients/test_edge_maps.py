"""Maps of edges by ROEWA: their strength, their 8 bits, what ships, holes and tiles do to them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.sar.gradients import ratio
from featreg.sar.gradients.ratio import (
    STEPS,
    edge_strength,
    quantised_edges,
    roewa,
    roewa_strength,
)
from made.images import image_of

Texture = Callable[..., NDArray[np.float32]]


def test_strength_is_the_length_of_the_gradient_to_one_percent_at_ratios_below_six(sar_texture: Texture) -> None:
    amplitude = sar_texture(43, 59)
    gx, gy = roewa(amplitude, 2.0)
    strength = roewa_strength(amplitude, 2.0) / np.float32(STEPS)
    length = np.hypot(gx, gy)
    weak = (np.maximum(np.abs(gx), np.abs(gy)) < np.log(6))[1:-1, 1:-1]
    assert weak.mean() > 0.9
    np.testing.assert_allclose(strength[1:-1, 1:-1][weak], length[1:-1, 1:-1][weak], rtol=0.012, atol=2 / STEPS)
    assert (strength[1:-1, 1:-1] < 1.02 * length[1:-1, 1:-1] + 1e-4).all()
    assert not strength[[0, -1]].any()
    assert not strength[:, [0, -1]].any()
    np.testing.assert_allclose(edge_strength(gx, gy), np.hypot(gx, gy), atol=1e-5)


@pytest.mark.parametrize("alpha", [0.001, 0.03, 0.05, 0.1, 0.4])
def test_of_small_alpha_the_ratios_are_those_of_the_weighted_neighbours(sar_texture: Texture, alpha: float) -> None:
    """Weights are sums of exp(-d / alpha), the nearest pixel's taken out of them, which would underflow."""
    amplitude = sar_texture(21, 30)
    grey = amplitude.astype(np.float64) + 0.1 * amplitude.mean(dtype=np.float64)

    def along_x(rows: NDArray[np.float64]) -> NDArray[np.float64]:
        high, wide = (np.arange(n) for n in rows.shape)
        summed = np.exp(-np.abs(high[:, None] - high) / alpha) @ rows
        away = wide - wide[:, None]
        after, before = (np.exp(-np.maximum(a - 1, 0) / alpha) * (a > 0) for a in (away, -away))
        sides = (summed @ side.T / np.maximum(side.sum(axis=1), 1) for side in (after, before))
        right, left = (side[:, 1:-1] for side in sides)
        return np.asarray(np.log(right / left))

    gx, gy = roewa(amplitude, alpha, None, 0.1)
    x, y = along_x(grey), along_x(grey.T).T
    np.testing.assert_allclose(gx[:, 1:-1], x, atol=2e-6)
    np.testing.assert_allclose(gy[1:-1], y, atol=2e-6)
    strength = roewa_strength(amplitude, alpha, 0.1)[1:-1, 1:-1] / STEPS
    weak = np.maximum(np.abs(x[1:-1]), np.abs(y[:, 1:-1])) < np.log(6)
    np.testing.assert_allclose(strength[weak], np.hypot(x[1:-1], y[:, 1:-1])[weak], rtol=0.01, atol=2 / STEPS)
    masked = roewa(amplitude, alpha, np.arange(30)[None, :] + np.zeros((21, 1)) != 7, 0.1)[0]
    # Beside the column without data nearly all weight is missing.
    assert not masked[:, 6:9].any() or alpha > 0.2
    np.testing.assert_allclose(masked[:, 20:-1], gx[:, 20:-1], atol=0.02)
    assert not roewa_strength(np.zeros((9, 9), np.float32), alpha).any()


def test_eq5_is_the_root_of_the_squared_ratios() -> None:
    gx, gy = np.log(np.array([[2.0, 0.5, 1.0]], np.float32)), np.log(np.array([[3.0, 3.0, 1.0]], np.float32))
    np.testing.assert_allclose(edge_strength(gx, gy, eq5=True)[0], np.sqrt([13, 13, 2]) - np.sqrt(2), rtol=1e-5)


@pytest.mark.parametrize("eq5", [False, True])
def test_quantised_edges_keep_the_order_and_the_gain(sar_texture: Texture, eq5: bool) -> None:
    amplitude = sar_texture(80, 90)
    edges = quantised_edges(image_of(amplitude), 2.0, eq5=eq5)
    strength = edge_strength(*roewa(amplitude, 2.0), eq5=True) if eq5 else roewa_strength(amplitude, 2.0)
    assert edges.dtype == np.uint8
    inner = (slice(1, -1), slice(1, -1))
    order = np.argsort(strength[inner], axis=None)
    assert (np.diff(edges[inner].ravel()[order].astype(int)) >= 0).all()
    louder = quantised_edges(image_of(amplitude * 1000), 2.0, eq5=eq5).astype(int)
    assert np.abs(louder - edges).max() <= 1


def test_one_bright_ship_does_not_darken_the_other_edges(sar_texture: Texture) -> None:
    amplitude = sar_texture(120, 120)
    ship = amplitude.copy()
    ship[60, 60] = 1e3
    before, after = (quantised_edges(image_of(a), 2.0, floor=0.0).astype(int) for a in (amplitude, ship))
    far = np.ones(amplitude.shape, np.bool_)
    far[30:91, 30:91] = False
    assert np.abs(before - after)[far].max() <= 8


def test_one_invalid_pixel_in_a_corner_leaves_the_rest_of_the_edge_map_alone(sar_texture: Texture) -> None:
    amplitude = sar_texture(121, 121)
    mask = np.ones(amplitude.shape, np.bool_)
    mask[0, 0] = False
    whole, holed = (quantised_edges(image_of(amplitude, m), 2.0).astype(int) for m in (None, mask))
    assert np.abs(whole - holed)[40:, 40:].max() <= 5


@pytest.mark.parametrize("pixels", [np.ones((20, 20)), np.zeros((20, 20))])
def test_an_image_without_content_has_no_edges(pixels: NDArray[np.float64]) -> None:
    assert quantised_edges(image_of(pixels), 2.0).max() == 0


def test_an_image_without_a_valid_pixel_has_no_edges() -> None:
    assert not quantised_edges(image_of(np.ones((20, 20)), np.zeros((20, 20), np.bool_)), 2.0).any()


def test_tiles_and_strips_leave_no_trace(sar_texture: Texture, monkeypatch: pytest.MonkeyPatch) -> None:
    amplitude = sar_texture(151, 203)
    amplitude[70, 100] = 1e4
    whole: list[NDArray[Any]] = [*roewa(amplitude, 2.0), roewa_strength(amplitude, 2.0) / STEPS]
    monkeypatch.setattr(ratio, "STRIP", 8)
    monkeypatch.setattr(ratio, "TILE", 8)
    parts: list[NDArray[Any]] = [*roewa(amplitude, 2.0), roewa_strength(amplitude, 2.0) / STEPS]
    for one, other in zip(whole, parts, strict=True):
        np.testing.assert_allclose(other, one, atol=2 / STEPS)


@pytest.mark.parametrize(("gain", "alpha"), [(2.0**-90, 2.0), (2.0**90, 2.0), (2.0**-100, 0.03), (2.0**90, 0.03)])
def test_very_small_and_very_large_amplitudes_have_the_same_ratios(
    sar_texture: Texture, gain: float, alpha: float
) -> None:
    amplitude = sar_texture(60, 70)
    other = (amplitude * gain).astype(np.float32)
    for found, wanted in zip(roewa(other, alpha), roewa(amplitude, alpha), strict=True):
        np.testing.assert_allclose(found, wanted, atol=1e-5)
    assert np.abs(roewa_strength(other, alpha).astype(int) - roewa_strength(amplitude, alpha)).max() <= 1


@pytest.mark.parametrize("valid", [1.0, 0.7, 0.0])
def test_the_scale_of_the_edges_is_told_by_the_valid_ones(sar_texture: Texture, valid: float) -> None:
    strength = roewa_strength(sar_texture(500, 610), 2.0)
    mask = np.random.default_rng(0).random(strength.shape) < valid
    found = ratio._quantiles(strength, mask)
    plain = ratio._quantiles(strength.astype(np.float32), mask)
    assert all(0 <= b - a < 4 for a, b in zip(found, plain, strict=True))
    step = int(np.sqrt(strength.size / ratio.SAMPLE))
    sample = strength[::step, ::step][mask[::step, ::step]]
    wanted = np.quantile(sample, ratio.RANKS, method="lower") if sample.size else [0, 0]
    np.testing.assert_array_equal(plain, wanted)
