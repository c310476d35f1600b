"""Points for models, models fitted to them, and how far a model is from the truth."""

from __future__ import annotations

from typing import Any

import numpy as np

from featreg.interfaces import FailedFit, Model
from featreg.results.registration import Registration
from featreg.types import FloatArray


def scattered(count: int = 200, size: float = 1000.0, seed: int = 0) -> FloatArray:
    """(count, 2) points anywhere in a square."""
    return np.random.default_rng(seed).uniform(0, size, (count, 2))


def fitted(cls: type[Model], *arguments: Any) -> Model:
    """The model that `from_estimate` makes, which must be one."""
    model = cls.from_estimate(*arguments)
    assert model, model
    return model


def grid_of(size: int | tuple[int, int] = 300, margin: float = 0.0) -> FloatArray:
    """(81, 2) places all over an image of `size` pixels, or (width, height), `margin` pixels off its border."""
    width, height = (size, size) if isinstance(size, int) else size
    x, y = (np.linspace(margin, side - 1 - margin, 9) for side in (width, height))
    return np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)


def grid_rmse(
    found: Registration | Model | FailedFit,
    truth: FloatArray,
    size: int | tuple[int, int] = 300,
    margin: float = 0.0,
) -> float:
    """RMS distance in pixels of a model from its (2, 3) truth over `grid_of` the image."""
    model = found.model if isinstance(found, Registration) else found
    assert model, model
    grid = grid_of(size, margin)
    return float(np.sqrt(((model(grid) - grid @ truth[:, :2].T - truth[:, 2]) ** 2).sum(axis=1).mean()))
