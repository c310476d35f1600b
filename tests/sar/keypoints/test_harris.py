"""The smoothed Harris response against OpenCV's Gaussian of whole maps, borders and tiny images included."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.sar.gradients.ratio import roewa
from featreg.sar.keypoints.harris import harris_response, ratio_harris_response, reflected

F32 = NDArray[np.float32]
Texture = Callable[..., F32]


def plain(gx: F32, gy: F32, sigma: float, reach: int, d: float) -> NDArray[np.float64]:
    side = (2 * reach + 1, 2 * reach + 1)
    x, y = gx.astype(np.float64), gy.astype(np.float64)
    xx, xy, yy = (cv2.GaussianBlur(m, side, sigma, borderType=cv2.BORDER_REFLECT_101) for m in (x * x, x * y, y * y))
    return np.asarray(xx * yy - xy * xy - d * (xx + yy) ** 2)


@pytest.mark.parametrize("shape", [(60, 75), (1, 40), (40, 1), (3, 50), (50, 4), (1, 1), (12, 12)])
@pytest.mark.parametrize("reach", [1, 2, 3, 4, 5, 6])
def test_the_response_is_that_of_whole_maps(shape: tuple[int, int], reach: int) -> None:
    gx, gy = np.random.default_rng(reach).normal(0, 1, (2, *shape)).astype(np.float32)
    expected = plain(gx, gy, reach / 2.5, reach, 0.04)
    np.testing.assert_allclose(harris_response(gx, gy, reach / 2.5), expected, atol=2e-6 * np.abs(expected).max())


def test_a_turned_field_has_the_turned_response() -> None:
    gx, gy = np.random.default_rng(3).normal(0, 1, (2, 45, 70)).astype(np.float32)
    turned = harris_response(np.ascontiguousarray(gx.T), np.ascontiguousarray(gy.T), 1.2)
    np.testing.assert_allclose(turned.T, harris_response(gx, gy, 1.2), rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize(("length", "reach", "places"), [
    (4, 2, [2, 1, 0, 1, 2, 3, 2, 1]),
    (2, 3, [1, 0, 1, 0, 1, 0, 1, 0]),
    (1, 2, [0, 0, 0, 0, 0]),
])  # fmt: skip
def test_an_axis_is_reflected_about_its_ends(length: int, reach: int, places: list[int]) -> None:
    assert reflected(length, reach).tolist() == places


def test_the_ring_is_the_same_for_any_number_of_rows(sar_texture: Callable[..., Any]) -> None:
    gx, gy = (np.ascontiguousarray(part) for part in np.gradient(sar_texture(90, 64)))
    whole, part = harris_response(gx, gy, 1.0), harris_response(gx[:70], gy[:70], 1.0)
    np.testing.assert_array_equal(whole[:66], part[:66])


@pytest.mark.parametrize("alpha", [1.0, 2.52])
@pytest.mark.parametrize("shape", [(75, 70), (8, 40), (3, 9)])
def test_gradients_that_pass_row_by_row_have_the_response_of_their_maps(
    sar_texture: Texture, shape: tuple[int, int], alpha: float
) -> None:
    amplitude = np.ascontiguousarray(sar_texture(80, 80)[: shape[0], : shape[1]])
    wanted = harris_response(*roewa(amplitude, alpha, None, 0.01), 0.8 * alpha)
    found = ratio_harris_response(amplitude, alpha, 0.01, 0.8 * alpha)
    np.testing.assert_allclose(found, wanted, atol=1e-5 * float(np.abs(wanted).max()))
