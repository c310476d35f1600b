"""Covariances of what a model predicts: they are what the draws show, and intervals cover the truth."""

from __future__ import annotations

import numpy as np
import pytest

from featreg.errors import InputError
from featreg.geometry import (
    Affine,
    Homography,
    Polynomial2,
    Rigid,
    Similarity,
    Translation,
    prediction_covariance,
    regional_covariance,
    rigid_uncertainty,
)
from featreg.interfaces import FailedFit, Model
from made.models import fitted, scattered

BENT = Polynomial2([[0, 1, 0, 0.01, 0, 0], [0, 0, 1, 0, 0, 0]])  # type: ignore[arg-type]


def test_rigid_intervals_cover_the_truth() -> None:
    """95 % intervals hold the true rotation and the true shift in 93 to 97 % of 2000 draws, weighted or not."""
    from scipy.stats import t as student

    truth, at, sigma = Rigid(4.0, 6.0, -4.0), np.array([450.0, 300.0]), 0.7
    for weighted in (False, True):
        rng = np.random.default_rng(11 + weighted)
        hits = np.zeros(3)
        for _ in range(2000):
            xy = rng.uniform(0, 600, (12, 2))
            weights = rng.uniform(0.2, 4, 12) if weighted else None
            spread = sigma / np.sqrt(weights)[:, None] if weights is not None else sigma
            noisy = truth(xy) + rng.normal(0, 1, (12, 2)) * spread
            model = Rigid.from_estimate(xy, noisy, weights)
            error = rigid_uncertainty(xy, noisy, weights, at=at)
            assert model
            assert error
            off = np.abs([model.rotation_deg - 4.0, *(model.shift_at(at) - truth.shift_at(at))])
            hits += off <= student.ppf(0.975, error.dof) * np.array([error.rotation_deg, *error.shift])
        assert (hits / 2000 > 0.93).all()
        assert (hits / 2000 < 0.97).all()


def test_uncertainty_needs_a_fit() -> None:
    assert not rigid_uncertainty(np.zeros((1, 2)), np.zeros((1, 2)), at=(0, 0))
    assert not rigid_uncertainty(np.zeros((5, 2)), np.zeros((5, 2)), at=(0, 0))


def test_prediction_covariance_is_what_the_draws_show(cls: type[Model], example: Model) -> None:
    """Mapped points scatter over 800 draws as each draw alone says, near the points and beyond them, weighted."""
    rng = np.random.default_rng(8)
    xy, at = scattered(30), np.array([[450.0, 300.0], [1100.0, -50.0]])
    weights = rng.uniform(0.3, 3, 30)
    mapped, said = [], []
    for _ in range(800):
        noisy = example(xy) + rng.normal(0, 0.3, xy.shape) / np.sqrt(weights)[:, None]
        fit = fitted(cls, xy, noisy, weights)
        covariance = prediction_covariance(fit, xy, noisy, weights, at=at)
        assert not isinstance(covariance, FailedFit)
        mapped.append(fit(at))
        said.append(covariance)
    for i in range(2):
        seen = np.cov(np.array(mapped)[:, i].T)
        mean = np.mean(said, axis=0)[i]
        np.testing.assert_allclose(mean, seen, atol=0.15 * np.trace(seen))
        np.testing.assert_allclose(np.trace(mean), np.trace(seen), rtol=0.12)


def test_prediction_covariance_agrees_with_the_rigid_errors() -> None:
    rng, at = np.random.default_rng(1), np.array([700.0, -20.0])
    xy, weights = scattered(20), rng.uniform(0, 2, 20)
    noisy = Rigid(4.37, 25.4, -17.3)(xy) + rng.normal(0, 1, xy.shape)
    error = rigid_uncertainty(xy, noisy, weights, at=at)
    covariance = prediction_covariance(fitted(Rigid, xy, noisy, weights), xy, noisy, weights, at=at)
    assert error
    assert not isinstance(covariance, FailedFit)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), error.shift, rtol=1e-9)


def test_prediction_covariance_of_a_known_error_takes_the_weights_as_they_are() -> None:
    xy, at = scattered(30), np.array([[20.0, 30.0]])
    model, weights = fitted(Affine, xy, xy), np.linspace(1.0, 3.0, 30)
    one, other = (
        prediction_covariance(model, xy, xy, w, at=at, sigma=s) for w, s in ((4 * weights, 1.0), (weights, 0.5))
    )
    assert not isinstance(one, FailedFit)
    assert not isinstance(other, FailedFit)
    np.testing.assert_allclose(one, other)
    # The mean of equal points: sigma^2 over the sum of their weights.
    centre = prediction_covariance(Translation(0.0, 0.0), xy, xy, np.full(30, 4.0), at=at, sigma=1.0)
    assert not isinstance(centre, FailedFit)
    np.testing.assert_allclose(centre[0], np.eye(2) / 120)


