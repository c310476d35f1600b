"""Sample consensus, reweighted least squares, and the filters fsc and ransac."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError, ParameterError
from featreg.geometry import Affine, Homography, Polynomial2, Polynomial3, Rigid, Similarity, Translation
from featreg.geometry.homography import plain_reprojection_minimum
from featreg.geometry.robust import KINDS, TUKEY, draw_samples, fit_consensus, irls, plain_irls
from featreg.interfaces import FailedFit, FilterContext, Model
from featreg.registry import create
from featreg.types import BoolArray, FloatArray, Matches

SIZE = 1000.0
BENT = np.zeros((2, 10))
BENT[0] = [512.3, 498.0, 20.0, 6.0, -4.0, 3.0, 1.5, -2.0, 0.7, 0.9]
BENT[1] = [470.1, -18.0, 505.0, -3.0, 5.0, 2.0, -0.8, 1.1, 1.9, -1.4]
MODELS: list[Model] = [
    Translation(12.25, -7.5),
    Rigid(24.37, 25.4, 317.3),
    Similarity(31.7, 1.13, -260.0, 180.0),
    Affine(np.array([[1.03, 0.07, 12.0], [-0.05, 0.97, 30.0]])),
    Homography(np.array([[1.02, 0.05, 5.0], [-0.04, 0.99, 8.0], [2e-5, -3e-5, 1.0]])),
    Polynomial2(BENT[:, :6], (500.0, 480.0), 500.0),
    Polynomial3(BENT, (500.0, 480.0), 500.0),
]
every_model = pytest.mark.parametrize("model", MODELS, ids=[type(m).__name__ for m in MODELS])
CORNERS = np.array([[0, 0], [SIZE, 0], [0, SIZE], [SIZE, SIZE]])


def mixed(
    model: Model, share: float, *, count: int = 2000, noise: float = 0.5, seed: int = 0
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """`share` of the pairs follow the model, the others join arbitrary points of the two images."""
    rng = np.random.default_rng(seed)
    reference = rng.uniform(0, SIZE, (count, 2))
    secondary = model(reference) + rng.normal(0, noise, (count, 2))
    good = rng.permutation(count) < round(share * count)
    low, high = (edge(secondary, axis=0, initial=SIZE / 2) for edge in (np.min, np.max))
    secondary[~good] = rng.uniform(low, high, ((~good).sum(), 2))
    return reference, secondary, good


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


def test_samples_are_uniform_and_without_repetition() -> None:
    drawn = draw_samples(np.random.default_rng(0), 5, 3, 60_000)
    assert all(len(set(row)) == 3 for row in drawn[:500].tolist())
    assert (np.sort(drawn, axis=1)[:, :-1] != np.sort(drawn, axis=1)[:, 1:]).all()
    counts = np.unique(drawn @ (25, 5, 1), return_counts=True)[1]
    assert len(counts) == 5 * 4 * 3
    assert abs(counts / 1000 - 1).max() < 0.15


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


# The compiled search against plain numpy.


def vectors(reference: FloatArray, secondary: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    x, y, u, v = (np.ascontiguousarray(c) for c in (*reference.T, *secondary.T))
    return x, y, u, v


def test_kernel_cost_and_inliers() -> None:
    from featreg.geometry.robust_kernels import OUTLIER, mark_inliers, truncated_cost

    for model in (MODELS[3], MODELS[4]):
        reference, secondary, _ = mixed(model, 0.3, noise=1.5)
        x, y, u, v = vectors(reference, secondary)
        p = np.asarray(model.matrix).reshape(-1).copy()
        ratio = (model.residuals(reference, secondary) / 3.0) ** 2
        expected = np.floor(np.minimum(ratio, 1.0) * OUTLIER).sum()
        cost = truncated_cost(p, isinstance(model, Homography), x, y, u, v, 1 / 9)
        assert abs(cost - expected) <= 3  # a point whose cost is a whole number may round either way
        inlier = np.empty(len(reference))
        mark_inliers(p, x, y, u, v, 1 / 9, inlier)
        np.testing.assert_array_equal(inlier, (ratio < 1).astype(float))


@pytest.mark.parametrize("kind", range(4))
@pytest.mark.parametrize("count", [0, 40])
def test_kernel_least_squares(kind: int, count: int) -> None:
    """On a minimal set and on many weighted points the kernel gives what the model's own fit gives."""
    from featreg.geometry.robust_kernels import least_squares

    cls = type(MODELS[kind])
    count = max(count, cls.minimum)
    rng = np.random.default_rng(kind)
    reference = rng.uniform(-500, 500, (count, 2))
    secondary = MODELS[kind](reference) + rng.normal(0, 2, reference.shape)
    weights = np.where(rng.random(count) < 0.7, 1.0, 0.0) if count > 4 else np.ones(count)
    p = np.empty(9)
    x, y, u, v = vectors(reference, secondary)
    assert least_squares(kind, x, y, u, v, weights, p)
    oracle = cls.from_estimate(reference, secondary, weights)
    assert oracle
    np.testing.assert_allclose(p.reshape(3, 3), np.asarray(oracle.matrix), atol=1e-8)


