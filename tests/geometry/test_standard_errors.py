"""Standard errors of the rigid model: over the whole chain of filter and fit, their intervals cover the truth."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg import registry
from featreg.geometry import (
    Rigid,
    dilution,
    inverse_variances,
    rigid_standard_errors,
    rigid_uncertainty,
    selection_cut,
)
from featreg.pipeline.pipeline import Pipeline
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.types import Matches

SIZE = 501
TRUTH = Rigid(4.0, 3.0, -2.0)
CENTRE = np.array([(SIZE - 1) / 2, (SIZE - 1) / 2])
Floats = NDArray[np.float64]


def registered(
    rng: np.random.Generator,
    *,
    good: int = 60,
    bad: int = 20,
    shared: float = 0.0,
    uneven: bool = False,
    threshold: str = "median+mad",
    start: str = "consensus",
    robust: bool = True,
) -> Registration:
    """Tie points with Gaussian errors, `shared` of whose variance all within a cell of 96 px have in common."""
    here = rng.uniform(0, SIZE, (good + bad, 2))
    sigma = 0.2 * (np.exp(rng.normal(0, 0.4, good + bad)) if uneven else np.ones(good + bad))
    _, cell = np.unique(np.floor(here / 96) @ [1, 100], return_inverse=True)
    common = rng.normal(0, 0.2, (cell.max() + 1, 2))[cell]
    errors = math.sqrt(1 - shared) * sigma[:, None] * rng.normal(size=here.shape) + math.sqrt(shared) * common
    there = TRUTH(here) + errors
    there[good:] += rng.uniform(-40, 40, (bad, 2))
    covariance = sigma[:, None, None] ** 2 * np.eye(2) if uneven else None
    mad = registry.create("filter", "mad", threshold=threshold, start=start)
    pipeline = Pipeline(None, (("mad", mad),), Rigid, robust=robust, parameters={"robust": robust})
    found = pipeline.fit(Matches(here, there, np.ones(good + bad), covariance), (SIZE, SIZE), (SIZE, SIZE))
    image = InputImage("array", (SIZE, SIZE))
    return replace(found, reference=image, secondary=image)


@pytest.mark.slow
@pytest.mark.parametrize(
    "made",
    [
        pytest.param({}, id="independent"),
        pytest.param({"shared": 0.5}, id="shared-by-neighbours"),
        pytest.param({"uneven": True}, id="uneven"),
        pytest.param({"good": 25, "bad": 15}, id="few"),
        pytest.param(
            {"threshold": "mad", "start": "all", "bad": 10, "robust": False}, id="the-papers-threshold-and-fit"
        ),
    ],
)
def test_intervals_of_95_percent_cover_the_truth_as_often(made: dict[str, Any]) -> None:
    """Through outlier cancellation and the weighted robust fit, for the rotation and both coordinates of the shift.

    It is 94 to 98 %; 400 trials scatter by 1.1.
    """
    from scipy.stats import t as student

    rng, hits, trials = np.random.default_rng(11), np.zeros(3), 0
    for _ in range(400):
        found = registered(rng, **made)
        errors = found.standard_errors
        if not errors:  # the paper's threshold left tie points in fewer than three places
            continue
        assert isinstance(found.model, Rigid)
        off = np.abs([found.model.rotation_deg - 4.0, *(found.model.shift_at(CENTRE) - TRUTH.shift_at(CENTRE))])
        reach = student.ppf(0.975, errors["degrees_of_freedom"])
        hits += off <= reach * np.array([errors["rotation_deg_se"], *errors["shift_se_px"]])
        trials += 1
    assert trials > 380
    assert (hits / trials > 0.92).all()
    assert (hits / trials < 0.985).all()


def test_without_selection_and_shared_errors_they_are_the_plain_ones() -> None:
    rng = np.random.default_rng(0)
    here = rng.uniform(0, 2000, (400, 2))
    there = TRUTH(here) + rng.normal(0, 0.3, here.shape)
    model = Rigid.from_estimate(here, there)
    assert model
    plain = rigid_uncertainty(here, there, at=CENTRE)
    placed = rigid_standard_errors(model, here, there, at=CENTRE)
    assert plain
    assert placed
    assert placed.rotation_deg == pytest.approx(plain.rotation_deg, rel=0.15)
    np.testing.assert_allclose(placed.shift, plain.shift, rtol=0.15)
    assert placed.sigma == pytest.approx(0.3, rel=0.05)


def test_what_a_selection_cuts_off_is_put_back() -> None:
    rng = np.random.default_rng(1)
    here = rng.uniform(0, 2000, (3000, 2))
    there = TRUTH(here) + rng.normal(0, 0.3, here.shape)
    length = TRUTH.residuals(here, there)
    for cut in (0.9, 0.6, 0.4):
        kept = length < cut
        found = rigid_standard_errors(TRUTH, here[kept], there[kept], at=CENTRE, cut=cut)
        assert found
        assert found.sigma == pytest.approx(0.3, rel=0.1)
    assert selection_cut(np.array([0.1, 0.5]), np.array([0.2, 7.0, 1.5])) == pytest.approx(0.5 + 0.3 * 1.0)
    assert selection_cut(np.array([0.1, 0.5]), np.array([0.2])) == math.inf
    assert selection_cut(np.zeros(0), np.zeros(0)) == math.inf


def test_too_few_places_leave_them_unknown() -> None:
    rng = np.random.default_rng(2)
    here = np.concatenate([rng.uniform(0, 50, (20, 2)), rng.uniform(200, 250, (20, 2))])
    assert not rigid_standard_errors(TRUTH, here, TRUTH(here), at=CENTRE)
    assert not rigid_standard_errors(TRUTH, here[:0], here[:0], at=CENTRE)


def test_identical_tie_points_have_none() -> None:
    here = np.random.default_rng(3).uniform(0, SIZE, (30, 2))
    found = rigid_standard_errors(TRUTH, here, TRUTH(here), at=CENTRE, cut=0.5)
    assert found
    assert found.rotation_deg == pytest.approx(0, abs=1e-9)


def test_the_result_and_its_file_hold_them(tmp_path: Path) -> None:
    found = registered(np.random.default_rng(4))
    errors = found.standard_errors
    assert set(errors) == {"rotation_deg_se", "shift_se_px", "degrees_of_freedom"}
    found.to_json(tmp_path / "result.json")
    again = Registration.from_json(tmp_path / "result.json")
    assert again.standard_errors == errors
    assert f'"rotation_deg_se": {errors["rotation_deg_se"]!r}' in (tmp_path / "result.json").read_text()
    assert again.model
    affine = featreg.fit(found.matches, model="affine")
    assert affine.standard_errors == {}


def test_precise_tie_points_count_more() -> None:
    """Half of the tie points is ten times as precise, and says so."""
    rng, gains = np.random.default_rng(5), []
    for _ in range(20):
        here = rng.uniform(0, SIZE, (60, 2))
        sigma = np.where(np.arange(60) < 30, 0.05, 0.5)
        there = TRUTH(here) + sigma[:, None] * rng.normal(size=here.shape)
        covariance = sigma[:, None, None] ** 2 * np.eye(2)
        covariance[::7] = np.nan
        models = [
            featreg.fit(Matches(here, there, np.ones(60), known), model="rigid", filters=()).model
            for known in (covariance, None)
        ]
        assert all(isinstance(model, Rigid) for model in models)
        gains.append([abs(model.rotation_deg - 4.0) for model in models if isinstance(model, Rigid)])
    weighted, equal = np.mean(gains, axis=0)
    assert weighted < 0.5 * equal


def test_weights_are_inverse_variances_where_these_are_known() -> None:
    covariance = np.array([0.1, np.nan, 0.3])[:, None, None] ** 2 * np.eye(2)
    weights = inverse_variances(covariance)
    assert weights is not None
    np.testing.assert_allclose(1 / weights, [0.0125, 0.0525, 0.0925])
    assert inverse_variances(None) is None
    assert inverse_variances(np.full((3, 2, 2), np.nan)) is None


def test_dilution_depends_on_where_the_places_are_and_not_on_how_many_tie_points_they_hold() -> None:
    grid = np.stack(np.meshgrid(np.linspace(0, 500, 5), np.linspace(0, 500, 5)), -1).reshape(-1, 2)
    spread = np.stack(np.meshgrid(np.arange(48, 500, 96.0), np.arange(48, 500, 96.0)), -1).reshape(-1, 2)
    near = np.random.default_rng(6).uniform(-2, 2, (len(spread), 2))
    corner = spread[(spread < 250).all(axis=1)]

    def of(xy: Floats) -> float:
        return dilution(TRUTH, xy, TRUTH(xy), at=grid)

    assert of(spread) < 0.5
    assert of(np.concatenate([spread, spread + near])) == pytest.approx(of(spread), rel=0.02)
    assert of(corner) > 1.5 * of(spread)
    assert math.isnan(of(spread[:1]))
    assert math.isnan(of(spread[:0]))
