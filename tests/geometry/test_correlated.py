"""The covariance of a model whose tie points share errors over a length that is not known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.geometry import (
    Affine,
    Homography,
    Polynomial2,
    ResidualField,
    Rigid,
    Similarity,
    Translation,
    correlated_covariance,
    prediction,
    prediction_covariance,
)
from featreg.geometry.base import normalise
from featreg.geometry.correlated import EXPONENTIAL, LENGTHS, SHARED, correlated_prediction
from featreg.geometry.correlated_kernels import estimators, gathered, group_normals, interval
from featreg.geometry.uncertainty import derivatives, linearised
from featreg.interfaces import Model
from featreg.registry import model_class

SIZE = 512
TRUTH = Rigid(4.0, 3.0, -2.0)
Floats = NDArray[np.float64]
GRID = np.stack(np.meshgrid(np.linspace(0, SIZE, 5), np.linspace(0, SIZE, 5)), -1).reshape(-1, 2)


def waves(rng: np.random.Generator, xy: Floats, length: float) -> Floats:
    """Unit Gaussian errors (M, 2) whose correlation falls as exp(-d^2 / 2 length^2); independent for 0."""
    if not length:
        return rng.normal(size=xy.shape)
    phase = xy @ rng.normal(0, 1 / length, (2, 300))
    along = [np.cos(phase + rng.uniform(0, 2 * np.pi, 300)).sum(axis=1) for _ in range(2)]
    return np.asarray(math.sqrt(2 / 300) * np.column_stack(along))


def errors(kind: type[Model], length: float, sets: int, seed: int = 0) -> tuple[float, float]:
    """Share of 95 % intervals that cover the truth, and root mean square stated over true error."""
    from scipy.stats import t as student

    rng, hits, stated, true = np.random.default_rng(seed), [], [], []
    right: Model = TRUTH if kind.minimum > 1 else Translation(3.0, -2.0)
    for _ in range(sets):
        here = rng.uniform(0, SIZE, (300, 2))
        there = right(here) + 0.3 * (
            math.sqrt(0.9) * waves(rng, here, length) + math.sqrt(0.1) * rng.normal(size=here.shape)
        )
        model = kind.from_estimate(here, there)
        assert model
        found = correlated_covariance(model, here, there, at=GRID)
        assert found
        variance = np.diagonal(found.covariance, axis1=1, axis2=2)
        off = model(GRID) - right(GRID)
        hits.append(np.mean(np.abs(off) <= student.ppf(0.975, found.dof) * np.sqrt(variance)))
        stated.append(variance.sum(axis=1).mean())
        true.append((off**2).sum(axis=1).mean())
    return float(np.mean(hits)), math.sqrt(np.mean(stated) / np.mean(true))


@pytest.mark.slow
@pytest.mark.parametrize("length", [0, 30, 80, 160])
@pytest.mark.parametrize("name", ["translation", "rigid", "similarity", "affine", "homography", "polynomial2"])
def test_intervals_of_95_percent_cover_the_truth_whatever_the_correlation_length(name: str, length: float) -> None:
    """92 to 98 % of cases; the points of a grid vary together, so that 150 sets scatter by 1 to 1.5 %."""
    share, ratio = errors(model_class(name), length, 150)
    assert 0.905 < share < 0.995
    assert 1 / 1.3 < ratio < 1.7


def test_independent_errors_are_those_of_the_residuals() -> None:
    rng = np.random.default_rng(0)
    here = rng.uniform(0, SIZE, (1000, 2))
    there = TRUTH(here) + rng.normal(0, 0.3, here.shape)
    for kind in (Rigid, Affine, Polynomial2):
        model = kind.from_estimate(here, there)
        assert model
        found, plain = (
            correlated_covariance(model, here, there, at=GRID),
            prediction_covariance(model, here, there, at=GRID),
        )
        assert found
        assert isinstance(plain, np.ndarray)
        ratio = math.sqrt(np.trace(found.covariance.sum(axis=0)) / np.trace(plain.sum(axis=0)))
        assert 0.8 < ratio < 1.5


def test_shared_errors_make_a_model_less_sure_and_their_length_is_told() -> None:
    rng = np.random.default_rng(1)
    here = rng.uniform(0, SIZE, (1000, 2))
    there = TRUTH(here) + 0.3 * waves(rng, here, 80)
    model = Affine.from_estimate(here, there)
    assert model
    found, plain = (
        correlated_covariance(model, here, there, at=GRID),
        prediction_covariance(model, here, there, at=GRID),
    )
    assert found
    assert isinstance(plain, np.ndarray)
    assert np.trace(found.covariance.sum(axis=0)) > 16 * np.trace(plain.sum(axis=0))
    assert 50 < found.length < 130


def test_what_cannot_be_told_is_said() -> None:
    here = np.random.default_rng(2).uniform(0, SIZE, (3, 2))
    exact = Affine.from_estimate(here, TRUTH(here))
    assert exact
    few = correlated_covariance(exact, here, TRUTH(here), at=GRID)
    assert not few
    assert "3 places" in str(few)
    assert not correlated_covariance(exact, here[:0], here[:0], at=GRID)
    many = np.random.default_rng(3).uniform(0, SIZE, (60, 2))
    still = correlated_covariance(Affine(exact.matrix[:2]), many, Affine(exact.matrix[:2])(many), at=GRID)
    assert still
    assert np.abs(still.covariance).max() < 1e-15


def candidates_of(place: Floats, variance: Floats, weight: Floats, number: Floats, side: float) -> Floats:
    """(K, C, C) what the covariances of the cells' means may be, written out in whole arrays."""
    distance, blur = ((place[:, None] - place) ** 2).sum(axis=2), variance[:, None] + variance
    made = [np.diag(1 / weight)]
    for length in LENGTHS:
        for mixture in (((1.0, 1.0),), EXPONENTIAL):
            common = np.zeros(distance.shape)
            for share, width in mixture:
                square = (width * length * side) ** 2
                common += share * square / (square + blur) * np.exp(-0.5 * distance / (square + blur))
            np.fill_diagonal(common, 1 / number + (1 - 1 / number) * common.diagonal())
            made += [np.diag(1 / weight) + part * common for part in SHARED]
    return np.stack(made)