def test_prediction_covariance_needs_more_than_the_fewest_points() -> None:
    xy = scattered(3)
    assert "no degree of freedom" in prediction_covariance(fitted(Affine, xy, xy), xy, xy, at=(0, 0)).reason  # type: ignore[union-attr]
    with pytest.raises(InputError, match="derivatives"):
        prediction_covariance(BENT.inverse, xy, xy, at=(0, 0))


@pytest.mark.parametrize("cls", [Translation, Rigid, Similarity, Affine, Homography, Polynomial2])
def test_regional_covariance_is_that_of_fits_without_each_region(cls: type[Model]) -> None:
    rng, at = np.random.default_rng(3), np.array([[0.0, 0.0], [500.0, 20.0], [250.0, 400.0]])
    xy = rng.uniform(0, 500, (120, 2))
    noisy = xy + np.array([3.0, -2.0]) + rng.normal(0, 0.5, xy.shape)
    region = np.floor(xy / 170).astype(np.int64) @ np.array([1, 3])
    refitted = np.stack([fitted(cls, xy[region != k], noisy[region != k])(at) for k in range(9)])
    offsets = refitted - refitted.mean(axis=0)
    wanted = 8 / 9 * np.einsum("kna,knb->nab", offsets, offsets)
    covariance = regional_covariance(fitted(cls, xy, noisy), xy, noisy, region, at=at)
    assert not isinstance(covariance, FailedFit)
    np.testing.assert_allclose(covariance, wanted, rtol=0.05, atol=0.02 * np.trace(wanted, axis1=1, axis2=2).max())


def test_regional_covariance_sees_errors_that_neighbours_share() -> None:
    """With an error common to each region the truth is as far off as it says, not as independent points would be."""
    rng, at = np.random.default_rng(4), np.array([[250.0, 250.0], [0.0, 500.0]])
    xy = rng.uniform(0, 500, (400, 2))
    region = np.minimum(xy // 125, 3).astype(np.int64) @ np.array([1, 4])
    missed: list[float] = []
    regional: list[float] = []
    independent: list[float] = []
    for _ in range(60):
        moved = xy + rng.normal(0, 1, (16, 2))[region] + rng.normal(0, 0.2, xy.shape)
        model = fitted(Affine, xy, moved)
        missed.append(np.sum((model(at) - at) ** 2))
        for method, extra, into in (
            (regional_covariance, (region,), regional),
            (prediction_covariance, (), independent),
        ):
            covariance = method(model, xy, moved, *extra, at=at)
            assert not isinstance(covariance, FailedFit)
            into.append(np.trace(covariance, axis1=1, axis2=2).sum())
    assert 0.7 < np.mean(regional) / np.mean(missed) < 1.6
    assert np.mean(independent) < 0.2 * np.mean(missed)


def test_regional_covariance_leaves_points_without_weight_out() -> None:
    rng, at = np.random.default_rng(5), np.array([[50.0, 50.0]])
    xy = rng.uniform(0, 100, (60, 2))
    noisy, region = xy + rng.normal(0, 0.3, xy.shape), (xy[:, 0] // 25).astype(np.int64)
    weights = np.where(np.arange(60) < 20, 0.0, 2.0)
    model = fitted(Affine, xy[20:], noisy[20:])
    wanted = regional_covariance(model, xy[20:], noisy[20:], region[20:], at=at)
    found = regional_covariance(model, xy, noisy, region, weights, at=at)
    np.testing.assert_allclose(found, wanted, rtol=1e-9)


def test_regional_covariance_refuses_arrays_that_do_not_fit() -> None:
    """Its kernel reads as many as there are points, whatever it is given."""
    xy = scattered(30)
    model, region = fitted(Affine, xy, xy), np.arange(30) % 5
    for wrong in (region[:5], region[:, None], region[:0]):
        with pytest.raises(InputError, match="30 points need as many numbers of regions, got shape"):
            regional_covariance(model, xy, xy, wrong, at=xy)
    for at in (xy[0], xy[:, :1], np.zeros((0, 3))):
        with pytest.raises(InputError, match=r"must be an \(N, 2\) array"):
            regional_covariance(model, xy, xy, region, at=at)


def test_regional_covariance_needs_three_regions_that_can_be_left_out() -> None:
    xy = scattered(6)
    model = fitted(Affine, xy, xy)
    assert "2 regions" in regional_covariance(model, xy, xy, np.arange(6) % 2, at=xy[:1]).reason  # type: ignore[union-attr]
    lopsided = np.array([0, 0, 0, 0, 1, 2])
    assert "do not determine" in regional_covariance(model, xy, xy, lopsided, at=xy[:1]).reason  # type: ignore[union-attr]
