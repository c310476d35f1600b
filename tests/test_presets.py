"""Presets: each registers a pair whose warp is known."""

from __future__ import annotations

import numpy as np
import pytest

import featreg
from featreg.simulate import SimulatedPair


@pytest.mark.parametrize("name", ["sar-sift", "sar-sift-paper", "bfsift", "bfsift-paper", "s-gof", "m-gof"])
def test_a_known_warp_is_found(pair: SimulatedPair, name: str) -> None:
    found = featreg.match(pair.reference, pair.secondary, method=name, n_features=1500, refine=False)
    assert found.status == "ok"
    assert found.model
    points = np.array([[x, y] for x in (20.0, 150.0, 280.0) for y in (20.0, 150.0, 280.0)])
    error = found.model(points) - (points @ pair.truth[:, :2].T + pair.truth[:, 2])
    assert np.hypot(*error.T).max() < 1.0
