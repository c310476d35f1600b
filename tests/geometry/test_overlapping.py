"""What a fit takes up of the errors of overlapping windows, against errors that are means over their pixels."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.geometry import Affine, ResidualField, Translation
from featreg.geometry.overlapping import MOST, share_taken_up
from featreg.interfaces import FailedFit, Model

SIDE = 40


def measured(rng: np.random.Generator, xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points that windows of white noise displace by 1 px, one standard deviation."""
    total = np.zeros((261, 261, 2))
    total[1:, 1:] = rng.normal(size=(260, 260, 2)).cumsum(axis=0).cumsum(axis=1)
    x, y = (xy - SIDE // 2).astype(int).T
    high, low = y + SIDE, x + SIDE
    return np.asarray(xy + (total[high, low] - total[y, low] - total[high, x] + total[y, x]) / SIDE)


@pytest.mark.parametrize("kind", [Affine, Translation])
def test_residuals_lack_as_much_as_is_said(kind: type[Model]) -> None:
    rng = np.random.default_rng(2)
    xy = rng.integers(SIDE // 2, 260 - SIDE // 2, (900, 2)).astype(np.float64)
    shown, lost = [], []
    for _ in range(60):
        there = measured(rng, xy)
        model = kind.from_estimate(xy, there)
        assert not isinstance(model, FailedFit)
        shown.append(((there - model(xy)) ** 2).mean())
        lost.append(share_taken_up(model, xy, there, SIDE))
    # Windows of other noise scatter by a tenth of what is left.
    assert np.mean(shown) == pytest.approx(1 - np.mean(lost), abs=0.03)
    assert np.mean(lost) > 20 * kind.minimum / len(xy)


def test_windows_that_do_not_overlap_lose_a_parameter_each() -> None:
    x, y = np.meshgrid(np.arange(12.0), np.arange(10.0))
    xy = 50 * np.column_stack([x.ravel(), y.ravel()])
    assert share_taken_up(Affine(np.eye(3)[:2]), xy, xy, SIDE) == pytest.approx(6 / 240)


def test_what_cannot_be_told_is_nothing_and_no_fit_loses_all() -> None:
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, 200, (60, 2))
    field = ResidualField.from_estimate(xy, xy + rng.normal(size=xy.shape))
    assert not isinstance(field, FailedFit)
    assert share_taken_up(field, xy, xy, SIDE) == 0
    near = rng.uniform(0, 10, (50, 2))
    assert share_taken_up(Affine(np.eye(3)[:2]), near, near, 200) == MOST
