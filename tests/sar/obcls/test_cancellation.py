"""Outliers are cancelled, one after the other, until the rest agrees."""

from __future__ import annotations

import numpy as np
import pytest

from featreg import registry
from featreg.geometry import Rigid
from featreg.interfaces import FilterContext
from featreg.sar.obcls.cancellation import cancelled, cancelled_fit
from featreg.types import Matches
from made.parking_lots import rigid, rigid_fit


@pytest.mark.parametrize("threshold", ["mad", "median+mad"])
def test_outliers_are_cancelled_and_good_points_stay(threshold: str) -> None:
    rng = np.random.default_rng(0)
    a, truth = rng.uniform(0, 500, (80, 2)), rigid(4.0)
    b = truth(a) + rng.normal(0, 0.3, a.shape)
    b[:20] += rng.uniform(-40, 40, (20, 2))
    wrong = np.hypot(*(b - truth(a)).T) > 3
    context = FilterContext((500, 500), (500, 500), Rigid)
    kept = registry.create("filter", "mad", threshold=threshold).keep(Matches(a, b, np.ones(80)), context)
    assert not kept[wrong].any()
    assert kept.sum() >= (5 if threshold == "mad" else 45)


def test_a_consensus_survives_a_majority_of_outliers() -> None:
    rng = np.random.default_rng(1)
    a, truth = rng.uniform(0, 500, (90, 2)), rigid(20.0)
    b = truth(a) + rng.normal(0, 0.3, a.shape)
    b[:55] = rng.uniform(0, 500, (55, 2))
    context = FilterContext((500, 500), (500, 500), Rigid)
    kept = registry.create("filter", "mad", start="consensus").keep(Matches(a, b, np.ones(90)), context)
    assert kept[55:].sum() > 28
    assert kept[:55].sum() <= 1


def test_residuals_that_are_all_zero_cancel_nothing() -> None:
    a = np.random.default_rng(2).uniform(0, 100, (12, 2))
    for threshold in ("mad", "median+mad"):
        assert cancelled(lambda kept: np.zeros(12), 12, threshold=threshold).all()
    model, kept = cancelled_fit(rigid_fit, a, rigid(3.0)(a))
    assert kept.all()
    assert isinstance(model, Rigid)
    assert model.rotation_deg == pytest.approx(3.0)


def test_what_cannot_be_fitted_is_cancelled_whole() -> None:
    a = np.full((6, 2), 7.0)
    model, kept = cancelled_fit(rigid_fit, a, a)
    assert model is None
    assert not kept.any()
    assert cancelled_fit(rigid_fit, a[:0], a[:0])[0] is None
