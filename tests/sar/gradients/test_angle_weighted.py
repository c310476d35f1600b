"""Angle-weighted channels: shared by angle, blind to reversed contrast, turned with gradients, the same in parts."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.sar.gradients.angle_weighted import angle_weighted_channels, median_length, smoothing_reach
from featreg.sar.gradients.angle_weighted_kernels import share_out
from featreg.sar.gradients.gradient_field import GradientField

F32 = NDArray[np.float32]


def field(shape: tuple[int, int] = (40, 50), turn: float = 0.0, seed: int = 0) -> GradientField:
    rng = np.random.default_rng(seed)
    angle, length = rng.uniform(0, 2 * math.pi, shape) + turn, rng.gamma(2.0, 1.0, shape)
    return GradientField((length * np.cos(angle)).astype(np.float32), (length * np.sin(angle)).astype(np.float32))


def shared(length: F32, direction: F32, count: int) -> NDArray[np.float64]:
    """The same by its definition: what each channel gets falls linearly to 0 at the directions of its neighbours."""
    step = math.pi / count
    out = np.zeros((count, len(length)))
    for k in range(count):
        away = np.abs((direction.astype(np.float64) - k * step + math.pi / 2) % math.pi - math.pi / 2)
        out[k] = length * np.maximum(0, 1 - away / step)
    return out


@pytest.mark.parametrize("count", [4, 6, 9])
def test_gradients_are_shared_between_the_two_channels_next_to_them(count: int) -> None:
    rng = np.random.default_rng(count)
    length = rng.gamma(2.0, 1.0, 500).astype(np.float32)
    direction = rng.uniform(0, 2 * math.pi, 500).astype(np.float32)
    direction[:3] = 0, math.pi, 2 * math.pi
    out = np.full((count, 500), 7, np.float32)
    share_out(length, direction, out)
    assert np.allclose(out, shared(length, direction, count), atol=1e-4)
    assert np.allclose(out.sum(axis=0), length, rtol=1e-5)
    assert np.allclose(out[0, :3], length[:3], atol=1e-5)


def test_each_pixel_has_a_vector_of_zero_sum_and_no_more_than_unit_length() -> None:
    plain = field()
    channels = angle_weighted_channels(plain, 6, 0.8, median_length(plain))
    assert channels.shape == (6, 40, 50)
    assert np.abs(channels.sum(axis=0)).max() < 1e-5
    assert 0.1 < np.linalg.norm(channels, axis=0).mean() < 1
    nothing = GradientField(np.zeros((9, 9), np.float32), np.zeros((9, 9), np.float32))
    assert median_length(nothing) == 0
    assert not angle_weighted_channels(nothing, 6, 0.8, 1.0).any()


def test_reversed_contrast_changes_nothing_and_a_turn_by_a_channel_rolls_them() -> None:
    one = angle_weighted_channels(field(), 6, 0.8, 1.0)
    reverse = angle_weighted_channels(field(turn=math.pi), 6, 0.8, 1.0)
    assert np.allclose(one, reverse, atol=5e-3)
    turned = angle_weighted_channels(field(turn=math.pi / 6), 6, 0.8, 1.0)
    assert np.allclose(np.roll(one, 1, axis=0), turned, atol=5e-3)


def test_a_part_has_the_channels_of_the_whole() -> None:
    plain, reach = field((60, 70)), smoothing_reach(0.8)
    whole = angle_weighted_channels(plain, 6, 0.8, 1.0)
    part = GradientField(plain.x[10:40, 20:55].copy(), plain.y[10:40, 20:55].copy())
    made = angle_weighted_channels(part, 6, 0.8, 1.0)
    assert np.allclose(
        made[:, reach:-reach, reach:-reach], whole[:, 10 + reach : 40 - reach, 20 + reach : 55 - reach], atol=1e-5
    )