def test_kernel_refuses_samples_that_determine_nothing() -> None:
    from featreg.geometry.robust_kernels import homography_of_four, least_squares, well_placed

    line, p = np.array([0.0, 1.0, 2.0]), np.empty(9)
    assert not least_squares(3, line, line, line, line, np.ones(3), p)
    assert not least_squares(1, np.zeros(2), np.zeros(2), line[:2], line[:2], np.ones(2), p)
    assert not least_squares(0, line, line, line, line, np.zeros(3), p)
    four = np.array([0.0, 1.0, 2.0, 5.0])
    assert not homography_of_four(four, four, four, four, p)
    assert not homography_of_four(np.zeros(4), np.zeros(4), four, four, p)
    square = np.array([0.0, 100.0, 100.0, 0.0]), np.array([0.0, 0.0, 100.0, 100.0])
    assert well_placed(*square, 4, 10.0)
    assert not well_placed(*square, 4, 110.0)
    assert not well_placed(line * 100, line * 100, 3, 10.0)


def test_kernel_homography() -> None:
    from featreg.geometry.robust_kernels import homography_of_four

    xy = np.array([[-400, -300], [450, -350], [380, 420], [-410, 390.0]])
    target, p = MODELS[4](xy), np.empty(9)
    x, y, u, v = vectors(xy, target)
    assert homography_of_four(x, y, u, v, p)
    np.testing.assert_allclose(Homography(p.reshape(3, 3))(xy), target, atol=1e-9)
    oracle = Homography.from_estimate(xy, target)
    assert oracle
    np.testing.assert_allclose(p.reshape(3, 3), oracle.coefficients, atol=1e-8)


def test_search_equals_the_plain_one() -> None:
    """Hypothesis by hypothesis in numpy: the same winner, the same number of hypotheses."""
    from featreg.geometry.robust_kernels import OUTLIER, search

    reference, secondary, _ = mixed(MODELS[3], 0.3, count=300, seed=4)
    reference, secondary = reference - reference.mean(axis=0), secondary - secondary.mean(axis=0)
    samples = draw_samples(np.random.default_rng(1), 300, 3, 400)
    rows = np.arange(300)
    best = np.zeros(9)
    flat = np.ascontiguousarray(np.concatenate([reference.T, secondary.T]))
    counted = np.empty(2, np.int64)
    search(3, flat, samples, rows, 3.0, np.zeros(2), 0.999, best, counted)
    cost, looked = counted.tolist()

    def judged(model: Affine) -> tuple[float, BoolArray]:
        ratio = (model.residuals(reference, secondary) / 3.0) ** 2
        return float(np.floor(np.minimum(ratio, 1) * OUTLIER).sum()), ratio < 1

    lowest, winner, tried, enough = 300.0 * OUTLIER, None, 0, 400.0
    for sample in samples:
        if tried >= enough:
            break
        tried += 1
        trial = Affine.from_estimate(reference[sample], secondary[sample])
        rounds = 5
        while trial and rounds:
            value, inliers = judged(trial)
            if value >= lowest:
                break
            lowest, winner, rounds = value, trial, rounds - 1
            clean = inliers.mean() ** 3
            enough = np.log(0.001) / np.log1p(-clean)
            trial = Affine.from_estimate(reference[inliers], secondary[inliers])
    assert winner is not None
    assert looked == tried
    assert abs(cost - lowest) <= 2
    np.testing.assert_allclose(best.reshape(3, 3), winner.matrix, atol=1e-8)


# Iteratively reweighted least squares.


@every_model
def test_irls_ignores_a_tenth_of_gross_errors(model: Model) -> None:
    reference, secondary, good = mixed(model, 1.0, count=400, noise=0.5)
    rng = np.random.default_rng(1)
    secondary = secondary.copy()
    secondary[:40] += rng.uniform(20, 60, (40, 2))
    good[:40] = False
    found, weights = irls(type(model), reference, secondary, scale_px=0.05)
    assert found
    assert weights[~good].max() == 0.0
    assert np.median(weights[good]) > 0.8
    best = type(model).from_estimate(reference[good], secondary[good])
    assert best
    assert np.sqrt(np.mean(found.residuals(reference, best(reference)) ** 2)) < 0.1


