"""Where whole squares of a mask are valid, against OpenCV's erosion."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from featreg.sar.pyramid import whole_squares


@pytest.mark.parametrize("shape", [(50, 70), (3, 5), (9, 1), (80, 30)])
@pytest.mark.parametrize("outside", [False, True])
def test_whole_squares_are_those_of_an_erosion(shape: tuple[int, int], outside: bool) -> None:
    mask = np.random.default_rng(shape[0]).random(shape) >= 0.01
    for reach in (0, 1, 2, 7, 22, 60):
        square = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
        eroded = cv2.erode(mask.view(np.uint8), square, borderType=cv2.BORDER_CONSTANT, borderValue=int(outside))
        np.testing.assert_array_equal(whole_squares(mask, reach, outside=outside), eroded.reshape(shape).view(np.bool_))
