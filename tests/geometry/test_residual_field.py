"""The residual field: smooth displacements recovered, noise smoothed away, bounded where nothing is known."""

from __future__ import annotations

import json
import pickle
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.interpolate import BSpline

import featreg
from featreg.errors import InputError
from featreg.geometry import Affine, ResidualField, model_from_dict, model_to_dict
from featreg.geometry.residual_field import FOLDS, RIDGE, SMOOTHING, WORSE, _folds
from featreg.geometry.robust import fit_consensus
from featreg.interfaces import FailedFit
from featreg.types import FloatArray

PLANE = np.array([[1.01, -0.02, 30.0], [0.015, 0.99, -12.0]])


def wavy(xy: FloatArray) -> FloatArray:
    x, y = xy.T / 1000.0
    moved = np.column_stack([3.0 * np.sin(5 * x) * np.cos(4 * y), 2.0 * np.cos(6 * x + 3 * y)])
    return np.asarray(Affine(PLANE)(xy) + moved)


@pytest.fixture(scope="module")
def ties() -> tuple[FloatArray, FloatArray]:
    here = np.random.default_rng(0).uniform(0, 1000, (1500, 2))
    return here, wavy(here)


def inner() -> FloatArray:
    return np.stack(np.meshgrid(np.linspace(50, 950, 15), np.linspace(50, 950, 15)), -1).reshape(-1, 2)


def fitted(here: FloatArray, there: FloatArray, weights: FloatArray | None = None) -> ResidualField:
    model = ResidualField.from_estimate(here, there, weights)
    assert model, model
    return model


@pytest.fixture(scope="module")
def field(ties: tuple[FloatArray, FloatArray]) -> ResidualField:
    """The model of the exact points."""
    return fitted(*ties)


def test_a_smooth_displacement_is_recovered(ties: tuple[FloatArray, FloatArray], field: ResidualField) -> None:
    assert np.abs(field(inner()) - wavy(inner())).max() < 0.02
    plane = Affine.from_estimate(*ties)
    assert plane
    assert np.abs(plane(inner()) - wavy(inner())).max() > 2


def test_noise_is_smoothed(ties: tuple[FloatArray, FloatArray]) -> None:
    noise = np.random.default_rng(1).normal(0, 0.5, ties[1].shape)
    error = fitted(ties[0], ties[1] + noise)(inner()) - wavy(inner())
    assert np.sqrt((error**2).mean()) < 0.2


def test_errors_that_neighbours_share_are_smoothed() -> None:
    rng = np.random.default_rng(3)
    here = rng.uniform(0, 1000, (4000, 2))
    # Windows of 50 px that overlap: each error is the mean of those of the ground around.
    ground = cv2.GaussianBlur(rng.normal(size=(1000, 1000, 2)), (0, 0), 20)
    ground *= 0.5 / ground.std()
    column, row = here.astype(int).T
    there = Affine(PLANE)(here) + ground[row, column]
    error = fitted(here, there)(inner()) - Affine(PLANE)(inner())
    assert np.sqrt((error**2).mean()) < 0.25


def test_an_affine_map_stays_one(ties: tuple[FloatArray, FloatArray]) -> None:
    there = Affine(PLANE)(ties[0]) + np.random.default_rng(1).normal(0, 0.5, ties[1].shape)
    assert np.abs(fitted(ties[0], there)(inner()) - Affine(PLANE)(inner())).max() < 0.15


def test_points_of_no_weight_count_for_nothing(ties: tuple[FloatArray, FloatArray]) -> None:
    weights = np.ones(1500)
    weights[::3] = 0
    there = ties[1].copy()
    there[::3] += 50
    model = fitted(ties[0], there, weights)
    assert np.abs(model(inner()) - wavy(inner())).max() < 0.1


def test_consensus_finds_it_among_outliers(ties: tuple[FloatArray, FloatArray]) -> None:
    rng = np.random.default_rng(2)
    bad = rng.random(1500) < 0.4
    there = np.where(bad[:, None], rng.uniform(0, 1000, ties[1].shape), ties[1])
    model, inliers = fit_consensus(ResidualField, ties[0], there, threshold=1.5, rng=rng)
    assert model
    assert inliers[~bad].mean() > 0.99
    assert inliers[bad].mean() < 0.02
    assert np.abs(model(inner()) - wavy(inner())).max() < 0.3


