"""Pictures of 8 bits for kernels that look for corners."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

U8 = NDArray[np.uint8]


def random_picture() -> U8:
    return np.random.default_rng(0).integers(0, 256, (61, 83)).astype(np.uint8)


def structured_picture() -> U8:
    picture = np.full((90, 110), 60, np.uint8)
    rng = np.random.default_rng(1)
    for _ in range(25):
        x, y, w, h = (int(rng.integers(k)) for k in (100, 80, 30, 30))
        cv2.rectangle(picture, (x, y), (x + w, y + h), int(rng.integers(256)), -1)
    return picture


def extreme_picture() -> U8:
    return np.where(np.random.default_rng(2).random((50, 70)) < 0.5, 0, 255).astype(np.uint8)


def smooth_picture() -> U8:
    noise = np.random.default_rng(3).integers(0, 256, (70, 71)).astype(np.uint8)
    return np.asarray(cv2.GaussianBlur(noise, (0, 0), 1.5), np.uint8)


pictures = pytest.mark.parametrize(
    "picture", [random_picture(), structured_picture(), extreme_picture(), smooth_picture()],
    ids=["random", "structured", "extreme", "smooth"],
)  # fmt: skip
