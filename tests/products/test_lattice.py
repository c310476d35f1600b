"""Positions between the nodes of a lattice, and grids with other pixels."""

from __future__ import annotations

import numpy as np

from featreg.geometry import Affine, Homography
from featreg.products.lattice import OtherGrids, lattice_of, resized


def test_positions_between_nodes_are_those_of_the_model() -> None:
    model = Homography(np.array([[1.01, 0.02, 5], [-0.03, 0.98, 8], [2e-6, -1e-6, 1]]))
    lattice = lattice_of(model, 4000, 7000, (300, 500))
    assert lattice.step > 1
    x, y = lattice.positions()
    rows, cols = np.mgrid[7000:7300, 4000:4500]
    exact = model(np.column_stack([cols.ravel(), rows.ravel()]).astype(float))
    assert np.abs(x.ravel() - exact[:, 0]).max() < 1e-4
    assert np.abs(y.ravel() - exact[:, 1]).max() < 1e-4
    bent = Homography(np.array([[1.0, 0, 0], [0, 1, 0], [1e-3, 0, 1]]))
    assert lattice_of(bent, 0, 0, (100, 100)).step == 1
    assert lattice_of(lambda xy: xy, 0, 0, (100, 100)).step == 1


def test_the_half_pixel_of_other_grids() -> None:
    model = Affine(np.array([[1.0, 0, 10], [0, 1, 20]]))
    double = OtherGrids(model, resized((1, 1)), resized((2, 2)))
    assert double(np.array([[0.0, 0.0]])).tolist() == [[20.5, 40.5]]
    np.testing.assert_allclose(double.inverse(double(np.array([[3.0, 4.0]]))), [[3, 4]])
