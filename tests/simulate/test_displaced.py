"""Pairs that moved: the field is what the images show."""

from __future__ import annotations

import math

import numpy as np
import pytest

from featreg.errors import ParameterError
from featreg.simulate import displaced_pair


@pytest.mark.parametrize("kind", ["glacier", "subsidence"])
def test_the_secondary_at_the_displaced_place_is_the_reference(kind: str) -> None:
    from scipy.ndimage import map_coordinates

    pair = displaced_pair(kind, (160, 200), size=5.0, looks=math.inf, change=0.0, seed=2)
    y, x = np.mgrid[0.0:160, 0.0:200]
    back = map_coordinates(pair.secondary, [y + pair.displacement[..., 1], x + pair.displacement[..., 0]], order=3)
    inside = np.s_[15:-15, 15:-15]
    still = np.corrcoef(pair.reference[inside].ravel(), pair.secondary[inside].ravel())[0, 1]
    moved = np.corrcoef(pair.reference[inside].ravel(), back[inside].ravel())[0, 1]
    assert moved > 0.98
    assert still < 0.9


def test_a_fault_moves_one_side() -> None:
    pair = displaced_pair("fault", (128, 160), size=8.0, looks=math.inf, change=0.0, seed=1)
    assert np.abs(np.log(pair.reference[20:, 10:60] / pair.secondary[20:, 10:60])).max() < 1e-3
    assert np.abs(np.log(pair.reference[20:-20, 90:150] / pair.secondary[28:-12, 90:150])).mean() < 0.02


def test_the_same_seed_gives_the_same_pair() -> None:
    first, second = (displaced_pair("glacier", (96, 96), seed=4) for _ in range(2))
    assert first.secondary.tobytes() == second.secondary.tobytes()
    with pytest.raises(ParameterError, match="did you mean 'fault'"):
        displaced_pair("fautl")


def test_a_displacement_that_no_image_can_show_is_refused() -> None:
    for kind in ("glacier", "subsidence"):
        with pytest.raises(ParameterError, match="folds"):
            displaced_pair(kind, (64, 64), size=64.0)
