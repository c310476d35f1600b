"""The compiled search of a consensus against plain numpy."""

from __future__ import annotations

import numpy as np
import pytest

from featreg.geometry import Affine, Homography
from featreg.geometry.robust import draw_samples
from featreg.types import BoolArray, FloatArray
from made.outliers import MODELS, mixed


def test_samples_are_uniform_and_without_repetition() -> None:
    drawn = draw_samples(np.random.default_rng(0), 5, 3, 60_000)
    assert all(len(set(row)) == 3 for row in drawn[:500].tolist())
    assert (np.sort(drawn, axis=1)[:, :-1] != np.sort(drawn, axis=1)[:, 1:]).all()
    counts = np.unique(drawn @ (25, 5, 1), return_counts=True)[1]
    assert len(counts) == 5 * 4 * 3
    assert abs(counts / 1000 - 1).max() < 0.15


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


# The filters.


def test_samples_are_those_of_numbers_drawn_one_after_the_other() -> None:
    drawn = draw_samples(np.random.default_rng(2), 7, 4, 500)
    ranks = np.random.default_rng(2).integers(0, 7 - np.arange(4), (500, 4))
    for numbers, rank in zip(drawn.tolist(), ranks.tolist(), strict=True):
        left = list(range(7))
        assert numbers == [left.pop(r) for r in rank]
