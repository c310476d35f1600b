"""Pictures for the detectors and descriptors of OpenCV, and what they find there."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from featreg import registry
from featreg.types import Features, Image

DETECTORS = {e.name: e for e in registry.entries("detector") if e.module == "featreg.detectors.opencv"}
DESCRIPTORS = {e.name: e for e in registry.entries("descriptor") if e.module == "featreg.descriptors.opencv"}
USABLE_DETECTORS = sorted(n for n, e in DETECTORS.items() if not e.unavailable)
USABLE_DESCRIPTORS = sorted(n for n, e in DESCRIPTORS.items() if not e.unavailable)
DESCRIBING = sorted(n for n in USABLE_DETECTORS if "describe" in DETECTORS[n].parameters)


def sar_like(height: int = 200, width: int = 200, seed: int = 0) -> NDArray[np.float32]:
    """Fields, dark discs and bright points under four-look speckle; linear amplitude."""
    rng = np.random.default_rng(seed)
    scene = cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), 5.0)
    scene = np.exp(scene / max(scene.std(), 0.1))
    for _ in range(height * width // 4000):
        centre = (int(rng.integers(width)), int(rng.integers(height)))
        cv2.circle(scene, centre, int(rng.integers(4, 9)), float(rng.choice([0.05, 8.0])), -1)
    return np.asarray(scene * np.sqrt(rng.gamma(4.0, 0.25, (height, width))), dtype=np.float32)


def detect(name: str, picture: Image, **parameters: Any) -> Features:
    return registry.create("detector", name, **parameters).detect_features(picture)


def describe(name: str, picture: Image, features: Features, **parameters: Any) -> Features:
    return registry.create("descriptor", name, **parameters).describe_features(picture, features)


def bare(features: Features) -> Features:
    return replace(features, descriptors=None, norm="l2")


def same_features(a: Features, b: Features) -> bool:
    fields = ("xy", "scale", "angle", "score", "level", "descriptors")
    return len(a) == len(b) and all(np.array_equal(getattr(a, f), getattr(b, f)) for f in fields)
