"""ROEWA ratio gradients against their definition: exponential weights, borders, nodata, dark areas, steps, mirrors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.errors import ParameterError
from featreg.io import as_image
from featreg.sar.gradients.ratio import (
    FLOOR,
    LEAST_SUPPORT,
    ratio_gradients,
    roewa,
)
from made.images import image_of

Texture = Callable[..., NDArray[np.float32]]
F64 = NDArray[np.float64]
alphas = pytest.mark.parametrize("alpha", [1.0, 2.0, 8.0])
floors = pytest.mark.parametrize("floor", [0.0, FLOOR, 0.1])
# float32 recursions and a logarithm good to 4e-7
TOLERANCE = 2e-4


def direct(amplitude: NDArray[Any], alpha: float, mask: NDArray[np.bool_], floor: float) -> tuple[F64, F64, F64, F64]:
    """Eq. 3 as it is defined, in double precision: one-sided means over the pixels that exist, and their weights."""
    values = np.where(mask, amplitude, 0).astype(np.float64)
    level = floor * values.sum() / mask.sum()

    def weights(n: int) -> tuple[F64, F64]:
        d = np.arange(n)[None, :] - np.arange(n)[:, None]
        w = np.exp(-np.abs(d) / alpha)
        return w, np.where(d > 0, w, 0.0)

    (wy, after_y), (wx, after_x) = (weights(n) for n in amplitude.shape)
    before_x, before_y = np.flip(after_x), np.flip(after_y)

    def side(rows: F64, columns: F64) -> tuple[F64, F64]:
        return rows @ values @ columns.T, rows @ mask.astype(np.float64) @ columns.T

    def log_ratio(over: tuple[F64, F64], under: tuple[F64, F64]) -> tuple[F64, F64]:
        with np.errstate(all="ignore"):
            gradient = np.log((over[0] / over[1] + level) / (under[0] / under[1] + level))
            balance = np.log(over[1] / under[1])
        return gradient, balance

    gx, bx = log_ratio(side(wy, after_x), side(wy, before_x))
    gy, by = log_ratio(side(after_y, wx), side(before_y, wx))
    return gx, gy, bx, by


@alphas
@floors
@pytest.mark.parametrize("shape", [(60, 41), (19, 70), (16, 16)])
def test_equals_the_definition_borders_included(
    sar_texture: Texture, alpha: float, floor: float, shape: tuple[int, int]
) -> None:
    amplitude = sar_texture(*shape, seed=3)
    gx, gy = roewa(amplitude, alpha, None, floor)
    wanted_x, wanted_y, _, _ = direct(amplitude, alpha, np.ones(shape, np.bool_), floor)
    np.testing.assert_allclose(gx[:, 1:-1], wanted_x[:, 1:-1], atol=TOLERANCE)
    np.testing.assert_allclose(gy[1:-1], wanted_y[1:-1], atol=TOLERANCE)
    assert not gx[:, [0, -1]].any()
    assert not gy[[0, -1]].any()


@alphas
@floors
def test_with_a_mask_it_equals_the_normalised_convolution(sar_texture: Texture, alpha: float, floor: float) -> None:
    amplitude = sar_texture(60, 50, seed=4)
    mask = np.ones(amplitude.shape, np.bool_)
    mask[:, :9] = False
    mask[20:33, 25:31] = False
    mask[np.random.default_rng(0).random(mask.shape) < 0.02] = False
    found = roewa(np.where(mask, amplitude, 0), alpha, mask, floor)
    gx, gy, bx, by = direct(amplitude, alpha, mask, floor)
    limit = -np.log(LEAST_SUPPORT)
    for gradient, wanted, balance in zip(found, (gx, gy), (bx, by), strict=True):
        both = np.isfinite(balance) & mask & (np.abs(balance) < limit - 1e-3)
        nothing = ~mask | ~np.isfinite(balance) | (np.abs(balance) > limit + 1e-3)
        assert both.sum() > 0.7 * mask.sum()
        np.testing.assert_allclose(gradient[both], wanted[both], atol=TOLERANCE)
        assert not gradient[nothing].any()


def test_an_all_valid_mask_changes_nothing(sar_texture: Texture) -> None:
    amplitude = sar_texture(40, 50)
    with_mask = roewa(amplitude, 2.0, np.ones(amplitude.shape, np.bool_))
    for a, b in zip(roewa(amplitude, 2.0), with_mask, strict=True):
        np.testing.assert_allclose(a[2:-2, 2:-2], b[2:-2, 2:-2], atol=TOLERANCE)


@alphas
@floors
@pytest.mark.parametrize("masked", [False, True])
def test_a_flat_image_has_no_edges_anywhere(alpha: float, floor: float, masked: bool) -> None:
    mask = np.ones((40, 55), np.bool_)
    if masked:
        mask[:, :11] = False
        mask[15:25, 30:35] = False
    flat = np.where(mask, np.float32(7.5), np.float32(0))
    for gradient in roewa(flat, alpha, mask if masked else None, floor):
        np.testing.assert_allclose(gradient, 0, atol=TOLERANCE)


@pytest.mark.parametrize("gain", [1e-6, 1000.0, 1e9])
def test_gain_drops_out(sar_texture: Texture, gain: float) -> None:
    amplitude = sar_texture(50, 60)
    for a, b in zip(roewa(amplitude, 2.0), roewa(amplitude * np.float32(gain), 2.0), strict=True):
        np.testing.assert_allclose(a, b, atol=TOLERANCE)


@pytest.mark.parametrize("alpha", [0.5, 2.0, 8.0, 50.0])
def test_zeros_give_finite_values_and_no_edge_between_two_dark_areas(alpha: float) -> None:
    rng = np.random.default_rng(0)
    amplitude = np.zeros((40, 120), np.float32)
    amplitude[:, 100:] = rng.uniform(1, 2, (40, 20))  # so that the mean is not 0
    amplitude[:, 30:60] = 1e-12
    gx, gy = roewa(amplitude, alpha)
    assert np.isfinite(gx).all()
    assert np.isfinite(gy).all()
    if alpha <= 2:  # farther than 15 alpha from what is bright
        np.testing.assert_allclose(gx[:, 1:65], 0, atol=1e-3)
        np.testing.assert_allclose(gy[:, 1:65], 0, atol=1e-3)


def test_a_black_image_is_flat() -> None:
    for gradient in roewa(np.zeros((20, 30), np.float32), 2.0):
        np.testing.assert_allclose(gradient, 0, atol=1e-5)


@pytest.mark.parametrize("ratio", [0.1, 2.0, 30.0])
@alphas
def test_a_step_gives_the_logarithm_of_its_ratio(ratio: float, alpha: float) -> None:
    amplitude = np.ones((30, 200), np.float32)
    amplitude[:, 100:] = ratio
    gx, gy = roewa(amplitude, alpha, floor=0.0)
    # Beside the step one mean holds a single side; the other holds the pixel across with weight exp(-1 / alpha).
    d = np.exp(-1 / alpha)
    assert gx[15, 99] == pytest.approx(np.log(ratio), abs=1e-3)
    assert gx[15, 100] == pytest.approx(np.log(ratio), abs=1e-3)
    assert gx[15, 98] == pytest.approx(np.log((1 - d) + d * ratio), abs=1e-3)
    np.testing.assert_allclose(gy, 0, atol=1e-4)


def test_the_gradient_points_to_the_brighter_side() -> None:
    y, x = np.mgrid[:30, :40]
    gx, gy = roewa(np.exp(0.1 * x - 0.05 * y).astype(np.float32), 2.0, floor=0.0)
    assert (gx[5:-5, 5:-5] > 0).all()
    assert (gy[5:-5, 5:-5] < 0).all()


def test_mirrored_and_transposed_images_give_mirrored_and_transposed_gradients(sar_texture: Texture) -> None:
    amplitude = sar_texture(57, 43, seed=5)
    gx, gy = roewa(amplitude, 2.0)
    right, up, turned = (
        roewa(np.ascontiguousarray(a), 2.0) for a in (amplitude[:, ::-1], amplitude[::-1], amplitude.T)
    )
    for found, wanted in (
        (right[0], -gx[:, ::-1]),
        (right[1], gy[:, ::-1]),
        (up[0], gx[::-1]),
        (up[1], -gy[::-1]),
        (turned[0], gy.T),
        (turned[1], gx.T),
    ):
        np.testing.assert_allclose(found, wanted, atol=1e-5)


@pytest.mark.parametrize("alpha", [0.0, -1.0, float("nan"), float("inf")])
def test_an_impossible_alpha_is_refused(alpha: float) -> None:
    with pytest.raises(ParameterError, match="alpha"):
        ratio_gradients(image_of(np.ones((20, 20))), alpha)


@pytest.mark.parametrize("alpha", [1e-3, 0.02, 1e4, 1e20])
def test_any_positive_alpha_gives_finite_values(sar_texture: Texture, alpha: float) -> None:
    for gradient in roewa(sar_texture(30, 40), alpha):
        assert np.isfinite(gradient).all()


def test_what_lies_under_the_mask_has_no_influence(sar_texture: Texture) -> None:
    amplitude = sar_texture(60, 60)
    mask = np.ones(amplitude.shape, np.bool_)
    mask[20:35, 10:30] = False
    other = amplitude.copy()
    other[~mask] = np.nan
    for a, b in zip(*(ratio_gradients(as_image(v, mask=mask)) for v in (amplitude, other)), strict=True):
        np.testing.assert_array_equal(a, b)


def test_complex_images_are_used_by_their_amplitude(sar_texture: Texture) -> None:
    amplitude = sar_texture(40, 40)
    phase = np.random.default_rng(0).uniform(0, 6, amplitude.shape)
    for a, b in zip(
        ratio_gradients(as_image(amplitude * np.exp(1j * phase))), ratio_gradients(as_image(amplitude)), strict=True
    ):
        np.testing.assert_allclose(a, b, atol=1e-4)
