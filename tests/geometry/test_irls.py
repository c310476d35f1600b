"""Iteratively reweighted least squares."""

from __future__ import annotations

import numpy as np
import pytest

from featreg.errors import ParameterError
from featreg.geometry import Affine, Homography, Translation
from featreg.geometry.homography import plain_reprojection_minimum
from featreg.geometry.robust import KINDS, TUKEY, irls, plain_irls
from featreg.interfaces import FailedFit, Model
from made.outliers import CORNERS, MODELS, every_model, mixed


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
