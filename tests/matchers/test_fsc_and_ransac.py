"""The filters fsc and ransac."""

from __future__ import annotations

import inspect

import numpy as np
import pytest

from featreg.errors import ParameterError
from featreg.geometry import Affine, Polynomial2, Rigid, Similarity, Translation
from featreg.geometry.robust import fit_consensus
from featreg.interfaces import FilterContext, Model
from featreg.registry import create
from featreg.types import BoolArray, Matches
from made.outliers import MODELS, SIZE, mixed


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
