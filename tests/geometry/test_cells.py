"""Cells: how much of an image tie points cover."""

from __future__ import annotations

import numpy as np
import pytest

from featreg.geometry.cells import spread

SHAPE = (60, 90)


def test_spread_counts_the_cells_that_are_hit() -> None:
    steps = (np.arange(8) + 0.5) / 8
    centres = np.stack(np.meshgrid(steps * SHAPE[1], steps * SHAPE[0]), -1).reshape(-1, 2) - 0.5
    assert spread(centres, SHAPE) == 1.0
    assert spread(centres[:16], SHAPE) == 0.25
    assert spread(np.zeros((0, 2)), SHAPE) == 0.0
    assert spread(np.array([[-50.0, 5], [1e6, 5]]), SHAPE) == 0.0
    assert spread(np.array([[0, 0], [1, 1], [79.4, 79.4], [-0.4, -0.4], [200, 3]]), (80, 80)) == 2 / 64
    assert spread(np.array([[79.5, 0]]), (40, 80)) == 1 / 64


@pytest.mark.parametrize("seed", range(5))
def test_spread_is_that_of_the_mirrored_image(seed: int) -> None:
    """The image begins half a pixel before the centres from which points count."""
    shape = (16, 24)
    xy = np.random.default_rng(seed).uniform(-0.5, (23.5, 15.5), (20, 2))
    assert spread((23, 15) - xy, shape) == spread(xy, shape)
