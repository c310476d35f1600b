"""Levels of a pyramid and their masks, and where whole squares of a mask are valid, against OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from featreg.sar.pyramid import pyramid, whole_squares
from featreg.types import Image


@pytest.mark.parametrize("shape", [(50, 70), (3, 5), (9, 1), (80, 30)])
@pytest.mark.parametrize("outside", [False, True])
def test_whole_squares_are_those_of_an_erosion(shape: tuple[int, int], outside: bool) -> None:
    mask = np.random.default_rng(shape[0]).random(shape) >= 0.01
    for reach in (0, 1, 2, 7, 22, 60):
        square = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
        eroded = cv2.erode(mask.view(np.uint8), square, borderType=cv2.BORDER_CONSTANT, borderValue=int(outside))
        np.testing.assert_array_equal(whole_squares(mask, reach, outside=outside), eroded.reshape(shape).view(np.bool_))


@pytest.mark.parametrize("factor", [1.2, 1.3, 2.0])
@pytest.mark.parametrize("missing", ["", "holes", "border", "border and holes"])
def test_levels_are_those_of_linear_interpolation(missing: str, factor: float) -> None:
    """A pixel is data where none of the four between which it lies is missing."""
    rng = np.random.default_rng(0)
    pixels = rng.gamma(1.0, 1.0, (151, 203)).astype(np.float32)
    mask = rng.random(pixels.shape) >= (0.05 if "holes" in missing else 0.0)
    if "border" in missing:
        mask &= np.add.outer(np.arange(151), 2 * np.arange(203)) % 500 > 40
    first, second = pyramid(Image(pixels * mask, mask), 2, factor)
    height, width = second.shape
    wanted = cv2.resize(first.amplitude, (width, height), interpolation=cv2.INTER_LINEAR)
    y, x = (
        np.clip((np.arange(n) + 0.5) * m / n - 0.5, 0, m - 1) for n, m in zip(second.shape, first.shape, strict=True)
    )
    low_y, low_x = (np.minimum(np.floor(at).astype(int), m - 2) for at, m in zip((y, x), first.shape, strict=True))
    good = mask[np.ix_(low_y, low_x)] & mask[np.ix_(low_y + 1, low_x)]
    good &= mask[np.ix_(low_y, low_x + 1)] & mask[np.ix_(low_y + 1, low_x + 1)]
    np.testing.assert_array_equal(second.mask, good)
    assert good.all() == (not missing)
    np.testing.assert_allclose(second.amplitude, wanted * good, rtol=1e-5, atol=1e-6)
