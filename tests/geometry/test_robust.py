"""Sample consensus: every model among outliers, few points, points in one place."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError, ParameterError
from featreg.geometry import Affine, Polynomial2, Translation
from featreg.geometry.robust import fit_consensus
from featreg.interfaces import FailedFit, Model
from featreg.types import FloatArray
from made.outliers import BENT, CORNERS, MODELS, every_model, mixed


def consensus(model: Model, reference: FloatArray, secondary: FloatArray, seed: int = 0, **keywords: Any) -> Any:
    keywords = {"threshold": 3.0, **keywords}
    return fit_consensus(type(model), reference, secondary, rng=np.random.default_rng(seed), **keywords)


@every_model
@pytest.mark.parametrize("seed", range(5))
def test_every_model_survives_half_of_outliers(model: Model, seed: int) -> None:
    reference, secondary, good = mixed(model, 0.5, seed=seed)
    found, inliers = consensus(model, reference, secondary, seed)
    assert type(found) is type(model)
    assert inliers[good].mean() > 0.99
    assert inliers[~good].mean() < 0.01
    # The least-squares fit of the good points is the best that could be done.
    best = type(model).from_estimate(reference[good], secondary[good])
    assert best
    np.testing.assert_allclose(found(CORNERS), best(CORNERS), atol=0.5)


@pytest.mark.parametrize("model", MODELS[:4], ids=[type(m).__name__ for m in MODELS[:4]])
def test_85_percent_of_outliers_over_many_seeds(model: Model) -> None:
    for seed in range(40):
        reference, secondary, good = mixed(model, 0.15, seed=seed)
        found, inliers = consensus(model, reference, secondary, seed, iterations=5000)
        assert found, seed
        assert inliers[good].mean() > 0.98
        assert inliers[~good].mean() < 0.01
        assert np.abs(found(CORNERS) - model(CORNERS)).max() < 0.5


@every_model
def test_the_same_seed_gives_the_same_bits(model: Model) -> None:
    reference, secondary, _ = mixed(model, 0.4)
    (a, kept_a), (b, kept_b) = (consensus(model, reference, secondary, 7) for _ in range(2))
    np.testing.assert_array_equal(a(CORNERS), b(CORNERS))
    np.testing.assert_array_equal(kept_a, kept_b)


@every_model
def test_mask_is_the_residual_of_the_model(model: Model) -> None:
    reference, secondary, _ = mixed(model, 0.4)
    found, inliers = consensus(model, reference, secondary, threshold=2.0)
    np.testing.assert_array_equal(inliers, found.residuals(reference, secondary) <= 2.0)


@every_model
def test_too_few_points(model: Model) -> None:
    for count in range(model.minimum):
        found, inliers = consensus(model, *mixed(model, 1.0, count=count)[:2])
        assert isinstance(found, FailedFit)
        assert f"{model.minimum} needed, {f'got {count}' if count else 'none given'}" in found.reason
        assert inliers.shape == (count,)
        assert not inliers.any()


@every_model
def test_just_enough_points_that_agree(model: Model) -> None:
    reference, secondary, _ = mixed(model, 1.0, count=model.minimum, noise=0.0, seed=3)
    found, inliers = consensus(model, reference, secondary)
    assert found, found
    assert inliers.all()


def test_no_agreement_beyond_the_sample_is_no_consensus() -> None:
    reference, secondary, _ = mixed(MODELS[3], 0.0, count=12)
    found, inliers = consensus(MODELS[3], reference, secondary, threshold=0.01)
    assert isinstance(found, FailedFit)
    assert "no consensus" in found.reason
    assert not inliers.any()


@every_model
def test_all_points_in_one_place(model: Model) -> None:
    reference, secondary = np.full((30, 2), 5.0), np.full((30, 2), 8.0)
    found, inliers = consensus(model, reference, secondary)
    assert bool(found) == isinstance(model, Translation)
    assert inliers.all() == isinstance(model, Translation)


def test_small_cluster_far_from_the_origin() -> None:
    """Good points in a corner of 40 px of a large scene, where samples lie close together."""
    model = Affine(np.array([[1.0, 0.01, 3.0], [-0.01, 1.0, 5.0]]))
    rng = np.random.default_rng(0)
    reference = 29_000 + np.vstack([rng.uniform(0, 40, (60, 2)), rng.uniform(0, 900, (60, 2))])
    secondary = model(reference) + rng.normal(0, 0.1, (120, 2))
    secondary[60:] = 29_000 + rng.uniform(0, 900, (60, 2))
    found, inliers = consensus(model, reference, secondary, threshold=1.0)
    assert found
    assert inliers[:60].mean() > 0.95
    assert inliers[60:].mean() < 0.05


def test_bad_arguments_are_refused() -> None:
    xy = np.random.default_rng(0).uniform(0, 9, (9, 2))
    for wrong in ({"threshold": 0.0}, {"threshold": np.nan}, {"iterations": 0}, {"confidence": 1.0}, {"widening": 0.5}):
        with pytest.raises(ParameterError):
            consensus(MODELS[3], xy, xy, **wrong)
    for rows in ([9], [-1]):
        with pytest.raises(ParameterError, match="candidates"):
            consensus(MODELS[3], xy, xy, candidates=np.array(rows))
    with pytest.raises(InputError):
        consensus(MODELS[3], xy, xy[:4])
    with pytest.raises(InputError):
        consensus(MODELS[3], xy * np.nan, xy)


class Bent:
    """A model bound to context first: a known bend, an unknown shift; an object, not a class."""

    minimum = 1

    def from_estimate(self, reference: FloatArray, secondary: FloatArray, weights: Any = None) -> Model | FailedFit:
        shift = Translation.from_estimate(MODELS[5](reference), secondary, weights)
        if not shift:
            return shift
        coefficients = BENT[:, :6].copy()
        coefficients[:, 0] += shift.shift_at((0.0, 0.0))
        return Polynomial2(coefficients, (500.0, 480.0), 500.0)


def test_a_model_bound_to_context(caplog: pytest.LogCaptureFixture) -> None:
    reference, secondary, good = mixed(MODELS[5], 0.5)
    bound: Any = Bent()
    with caplog.at_level("INFO", logger="featreg.geometry.robust"):
        found, inliers = fit_consensus(
            bound, reference, secondary + 7.0, threshold=3.0, rng=np.random.default_rng(0), widening=6.0
        )
    assert "no hypotheses of its own" in caplog.text
    assert inliers[good].mean() > 0.99
    assert found
    np.testing.assert_allclose(found(CORNERS), MODELS[5](CORNERS) + 7.0, atol=0.2)
    # Two points are enough for it, though not for an affine hypothesis.
    found, inliers = fit_consensus(
        bound, reference[good][:2], secondary[good][:2], threshold=9.0, rng=np.random.default_rng(0)
    )
    assert found
