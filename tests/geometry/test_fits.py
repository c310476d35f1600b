"""Fits against oracles: least squares by other means, other libraries, brute force."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.geometry import (
    Affine,
    Homography,
    Polynomial2,
    Polynomial3,
    Rigid,
    Similarity,
)
from featreg.interfaces import Model
from made.models import fitted, scattered


def test_fit_is_the_least_squares_optimum(cls: type[Model], example: Model) -> None:
    """No small change of any parameter lowers the weighted sum of squares."""
    rng = np.random.default_rng(5)
    xy, weights = scattered(30), rng.uniform(0.1, 5, 30)
    noisy = example(xy) + rng.normal(0, 3, xy.shape)
    best = fitted(cls, xy, noisy, weights)

    def cost(parameters: dict[str, Any]) -> float:
        return float(weights @ cls(**parameters).residuals(xy, noisy) ** 2)

    lowest = cost(dict(best.parameters))
    fixed = {"centre", "scale"} if isinstance(best, Polynomial2 | Polynomial3) else set()
    for name, value in best.parameters.items():
        if name in fixed:
            continue
        flat = np.array(value, float)
        for i in range(flat.size):
            for sign in (-1, 1):
                changed = flat.copy()
                changed.flat[i] += sign * 1e-6 * max(abs(changed.flat[i]), 1e-6)
                given = changed.tolist() if flat.ndim else float(changed)
                assert cost({**best.parameters, name: given}) >= lowest * (1 - 1e-12)


def test_weights_count_like_repeated_points(cls: type[Model], example: Model) -> None:
    rng = np.random.default_rng(2)
    xy = scattered(30)
    noisy = example(xy) + rng.normal(0, 1, xy.shape)
    times = rng.integers(0, 4, 30)
    weighted = fitted(cls, xy, noisy, times.astype(float))
    repeated = fitted(cls, np.repeat(xy, times, axis=0), np.repeat(noisy, times, axis=0))
    np.testing.assert_allclose(weighted(xy), repeated(xy), atol=1e-6)
    np.testing.assert_allclose(fitted(cls, xy, noisy, np.full(30, 1e-200))(xy), fitted(cls, xy, noisy)(xy), atol=1e-9)


def test_rigid_agrees_with_kabsch_and_brute_force() -> None:
    rng = np.random.default_rng(3)
    xy, weights = scattered(25), rng.uniform(0.2, 3, 25)
    noisy = Rigid(20.0, 5, 6)(xy) * 1.05 + rng.normal(0, 4, xy.shape)
    model = Rigid.from_estimate(xy, noisy, weights)
    assert model
    # Kabsch: the rotation from the singular vectors of the cross-covariance.
    centre, target = (np.average(p, axis=0, weights=weights) for p in (xy, noisy))
    left, _, right = np.linalg.svd(((xy - centre) * weights[:, None]).T @ (noisy - target))
    kabsch = (left @ np.diag([1.0, np.linalg.det(left @ right)]) @ right).T
    np.testing.assert_allclose(model.matrix[:2, :2], kabsch, atol=1e-12)
    np.testing.assert_allclose(model.shift_at(centre), target - centre, atol=1e-9)
    # Brute force over the angle, the best shift of each angle being known.
    angles = np.arange(-180, 180, 0.01)
    costs = []
    for angle in angles:
        turned = Rigid(angle)(xy)
        r = noisy - turned - np.average(noisy - turned, axis=0, weights=weights)
        costs.append(weights @ (r * r).sum(axis=1))
    assert model.rotation_deg == pytest.approx(angles[np.argmin(costs)], abs=0.0051)


@pytest.mark.parametrize(
    ("cls", "name"), [(Similarity, "Similarity"), (Affine, "Affine"), (Homography, "Projective"), (Rigid, "Euclidean")]
)
def test_scikit_image_finds_the_same(cls: type[Model], example: Model, name: str) -> None:
    transform = pytest.importorskip("skimage.transform")
    oracle: Any = getattr(transform, f"{name}Transform")
    xy = scattered(60)
    # The oracle's affine and homography are algebraic minima, which are ours on exact points only.
    noise = 2.0 if cls in (Rigid, Similarity) else 0.0
    noisy = example(xy) + np.random.default_rng(1).normal(0, noise, xy.shape)
    theirs = oracle.from_estimate(xy, noisy) if hasattr(oracle, "from_estimate") else oracle()
    if not hasattr(oracle, "from_estimate"):
        assert theirs.estimate(xy, noisy)
    np.testing.assert_allclose(fitted(cls, xy, noisy)(xy), theirs(xy), atol=1e-7)


def test_affine_is_plain_weighted_least_squares() -> None:
    rng = np.random.default_rng(4)
    xy, weights = scattered(60), rng.uniform(0.1, 3, 60)
    noisy = Affine(np.array([[1.03, 0.07, 12.0], [-0.05, 0.97, -30.0]]))(xy) + rng.normal(0, 2, xy.shape)
    root = np.sqrt(weights)[:, None]
    oracle = np.linalg.lstsq(root * np.column_stack([xy, np.ones(60)]), root * noisy, rcond=None)[0].T
    model = Affine.from_estimate(xy, noisy, weights)
    assert model
    np.testing.assert_allclose(model.coefficients, oracle, atol=1e-9)


def test_homography_beats_the_algebraic_minimum() -> None:
    transform: Any = pytest.importorskip("skimage.transform")
    xy = scattered(40)
    true = Homography(np.array([[1.02, 0.05, 5.0], [-0.04, 0.99, 8.0], [2e-5, -3e-5, 1.0]]))
    noisy = true(xy) + np.random.default_rng(1).normal(0, 2, xy.shape)
    if not hasattr(transform.ProjectiveTransform, "from_estimate"):
        pytest.skip("this scikit-image has no from_estimate")
    theirs: NDArray[np.float64] = transform.ProjectiveTransform.from_estimate(xy, noisy)(xy)
    ours = fitted(Homography, xy, noisy).residuals(xy, noisy)
    assert (ours**2).sum() <= ((theirs - noisy) ** 2).sum()


@pytest.mark.parametrize("thin", [1.0, 0.2, 0.05, 1e-3])
def test_an_affine_fit_is_the_orthogonal_one(thin: float) -> None:
    """By normal equations where the points are well spread, by orthogonal steps where they are not."""
    rng = np.random.default_rng(4)
    here = rng.uniform(0, 600, (50, 2)) * (1.0, thin) + (3000.0, 1000.0)
    there = here @ np.array([[1.02, 0.1], [-0.12, 0.97]]) + (7.0, -3.0) + rng.normal(0, 0.3, here.shape)
    weights = rng.uniform(0.1, 3, 50)
    found = Affine.from_estimate(here, there, weights)
    assert found
    root = np.sqrt(weights)[:, None]
    centre = here.mean(axis=0)
    rows = np.column_stack([here - centre, np.ones(50)])
    wanted = np.linalg.lstsq(root * rows, root * there, rcond=None)[0]
    np.testing.assert_allclose(found(here), rows @ wanted, atol=1e-8)
