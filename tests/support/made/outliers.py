"""A model of each kind, and pairs of points of which a share follows it."""

from __future__ import annotations

import numpy as np
import pytest

from featreg.geometry import Affine, Homography, Polynomial2, Polynomial3, Rigid, Similarity, Translation
from featreg.interfaces import Model
from featreg.types import BoolArray, FloatArray

SIZE = 1000.0
BENT = np.zeros((2, 10))
BENT[0] = [512.3, 498.0, 20.0, 6.0, -4.0, 3.0, 1.5, -2.0, 0.7, 0.9]
BENT[1] = [470.1, -18.0, 505.0, -3.0, 5.0, 2.0, -0.8, 1.1, 1.9, -1.4]
MODELS: list[Model] = [
    Translation(12.25, -7.5),
    Rigid(24.37, 25.4, 317.3),
    Similarity(31.7, 1.13, -260.0, 180.0),
    Affine(np.array([[1.03, 0.07, 12.0], [-0.05, 0.97, 30.0]])),
    Homography(np.array([[1.02, 0.05, 5.0], [-0.04, 0.99, 8.0], [2e-5, -3e-5, 1.0]])),
    Polynomial2(BENT[:, :6], (500.0, 480.0), 500.0),
    Polynomial3(BENT, (500.0, 480.0), 500.0),
]
every_model = pytest.mark.parametrize("model", MODELS, ids=[type(m).__name__ for m in MODELS])
CORNERS = np.array([[0, 0], [SIZE, 0], [0, SIZE], [SIZE, SIZE]])


def mixed(
    model: Model, share: float, *, count: int = 2000, noise: float = 0.5, seed: int = 0
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """`share` of the pairs follow the model, the others join arbitrary points of the two images."""
    rng = np.random.default_rng(seed)
    reference = rng.uniform(0, SIZE, (count, 2))
    secondary = model(reference) + rng.normal(0, noise, (count, 2))
    good = rng.permutation(count) < round(share * count)
    low, high = (edge(secondary, axis=0, initial=SIZE / 2) for edge in (np.min, np.max))
    secondary[~good] = rng.uniform(low, high, ((~good).sum(), 2))
    return reference, secondary, good
