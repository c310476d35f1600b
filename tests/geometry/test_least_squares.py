"""Least squares by blocks of rows: what numpy finds of all rows at once."""

from __future__ import annotations

import numpy as np
import pytest

from featreg.geometry.least_squares import BLOCK, least_squares, triangle


@pytest.mark.parametrize("shape", [(5, 9), (9, 9), (BLOCK // 9, 9), (BLOCK // 9 + 1, 9), (9000, 9), (3126, 60)])
def test_the_triangle_is_that_of_all_rows(shape: tuple[int, int]) -> None:
    rows = np.random.default_rng(0).normal(size=shape)
    found = triangle(rows)
    assert found.shape == (min(shape), shape[1])
    assert np.array_equal(found, np.triu(found))
    np.testing.assert_allclose(found.T @ found, rows.T @ rows, rtol=1e-12, atol=1e-10)


@pytest.mark.parametrize("columns", [(), (2,)])
@pytest.mark.parametrize("rows", [6, 40, 900])
def test_solutions_and_singular_values_are_numpys(rows: int, columns: tuple[int, ...]) -> None:
    rng = np.random.default_rng(1)
    # Ill-conditioned, as the terms of a rational polynomial are: by 1e6.
    design = rng.normal(size=(rows, 10)) @ np.diag(10.0 ** -np.linspace(0, 6, 10)) @ rng.normal(size=(10, 10))
    values = design @ rng.normal(size=(10, *columns)) + 1e-7 * rng.normal(size=(rows, *columns))
    solution, singular = least_squares(design, values)
    wanted, _, _, sizes = np.linalg.lstsq(design, values)
    assert solution.shape == wanted.shape
    np.testing.assert_allclose(singular, sizes, atol=1e-14 * sizes[0])
    np.testing.assert_allclose(solution, wanted, atol=1e-7 * np.abs(wanted).max())
    np.testing.assert_allclose(design @ solution, design @ wanted, atol=1e-11 * sizes[0])


def test_of_several_solutions_the_shortest_is_returned() -> None:
    column = np.random.default_rng(2).normal(size=(9000, 1))
    solution, singular = least_squares(np.hstack([column, column]), 3.0 * column[:, 0])
    assert singular[1] < 1e-12 * singular[0]
    np.testing.assert_allclose(solution, [1.5, 1.5])
