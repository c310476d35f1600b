"""What trust measures of tie points in compiled loops: each against its plain form."""

from __future__ import annotations

import math

import numpy as np
import pytest

from featreg.geometry import Affine, Homography, Rigid, Similarity, Translation
from featreg.geometry.cells import cells
from featreg.geometry.robust import KINDS, MEDIAN_LENGTH, TUKEY, irls
from featreg.interfaces import Model
from featreg.pipeline import trust_measures as measures
from featreg.pipeline.trust_kernels import beyond
from featreg.types import FloatArray

#: Nearly a similarity, as all kinds follow to some pixels.
BENT = Homography(np.array([[0.999, 0.012, 7.3], [-0.01, 1.001, -4.6], [3e-6, -2e-6, 1.0]]))
KIND = [Translation, Rigid, Similarity, Affine, Homography]


def tie_points(count: int = 301) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(2)
    here = rng.uniform(20, 480, (count, 2))
    there = BENT(here) + rng.normal(0, 0.5, here.shape)
    there[::9] += rng.uniform(-60, 60, there[::9].shape)
    return here, there


@pytest.mark.parametrize("kind", KIND)
def test_each_half_is_judged_by_the_robust_fit_to_the_other(kind: type[Model]) -> None:
    here, there = tie_points()
    column, row = np.minimum(((here - here.min(axis=0)) / np.ptp(here, axis=0) * 4).astype(int), 3).T
    away = []
    for fitted in ((column + row) % 2 == 0, (column + row) % 2 == 1):
        model, _ = irls(kind, here[fitted], there[fitted], scale_px=measures.SCALE_PX, iterations=3)
        assert model
        away.append(model.residuals(here[~fitted], there[~fitted]))
    assert measures.held_out(kind, here, there) == pytest.approx(float(np.median(np.concatenate(away))), rel=1e-6)


@pytest.mark.parametrize("count", [0, 1, 2, 3])
@pytest.mark.parametrize("kind", KIND)
def test_halves_of_a_few_points_tell_nothing(kind: type[Model], count: int) -> None:
    here, there = tie_points()
    assert math.isnan(measures.held_out(kind, here[:count], there[:count]))
    # Nor do those of points that coincide.
    assert math.isnan(measures.held_out(kind, np.repeat(here[:count], 9, axis=0), np.repeat(there[:count], 9, axis=0)))


@pytest.mark.parametrize(("kind", "freer"), [(Translation, Affine), (Similarity, Affine), (Affine, Homography)])
def test_what_a_freer_model_does_beyond_another(kind: type[Model], freer: type[Model]) -> None:
    here, there = tie_points()
    grid = np.stack(np.meshgrid(np.linspace(0, 499, 5), np.linspace(0, 399, 5)), -1).reshape(-1, 2)
    model, _ = irls(kind, here, there, scale_px=1.0, iterations=5)
    other, wanted = irls(freer, here, there, scale_px=measures.AFFINE_SCALE_PX, iterations=3)
    assert model
    assert other
    weights, least = np.empty(len(here)), measures.AFFINE_SCALE_PX * MEDIAN_LENGTH
    found = beyond(
        KINDS[freer], freer.minimum, here, there, TUKEY / MEDIAN_LENGTH, least, 3, grid, model(grid), weights
    )
    np.testing.assert_allclose(weights, wanted, atol=1e-6)
    assert found == pytest.approx(float(np.sqrt(((other(grid) - model(grid)) ** 2).sum(axis=1).mean())), rel=1e-5)
    few = here[: freer.minimum - 1]
    nothing = beyond(KINDS[freer], freer.minimum, few, few, 4.0, least, 3, grid, model(grid), weights[: len(few)])
    assert nothing < 0


@pytest.mark.parametrize("far", [1.0, 1e11])
def test_distinct_moves_are_counted_however_far_they_go(far: float) -> None:
    here, there = (np.round(xy / 40) * 40 for xy in tie_points())
    there[0] = -far, far
    numbers = [cells(xy, measures.DISTINCT_PX) for xy in (here, there)]
    wanted = *(len(np.unique(one)) for one in numbers), len(np.unique(np.column_stack(numbers), axis=0))
    assert measures._counted(here, there) == wanted
    assert wanted[2] < len(here)
    assert measures._counted(here[:0], there[:0]) == (0, 0, 0)
    values = np.random.default_rng(0).normal(size=37)
    for share in (0.0, 0.5, 0.95, 1.0):
        assert measures._quantile(values, share) == pytest.approx(np.quantile(values, share), abs=1e-12)
