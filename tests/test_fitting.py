"""The model of the user's own tie points."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg.errors import InputError
from featreg.geometry import Similarity
from featreg.simulate import SimulatedPair
from featreg.types import Matches
from made.models import grid_rmse

# The user's own tie points


def own_points(truth: NDArray[np.float64], good: int = 60, bad: int = 20) -> NDArray[np.float64]:
    rng = np.random.default_rng(0)
    here = rng.uniform(0, 500, (good + bad, 2))
    there = here @ truth[:, :2].T + truth[:, 2] + rng.normal(0, 0.2, here.shape)
    there[good:] += rng.uniform(20, 60, (bad, 2))
    return np.column_stack([here, there])


@pytest.mark.parametrize("form", ["array", "matches", "list"])
def test_fit_finds_the_model_of_the_users_points(pair: SimulatedPair, form: str) -> None:
    rows = own_points(pair.truth)
    points = {"array": rows, "matches": Matches(rows[:, :2], rows[:, 2:], np.ones(80)), "list": rows.tolist()}[form]
    found = featreg.fit(points, model="affine", reference_shape=(500, 500), secondary_shape=(520, 520))
    assert found.status == "ok", found.reason
    assert found.stages["fsc"][:60].all()
    assert not found.stages["fsc"][60:].any()
    assert grid_rmse(found, pair.truth, 500) < 0.3


def test_fit_without_filters_takes_all_points(pair: SimulatedPair) -> None:
    rows = own_points(pair.truth, 40, 0)
    found = featreg.fit(rows, model="similarity", filters=())
    assert dict(found.stages) == {}
    assert isinstance(found.model, Similarity)
    assert found.inliers.sum() == 40


@pytest.mark.parametrize("count", [0, 1, 2])
def test_fit_of_too_few_points_is_unreliable(count: int) -> None:
    rows = np.arange(4.0 * count).reshape(count, 4) if count else np.zeros((0, 4))
    found = featreg.fit(rows, model="affine")
    assert found.status == "unreliable"
    assert found.reason
    assert not found.model


@pytest.mark.parametrize("points", [np.zeros((5, 3)), np.zeros(4), "points", np.full((5, 4), np.nan)])
def test_fit_refuses_what_are_no_tie_points(points: Any) -> None:
    with pytest.raises(InputError):
        featreg.fit(points)
