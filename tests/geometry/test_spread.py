"""How much of an image points cover: of 8 x 8 cells, those that hold one."""

from __future__ import annotations

import numpy as np
import pytest

from featreg.geometry import spread
from featreg.types import FloatArray


def lattice(shape: tuple[int, int], inset: float) -> FloatArray:
    """Points in the middle of the 8 x 8 cells, moved towards the lower right by a share of a cell."""
    share = (np.arange(8) + 0.5 + inset) / 8
    x, y = np.meshgrid(share * shape[1] - 0.5, share * shape[0] - 0.5)
    return np.column_stack([x.ravel(), y.ravel()])


@pytest.mark.parametrize("inset", [0.0, -0.49, 0.49])
def test_a_point_in_every_cell(inset: float) -> None:
    assert spread(lattice((600, 500), inset), (600, 500)) == 1.0
    assert spread(lattice((600, 500), inset)[:16], (600, 500)) == 0.25


def test_the_first_pixel_covers_half_a_pixel_on_either_side_of_its_centre() -> None:
    """Cells of an image of 80 pixels are 10 wide: their borders lie at 9.5, 19.5, ..."""
    assert spread(np.array([[9.4, 0.0], [0.0, 0.0]]), (80, 80)) == 1 / 64
    assert spread(np.array([[9.6, 0.0], [0.0, 0.0]]), (80, 80)) == 2 / 64
    assert spread(np.array([[-0.4, -0.4], [79.4, 79.4]]), (80, 80)) == 2 / 64


def test_the_mirror_image_is_spread_alike() -> None:
    shape = (61, 83)
    for seed in range(20):
        xy = np.random.default_rng(seed).uniform(-0.5, np.array(shape[::-1]) - 0.5, (40, 2))
        found = spread(xy, shape)
        assert spread(np.array([82, 0]) + xy * [-1, 1], shape) == found
        assert spread(np.array([0, 60]) + xy * [1, -1], shape) == found
        assert spread(xy[:, ::-1], shape[::-1]) == found


def test_points_outside_and_none_at_all() -> None:
    assert spread(np.zeros((0, 2)), (80, 80)) == 0.0
    assert spread(np.array([[-50.0, 5], [1e6, 5], [np.nan, 5], [79.6, 0]]), (80, 80)) == 0.0
    assert spread(np.array([[79.5, 0]]), (40, 80)) == 1 / 64
