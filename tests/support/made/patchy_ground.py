"""Ground of patches and bright targets, seen through speckle, and what may be drawn on both images of it."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

F32 = NDArray[np.float32]
SIDE = 400


def patchy_ground(seed: int, side: int = SIDE) -> F32:
    """Ground of patches and bright targets."""
    rng = np.random.default_rng(seed)
    ground = sum(
        weight * gaussian_filter(rng.normal(0, 1, (side, side)), sigma) * sigma
        for sigma, weight in ((2.0, 0.5), (6.0, 0.8), (20.0, 0.7))
    )
    return np.asarray(60 * np.exp(ground), np.float32)


def seen(ground: F32, seed: int, looks: int = 4) -> F32:
    rng = np.random.default_rng([seed, 9])
    return np.asarray(ground * np.sqrt(rng.gamma(looks, 1 / looks, ground.shape)), np.float32)


def marked(kind: str) -> NDArray[np.bool_]:
    drawing = np.zeros((SIDE, SIDE), np.uint8)
    if kind in ("frame and label", "frame"):
        cv2.rectangle(drawing, (6, 6), (393, 393), 255, 2)
    if kind in ("frame and label", "label"):
        cv2.putText(drawing, "SAR 2026", (20, 370), cv2.FONT_HERSHEY_SIMPLEX, 1.2, 255, 3)
    if kind == "legend":
        for i in range(8):
            cv2.putText(drawing, f"class {i}", (250, 40 + 22 * i), cv2.FONT_HERSHEY_SIMPLEX, 0.5, 255, 1)
            cv2.rectangle(drawing, (225, 28 + 22 * i), (242, 42 + 22 * i), 255, -1)
    if kind == "dead pixels":
        drawing[np.random.default_rng(4).random(drawing.shape) < 0.01] = 255
    return drawing > 0
