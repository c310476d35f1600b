"""Samples brought to 8 bits."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.errors import ParameterError
from featreg.sar.normalise import to_uint8
from made.images import image_of

Texture = Callable[..., NDArray[np.float32]]


class TestNormalise:
    def test_8_bit_sources_are_left_alone(self, sar_texture: Texture) -> None:
        grey = np.array(to_uint8(image_of(sar_texture(300, 260))))
        picture = image_of(grey, dtype="uint8")
        np.testing.assert_array_equal(to_uint8(picture), grey)
        assert to_uint8(image_of(grey // 4, dtype="uint8")).max() < 64
        assert to_uint8(image_of(grey // 4, dtype="uint8"), method="linear-stretch").max() == 255

    def test_the_logarithm_runs_between_the_percentiles(self) -> None:
        pixels = np.exp(np.linspace(0.0, 10.0, 101 * 50)).reshape(101, 50)
        stretched = to_uint8(image_of(pixels)).astype(float)
        expected = np.clip((np.log(pixels) - 0.1) / 9.8 * 255.0, 0.0, 255.0)
        assert np.abs(stretched - expected).max() < 1.5
        linear = to_uint8(image_of(np.log(pixels)), method="linear-stretch").astype(float)
        assert np.abs(linear - expected).max() < 1.5

    def test_zeros_become_zero(self, sar_texture: Texture) -> None:
        pixels = sar_texture(200, 200)
        pixels[:50] = 0.0
        grey = to_uint8(image_of(pixels))
        assert not grey[:50].any()
        assert np.median(grey[50:]) > 50

    def test_invalid_pixels(self, sar_texture: Texture) -> None:
        mask = np.ones((200, 200), bool)
        mask[:100] = False
        picture = image_of(sar_texture(200, 200), mask)
        assert not to_uint8(picture)[:100].any()
        filled = to_uint8(picture, fill="median")
        assert np.unique(filled[:100]).size == 1
        assert abs(int(filled[0, 0]) - np.median(filled[100:])) <= 3

    @pytest.mark.parametrize("method", ["auto", "log-stretch", "linear-stretch"])
    def test_constant_and_empty_images_are_zero(self, method: str) -> None:
        for value in (0.0, 7.0):
            assert not to_uint8(image_of(np.full((20, 30), value)), method=method).any()
        assert not to_uint8(image_of(np.ones((20, 30)), np.zeros((20, 30), bool)), method=method).any()

    def test_a_lone_valid_corner_is_found(self, sar_texture: Texture) -> None:
        mask = np.zeros((600, 600), bool)
        mask[1:3, 1:40] = True
        assert to_uint8(image_of(sar_texture(600, 600), mask))[mask].any()

    def test_what_it_refuses(self, sar_texture: Texture) -> None:
        with pytest.raises(ParameterError, match="unknown normalise method"):
            to_uint8(image_of(sar_texture(200, 200)), method="log")
        with pytest.raises(ParameterError, match="8-bit source"):
            to_uint8(image_of(sar_texture(200, 200)), method="identity")
        with pytest.raises(ParameterError, match="fill"):
            to_uint8(image_of(sar_texture(200, 200)), fill="mean")
