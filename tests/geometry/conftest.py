"""One model of every kind, for the tests that hold for all of them."""

from __future__ import annotations

import numpy as np
import pytest

from featreg.geometry import Affine, Homography, Polynomial2, Polynomial3, Rigid, Similarity, Translation
from featreg.interfaces import Model

CUBIC = np.zeros((2, 10))
CUBIC[0] = [512.3, 498.0, 20.0, 6.0, -4.0, 3.0, 1.5, -2.0, 0.7, 0.9]
CUBIC[1] = [470.1, -18.0, 505.0, -3.0, 5.0, 2.0, -0.8, 1.1, 1.9, -1.4]

MODELS: list[Model] = [
    Translation(12.25, -7.5),
    Rigid(4.37, 25.4, -17.3),
    Rigid(-170.6, 900.0, 800.0),
    Similarity(31.7, 1.13, -60.0, 80.0),
    Affine(np.array([[1.03, 0.07, 12.0], [-0.05, 0.97, -30.0]])),
    Homography(np.array([[1.02, 0.05, 5.0], [-0.04, 0.99, 8.0], [2e-5, -3e-5, 1.0]])),
    Polynomial2(CUBIC[:, :6], (500.0, 480.0), 500.0),
    Polynomial3(CUBIC, (500.0, 480.0), 500.0),
]
CLASSES = list(dict.fromkeys(type(m) for m in MODELS))


@pytest.fixture(params=MODELS, ids=[f"{type(m).__name__}-{i}" for i, m in enumerate(MODELS)])
def model(request: pytest.FixtureRequest) -> Model:
    found: Model = request.param
    return found


@pytest.fixture(params=CLASSES, ids=[c.__name__ for c in CLASSES])
def cls(request: pytest.FixtureRequest) -> type[Model]:
    found: type[Model] = request.param
    return found


@pytest.fixture
def example(cls: type[Model]) -> Model:
    """The first model of the class."""
    return next(m for m in MODELS if type(m) is cls)