def test_irls_keeps_its_efficiency() -> None:
    """On clean Gaussian errors Tukey's constant costs 5 % of the points."""
    plain, robust = [], []
    for seed in range(600):
        reference, secondary, _ = mixed(MODELS[0], 1.0, count=60, noise=1.0, seed=seed)
        least = Translation.from_estimate(reference, secondary)
        found, _ = irls(Translation, reference, secondary, scale_px=0.01)
        assert least
        assert found
        plain.append((least.dx - 12.25) ** 2 + (least.dy + 7.5) ** 2)
        robust.append((found.dx - 12.25) ** 2 + (found.dy + 7.5) ** 2)
    assert pytest.approx(5.123) == TUKEY
    assert np.mean(plain) / np.mean(robust) == pytest.approx(0.95, abs=0.04)


@pytest.mark.parametrize("model", [m for m in MODELS if type(m) in KINDS], ids=lambda m: type(m).__name__)
@pytest.mark.parametrize("count", [9, 400, 401])
def test_irls_compiled_rounds_are_the_plain_ones(model: Model, count: int) -> None:
    reference, secondary, _ = mixed(model, 0.9, count=count, noise=0.5, seed=count)
    rng = np.random.default_rng(count)
    kind = type(model)
    close = 1e-6 if kind is Homography else 1e-9
    for prior in (np.ones(count), rng.uniform(0, 1, count) * (rng.random(count) > 0.2)):
        ours, weights = irls(kind, reference, secondary, weights=prior, scale_px=0.05, iterations=6)
        plain, wanted = plain_irls(kind, reference, secondary, prior, 0.05, 6)
        assert bool(ours) is bool(plain)
        np.testing.assert_allclose(weights, wanted, atol=close)
        if ours and plain:
            np.testing.assert_allclose(ours(CORNERS), plain(CORNERS), atol=close)


def test_homography_steps_find_the_minimum_of_the_orthogonal_factors() -> None:
    from featreg.geometry.base import normalise
    from featreg.geometry.homography import _direct_linear, _reprojection_minimum

    reference, secondary, _ = mixed(MODELS[4], 1.0, count=300, noise=1.0)
    n = normalise(reference, secondary, np.linspace(0.1, 2, 300), 4)
    assert not isinstance(n, FailedFit)
    start = _direct_linear(n)
    assert not isinstance(start, FailedFit)
    np.testing.assert_allclose(_reprojection_minimum(start, n), plain_reprojection_minimum(start, n), atol=1e-9)


def test_irls_scale_floor_and_priors() -> None:
    reference, secondary, _ = mixed(MODELS[3], 1.0, count=50, noise=0.0)
    found, weights = irls(Affine, reference, secondary, scale_px=0.1)
    assert found
    np.testing.assert_allclose(weights, 1.0)
    prior = np.linspace(0, 2, 50)
    found, weights = irls(Affine, reference, secondary, weights=prior, scale_px=0.1)
    np.testing.assert_allclose(weights, prior)
    failed, weights = irls(Affine, reference[:2], secondary[:2])
    assert isinstance(failed, FailedFit)
    assert not weights.any()
    failed, _ = irls(Affine, reference, secondary, weights=np.zeros(50))
    assert isinstance(failed, FailedFit)
    with pytest.raises(ParameterError):
        irls(Affine, reference, secondary, scale_px=0.0)


# The filters.


def context(model: type[Model], seed: int = 0) -> FilterContext:
    size = (int(SIZE), int(SIZE))
    return FilterContext(size, size, model, np.random.default_rng(seed))


def scored(share: float, share_in_top: float, seed: int, model: Model = MODELS[3]) -> tuple[Matches, BoolArray]:
    """2000 matches of which `share` are good, and of the best-scored 30 % `share_in_top`."""
    reference, secondary, good = mixed(model, share, seed=seed)
    rng = np.random.default_rng(seed + 500)
    top_good = round(share_in_top * 600)
    first = np.r_[
        rng.permutation(np.flatnonzero(good))[:top_good], rng.permutation(np.flatnonzero(~good))[: 600 - top_good]
    ]
    score = rng.uniform(0, 1, 2000)
    score[first] += 1
    return Matches(reference, secondary, score), good


def test_fsc_at_85_percent_of_outliers() -> None:
    for seed in range(40):
        matches, good = scored(0.15, 0.4, seed)
        kept = create("filter", "fsc").keep(matches, context(Affine, seed))
        assert kept[good].mean() > 0.98, seed
        assert kept[~good].mean() < 0.01