def plain_field(here: FloatArray, there: FloatArray, weights: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """The coefficients by full matrices, and scipy's splines."""
    plane = Affine.from_estimate(here, there, weights)
    assert plane
    low, high = here.min(axis=0), here.max(axis=0)
    residual, weight = there - plane(here), weights / weights.mean()
    lines = []
    for axis, count in enumerate(shape[::-1]):
        knots = np.arange(-3, count + 1, dtype=np.float64)
        place = (here[:, axis] - low[axis]) / (high[axis] - low[axis]) * (count - 3)
        lines.append(BSpline.design_matrix(place, knots, 3).toarray())
    design = (lines[1][:, :, None] * lines[0][:, None, :]).reshape(len(here), -1)
    down, across = (np.diff(np.eye(count), 2, axis=0) for count in shape)
    penalty = np.kron(down.T @ down, np.eye(shape[1])) + np.kron(np.eye(shape[0]), across.T @ across)
    unit = float(np.trace(design.T @ (weight[:, None] * design))) / len(penalty)
    fold = _folds(here, low, high)

    def solved(kept: Any, smoothing: float) -> FloatArray:
        heavy = design[kept].T * weight[kept]
        stiff = heavy @ design[kept] + unit * (smoothing * penalty + RIDGE * np.eye(len(penalty)))
        return np.asarray(np.linalg.solve(stiff, heavy @ residual[kept]))

    chosen, best = SMOOTHING[-1], np.inf
    for smoothing in SMOOTHING[::-1]:
        missed = 0.0
        for number in range(FOLDS**2):
            own = fold == number
            off = design[own] @ solved(~own, smoothing) - residual[own]
            missed += float(weight[own] @ (off**2).sum(axis=1))
        if missed < best:
            chosen, best = smoothing, missed
        elif missed > WORSE * best:
            break
    return solved(np.ones(len(here), np.bool_), chosen).T.reshape(2, *shape)


@pytest.mark.parametrize(("noise", "shape"), [(0.0, (6, 8)), (0.3, (6, 8)), (3.0, (8, 6))])
def test_coefficients_are_those_of_full_matrices(noise: float, shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(4)
    here = rng.uniform(0, 1, (150, 2)) * [1000, 600]
    here = here if shape[0] < shape[1] else here[:, ::-1].copy()
    there, weights = wavy(here) + rng.normal(0, 1, here.shape) * noise, rng.uniform(0.5, 2, len(here))
    found = fitted(here, there, weights).field
    assert found.shape == (2, *shape)
    np.testing.assert_allclose(found, plain_field(here, there, weights, shape), atol=1e-9)


def test_it_is_bounded_far_away(field: ResidualField) -> None:
    far = np.array([[-5000.0, 500.0], [500.0, 9000.0], [1e6, -1e6]])
    assert np.hypot(*field.displacement(far).T).max() <= field.limit + 1e-12
    rim = np.array([[field.frame[0], 500.0]])
    assert np.allclose(field.displacement(far[:1]), field.displacement(rim))


def test_the_inverse_goes_back(ties: tuple[FloatArray, FloatArray], field: ResidualField) -> None:
    assert np.abs(field.inverse(field(inner())) - inner()).max() < 1e-8
    assert field.inverse.inverse is field
    assert np.isnan(field.inverse(np.array([[np.nan, 1.0]]))).all()
    with pytest.raises(InputError, match="not fitted"):
        field.inverse.from_estimate(*ties)


def test_it_survives_json_and_pickle(field: ResidualField) -> None:
    record = json.loads(json.dumps(model_to_dict(field)))
    assert record["type"] == "residual-field"
    assert np.array_equal(model_from_dict(record)(inner()), field(inner()))
    assert np.array_equal(pickle.loads(pickle.dumps(field))(inner()), field(inner()))


def test_the_pipeline_takes_it(ties: tuple[FloatArray, FloatArray]) -> None:
    result = featreg.fit(np.c_[ties][:400], model="residual-field", reference_shape=(1000, 1000))
    assert result.status == "ok", result.reason


def test_what_the_points_do_not_determine_fails(
    ties: tuple[FloatArray, FloatArray], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("featreg.geometry.residual_field.RIDGE", -1e3)
    failed = ResidualField.from_estimate(*ties)
    assert isinstance(failed, FailedFit)
    assert "the 1500 points do not determine 15 x 15 coefficients" in failed.reason


@pytest.mark.parametrize("count", [0, 3, 15])
def test_too_few_points_fail(ties: tuple[FloatArray, FloatArray], count: int) -> None:
    assert isinstance(ResidualField.from_estimate(ties[0][:count], ties[1][:count]), FailedFit)


def test_points_on_a_line_fail() -> None:
    line = np.column_stack([np.arange(50.0), 2 * np.arange(50.0)])
    assert isinstance(ResidualField.from_estimate(line, line), FailedFit)


@pytest.mark.parametrize(
    "given",
    [
        {"field": np.zeros((2, 3, 4))},
        {"field": np.full((2, 4, 4), np.nan)},
        {"frame": (1.0, 0.0, 0.0, 1.0)},
        {"matrix_rows": np.eye(3)},
        {"bound": -1.0},
        {"bound": float("inf")},
    ],
)
def test_nonsense_is_refused(given: dict[str, Any]) -> None:
    values: dict[str, Any] = {"matrix_rows": PLANE, "field": np.zeros((2, 4, 4)), "frame": (0.0, 0.0, 1.0, 1.0)}
    with pytest.raises(InputError):
        ResidualField(**{**values, **given})