def whitened_by(candidates: Floats, both: Floats) -> tuple[Floats, Floats]:
    """What `featreg.geometry.correlated_kernels.whitened` fills, for candidates (K, C, C) and (C, 2, P + 1)."""
    root = np.linalg.cholesky(candidates)
    last = both.shape[2] - 1
    white = np.linalg.solve(root, both.reshape(1, len(both), -1)).reshape(len(root), -1, last + 1)
    squares = white.transpose(0, 2, 1) @ white
    information, moment = squares[:, :last, :last], squares[:, :last, last]
    left = squares[:, last, last] - (np.linalg.solve(information, moment[:, :, None])[:, :, 0] * moment).sum(axis=1)
    logs = 4 * np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1) + np.linalg.slogdet(information)[1]
    return left, logs


@pytest.mark.parametrize("kind", [Translation, Rigid, Similarity, Affine, Homography, Polynomial2])
def test_the_compiled_prediction_is_the_mixture_of_all_candidates(kind: type[Model]) -> None:
    rng = np.random.default_rng(7)
    here = rng.uniform(0, SIZE, (150, 2))
    weights = rng.uniform(0.5, 2, len(here))
    there = here + 3 + rng.normal(0, 0.5, here.shape) + 0.5 * np.sin(here / 90)
    model = kind.from_estimate(here, there, weights)
    assert model
    known = linearised(model, here, there, weights, at=GRID)
    assert known
    found = correlated_prediction(known)
    assert found

    low, side = here.min(axis=0), float(np.ptp(here, axis=0).max())
    column, row = np.minimum((here - low) / (side / 6), 5).astype(np.int64).T
    cells = [np.flatnonzero(row * 6 + column == g) for g in np.unique(row * 6 + column)]
    weight = np.array([known.weights[one].sum() for one in cells])
    number = weight**2 / [(known.weights[one] ** 2).sum() for one in cells]
    flat = np.column_stack([here, known.error, known.design.reshape(len(here), -1)])
    mean = np.stack([known.weights[one] @ flat[one] for one in cells]) / weight[:, None]
    place, error, design = mean[:, :2], mean[:, 2:4], mean[:, 4:].reshape(len(cells), 2, -1)
    variance = np.array(
        [known.weights[one] @ ((here[one] - at) ** 2).sum(axis=1) for one, at in zip(cells, place, strict=True)]
    )
    candidates = candidates_of(place, variance / weight / 2, weight, number, side)
    left, logs = whitened_by(candidates, np.concatenate([design, error[:, :, None]], axis=2))
    dof = 2 * len(cells) - design.shape[2]
    likelihood = -0.5 * (logs + dof * np.log(left / dof))
    share = np.exp(likelihood - likelihood.max())
    share[1:] /= len(share) - 1
    share /= share.sum()
    rows, each = design.reshape(-1, design.shape[2]), np.repeat(weight, 2)
    estimator = np.linalg.solve(rows.T @ (rows * each[:, None]), (rows * each[:, None]).T)
    moved = known.at @ estimator
    covariances = [moved @ np.kron(one, np.eye(2)) @ moved.transpose(0, 2, 1) for one in candidates]
    each = left / dof * np.array([np.trace(one.sum(axis=0)) for one in covariances])
    likely = share > 1e-5
    widened = _interval(each[likely] / (share @ each), share[likely] / share[likely].sum())
    wanted = np.tensordot(share * left / dof, np.stack(covariances), 1) * widened**2
    np.testing.assert_allclose(found.covariance, wanted, rtol=1e-7, atol=1e-9 * np.abs(wanted).max())
    assert found.dof == dof
    lengths = np.append(0.0, np.repeat(np.array(LENGTHS) * side, 2 * len(SHARED)))
    assert found.length == pytest.approx(float(share @ lengths), rel=1e-9)
    parts = np.append(0.0, np.tile(SHARED, 2 * len(LENGTHS)))
    assert found.sigma == pytest.approx(math.sqrt(share @ (left / dof * (1 + parts))), rel=1e-9)