def test_fsc_draws_from_the_confident_ones() -> None:
    """With few hypotheses the scores decide: good where they are informative, lost where they are not."""
    few = create("filter", "fsc", iterations=40)
    blind = create("filter", "fsc", iterations=40, share=1.0)
    informed = uninformed = 0
    for seed in range(30):
        matches, good = scored(0.15, 0.45, seed)
        informed += few.keep(matches, context(Affine, seed))[good].mean() > 0.9
        uninformed += blind.keep(matches, context(Affine, seed))[good].mean() > 0.9
    assert informed >= 25
    assert uninformed <= 12


def test_fsc_with_scores_that_say_nothing_draws_from_all() -> None:
    reference, secondary, good = mixed(MODELS[2], 0.4)
    kept = create("filter", "fsc").keep(Matches(reference, secondary, 1.0), context(Similarity))
    np.testing.assert_array_equal(
        kept, fit_consensus(Similarity, reference, secondary, threshold=3.0, rng=np.random.default_rng(0))[1]
    )
    assert kept[good].mean() > 0.99


ESTIMATORS = {
    "similarity": ["ransac", "lmeds"],
    "affine": ["ransac", "lmeds", "usac-default", "usac-fast", "usac-accurate", "usac-magsac"],
    "homography": ["ransac", "lmeds", "rho", "usac-default", "usac-fast", "usac-accurate", "usac-magsac"],
}


@pytest.mark.parametrize(("name", "estimator"), [(n, e) for n, es in ESTIMATORS.items() for e in es])
def test_opencv_estimators(name: str, estimator: str) -> None:
    model = {"similarity": MODELS[2], "affine": MODELS[3], "homography": MODELS[4]}[name]
    reference, secondary, good = mixed(model, 0.7)
    # Far from the origin single precision would lose hundredths of a pixel.
    matches = Matches(reference + 30_000, secondary + 30_000, np.ones(2000))
    kept = create("filter", "ransac", estimator=estimator).keep(matches, context(type(model)))
    assert kept.dtype == np.bool_
    assert kept[good].mean() > 0.9
    assert kept[~good].mean() < 0.02
    again = create("filter", "ransac", estimator=estimator).keep(matches, context(type(model), 99))
    np.testing.assert_array_equal(kept, again)


@pytest.mark.parametrize("estimator", ["own", "ransac", "lmeds", "usac-accurate", "usac-magsac"])
def test_ransac_on_few_matches(estimator: str) -> None:
    filter_ = create("filter", "ransac", estimator=estimator)
    for count in range(6):
        matches = Matches(*mixed(MODELS[3], 0.5, count=count)[:2], np.ones(count))
        kept = filter_.keep(matches, context(Affine))
        assert kept.shape == (count,)
        assert kept.dtype == np.bool_
    assert not filter_.keep(Matches(np.ones((9, 2)), np.ones((9, 2)), np.ones(9)), context(Affine)).any()


def test_estimator_that_opencv_lacks_for_the_model_is_named() -> None:
    matches = Matches(*mixed(MODELS[2], 0.7)[:2], np.ones(2000))
    magsac = create("filter", "ransac", estimator="usac-magsac")
    with pytest.raises(ParameterError, match=r"'usac-magsac' for the model 'similarity'.*'own' or 'ransac' or 'lmeds'"):
        magsac.keep(matches, context(Similarity))
    for model in (Translation, Rigid, Polynomial2):
        with pytest.raises(ParameterError, match="use 'own'"):
            magsac.keep(matches, context(model))
    with pytest.raises(ParameterError, match=r"'own', .* or 'usac-magsac', got 'usac-magsack'"):
        create("filter", "ransac", estimator="usac-magsack")


@pytest.mark.parametrize("name", ["fsc", "ransac"])
def test_filter_conduct(name: str) -> None:
    filter_ = create("filter", name)
    for value in ({"threshold": 0.0}, {"iterations": 0}, {"confidence": 1.0}):
        with pytest.raises(ParameterError):
            create("filter", name, **value)
    if name == "fsc":
        with pytest.raises(ParameterError):
            create("filter", name, share=0.0)
    assert inspect.getdoc(filter_)
    for model in MODELS:
        kept = filter_.keep(Matches.empty(), context(type(model)))
        assert kept.shape == (0,)
        assert kept.dtype == np.bool_
        matches, _ = scored(0.3, 0.6, 1, model)
        first, second = (filter_.keep(matches, context(type(model), 5)) for _ in range(2))
        assert first.sum() > 400
        np.testing.assert_array_equal(first, second)


def test_samples_are_those_of_numbers_drawn_one_after_the_other() -> None:
    drawn = draw_samples(np.random.default_rng(2), 7, 4, 500)
    ranks = np.random.default_rng(2).integers(0, 7 - np.arange(4), (500, 4))
    for numbers, rank in zip(drawn.tolist(), ranks.tolist(), strict=True):
        left = list(range(7))
        assert numbers == [left.pop(r) for r in rank]
