"""Fixtures that several test files share; all synthetic images are seeded."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.simulate import SimulatedPair, sar_pair

Texture = Callable[..., NDArray[np.float32]]


def _texture(
    height: int = 200, width: int = 220, seed: int = 0, looks: float = 4.0, relief: float = 0.6
) -> NDArray[np.float32]:
    """Smooth fields with dark ponds and bright squares under speckle: (H, W) linear amplitude, mean about 1."""
    import cv2

    rng = np.random.default_rng(seed)
    fields = cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), 6.0)
    scene = np.exp(relief * fields / fields.std())
    for _ in range(height * width // 1500):
        x, y, r = (int(rng.integers(k)) for k in (width, height, 6))
        cv2.circle(scene, (x, y), r + 3, float(rng.choice([0.1, 0.3])), -1)
    for _ in range(height * width // 1500):
        x, y, w, h = (int(rng.integers(k)) for k in (width, height, 9, 9))
        cv2.rectangle(scene, (x, y), (x + w + 2, y + h + 2), float(rng.choice([3.0, 8.0])), -1)
    speckle = rng.gamma(looks, 1.0 / looks, (height, width))
    return np.asarray(np.sqrt(scene * speckle), np.float32)


@pytest.fixture(scope="session")
def sar_texture() -> Texture:
    """Factory of seeded amplitude images: ``sar_texture(height, width, seed, looks)``."""
    return _texture


@pytest.fixture(scope="session")
def pair() -> SimulatedPair:
    """300 x 300, four looks, turned by 6 degrees, scale 1.02."""
    return sar_pair((300, 300), seed=1)


@pytest.fixture(scope="session")
def turned_pair() -> SimulatedPair:
    """300 x 300, four looks, turned by 30 degrees."""
    return sar_pair((300, 300), rotation_deg=30.0, scale=1.0, shift=(3.0, -2.0), seed=2)


@pytest.fixture(scope="session")
def realdata() -> Path:
    """The folder of real SAR images; tests that need it are skipped where it is absent."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no real images at {folder}")
    return folder