@pytest.mark.parametrize("kind", [Translation, Rigid, Similarity, Affine, Homography])
def test_compiled_derivatives_are_those_of_whole_arrays(kind: type[Model]) -> None:
    rng = np.random.default_rng(8)
    here = rng.uniform(0, SIZE, (40, 2))
    there = 1.02 * here + rng.normal(0, 2, here.shape)
    model = kind.from_estimate(here, there)
    assert model
    known = linearised(model, here, there, at=GRID)
    n = normalise(here, there, None, model.minimum, spread=False)
    assert known
    assert n
    np.testing.assert_allclose(known.design, derivatives(model, here, n), rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(known.at, derivatives(model, GRID, n), rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(known.error, there - model(here), atol=1e-10)


def test_compiled_estimators_are_those_of_the_normal_equations() -> None:
    rng = np.random.default_rng(1)
    design, weight, found = rng.normal(size=(9, 2, 4)), rng.uniform(1, 5, 9), np.empty((4, 9, 2))
    assert estimators(weight, design, 1e-12, found)
    normal = np.einsum("c,cap,caq->pq", weight, design, design)
    wanted = np.linalg.solve(normal, (design * weight[:, None, None]).transpose(2, 0, 1).reshape(4, -1))
    np.testing.assert_allclose(found.reshape(4, -1), wanted, rtol=1e-9, atol=1e-12)
    design[:, :, 3] = design[:, :, 2]
    assert not estimators(weight, design, 1e-12, found)


def test_models_without_derivatives_are_fitted_anew() -> None:
    rng = np.random.default_rng(4)
    here = rng.uniform(0, SIZE, (300, 2))
    there = here + rng.normal(0, 0.3, here.shape)
    model = ResidualField.from_estimate(here, there)
    assert model
    found = prediction(model, here, there, at=GRID)
    assert found
    assert math.isnan(found.length)
    assert (np.trace(found.covariance, axis1=1, axis2=2) > 0).all()


def test_compiled_sums_are_those_of_each_group() -> None:
    rng = np.random.default_rng(6)
    here, weights = rng.uniform(10, 130, (90, 2)), rng.uniform(0.5, 2, 90)
    design, error = rng.normal(size=(90, 2, 6)), rng.normal(size=(90, 2))
    design[:, 0, 3:] = design[:, 1, :3] = 0
    low, side = here.min(axis=0), 40.0
    sums, normal, moment = np.empty((3, 3, 19)), np.zeros((9, 6, 6)), np.zeros((9, 6))
    gathered(here, error, design, weights, low, side, sums)
    column, row = np.minimum((here - low) // side, 2).astype(np.int64).T
    group = row * 3 + column
    group_normals(design, error, group, normal, moment)
    values = np.column_stack([here - low, ((here - low) ** 2).sum(axis=1), error, design.reshape(90, -1)])
    for g in range(9):
        mine = group == g
        total = sums[g // 3, g % 3]
        np.testing.assert_allclose(total[:2], [weights[mine].sum(), (weights[mine] ** 2).sum()], atol=1e-12)
        np.testing.assert_allclose(total[2:], weights[mine] @ values[mine], atol=1e-9)
        rows = design[mine].reshape(-1, 6)
        np.testing.assert_allclose(normal[g], rows.T @ rows, atol=1e-12)
        np.testing.assert_allclose(moment[g], rows.T @ error[mine].ravel(), atol=1e-12)


def _interval(variances: Floats, share: Floats) -> float:
    return interval(variances, share, 1.959964, 0.05)


def test_the_interval_of_a_mixture_holds_95_percent() -> None:
    variances, share = np.array([0.01, 1.0, 9.0, 400.0]), np.array([0.2, 0.5, 0.29, 0.01])
    width = _interval(variances, share)
    outside = share @ [math.erfc(1.959964 * width / math.sqrt(2 * v)) for v in variances]
    assert outside == pytest.approx(0.05, abs=1e-9)
    assert _interval(np.array([4.0]), np.ones(1)) == pytest.approx(2.0, abs=1e-6)
