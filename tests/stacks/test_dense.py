"""Pairs measured again by windows all over the image: nearer to the truth, and only where the windows agree."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import featreg
from featreg.geometry import Affine, Rigid
from featreg.simulate import SimulatedSeries, sar_series
from featreg.stacks.dense import measured_again

GRID = np.stack(np.meshgrid(np.linspace(15, 245, 6), np.linspace(15, 245, 6)), -1).reshape(-1, 2)


@pytest.fixture(scope="module")
def series() -> SimulatedSeries:
    return sar_series(3, (260, 260), looks=2, unrelated=2, seed=7)


def test_a_rough_model_is_brought_to_the_truth(series: SimulatedSeries) -> None:
    truth = Affine(series.truths[1])
    rough = Rigid.from_estimate(GRID, truth(GRID) + np.array([0.8, -0.6]))
    assert isinstance(rough, Rigid)
    again = measured_again(series.images[0], series.images[1], rough, (260, 260), {}, {})
    assert again is not None
    model, windows = again
    assert isinstance(model, Rigid)
    assert np.abs(model(GRID) - truth(GRID)).max() < 0.15
    assert windows.covariance is not None
    assert len(windows) >= 8
    # Windows side by side share no pixel.
    assert np.unique(np.diff(np.unique(windows.reference_xy[:, 0]))).tolist() in ([48.0], [48.0, 96.0])


def test_windows_that_do_not_correlate_change_nothing(series: SimulatedSeries) -> None:
    still = Rigid.from_estimate(GRID, GRID)
    assert isinstance(still, Rigid)
    assert measured_again(series.images[0], series.images[2], still, (260, 260), {}, {}) is None


def test_without_refinement_the_match_stands(series: SimulatedSeries) -> None:
    job: Any = {"method": "sar-orb", "model": "rigid", "seed": 0, "refine": False}
    stack = featreg.register_stack(series.images[:2], workers=1, **job)
    direct = featreg.match(series.images[0], series.images[1], **job)
    model = stack.pairs[0].model
    assert model is not None
    assert model.parameters == direct.model.parameters
