"""The adjustment of a network of pairs: exact pairs, a wrong one named, weights, loops, jumps."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import featreg
from featreg.errors import ParameterError
from featreg.geometry import Affine, ResidualField, Rigid, Translation
from featreg.io.raster_source import ImageSource
from featreg.stacks.closure import closure_of, loops
from featreg.stacks.ground import SharedGround
from featreg.stacks.jumps import jumps
from featreg.stacks.network import adjust
from featreg.stacks.pairs import StackPair, planned
from featreg.stacks.run import _why as left_out_because
from featreg.types import FloatArray, Geolocation

SHAPE = (300, 400)
X, Y = np.meshgrid(np.linspace(40, 360, 5), np.linspace(30, 270, 5))
NODES = np.column_stack([X.ravel(), Y.ravel()])


def truths(count: int, seed: int) -> list[Affine]:
    rng = np.random.default_rng(seed)
    made = [Affine(np.eye(3)[:2])]
    for _ in range(count - 1):
        linear = np.eye(2) + rng.normal(0, 1e-3, (2, 2))
        made.append(Affine(np.column_stack([linear, rng.normal(0, 3, 2)])))
    return made


def pair(models: list[Affine], i: int, k: int, shift: Any = (0.0, 0.0), sigma: float = 0.05) -> StackPair:
    matrix = models[k].matrix @ np.linalg.inv(models[i].matrix)
    matrix[:2, 2] += shift
    covariance = np.tile(sigma**2 * np.eye(2), (len(NODES), 1, 1))
    return StackPair(i, k, "ok", "", Affine(matrix[:2]), NODES, covariance)


def rigid(here: FloatArray, there: FloatArray) -> Rigid:
    made = Rigid.from_estimate(here, there)
    assert isinstance(made, Rigid)
    return made


def error(model: Any, truth: Affine) -> float:
    return float(np.abs(model(NODES) - truth(NODES)).max())


def test_pairs_without_errors_give_the_models() -> None:
    models = truths(7, 0)
    made = adjust([pair(models, i, k) for i, k in planned(7, 2, None)], 7, 2, SHAPE, Affine)
    to_reference = np.linalg.inv(models[2].matrix)
    for found, truth in zip(made.models, models, strict=True):
        assert found is not None
        assert error(found, Affine((truth.matrix @ to_reference)[:2])) < 1e-6
    assert all(p.weight > 0.99 for p in made.pairs)


def test_residual_fields_are_followed_and_good_pairs_kept() -> None:
    bends = np.random.default_rng(4).normal(0, 1, (5, 2))
    bends[0] = 0
    grid = np.stack(np.meshgrid(np.linspace(0, 399, 30), np.linspace(0, 299, 24)), -1).reshape(-1, 2)

    def at(image: int, xy: FloatArray) -> FloatArray:
        # Waves that no polynomial of low degree follows, another for each image.
        x, y = xy.T / 60
        return np.asarray(xy + np.column_stack([np.sin(x) * np.cos(y), np.cos(x + y)]) * bends[image])

    def between(i: int, k: int) -> ResidualField:
        made = ResidualField.from_estimate(at(i, grid), at(k, grid))
        assert isinstance(made, ResidualField)
        return made

    covariance = np.tile(0.05**2 * np.eye(2), (len(NODES), 1, 1))
    pairs = [StackPair(i, k, "ok", "", between(i, k), NODES, covariance) for i, k in planned(5, 0, 2)]
    made = adjust(pairs, 5, 0, SHAPE, ResidualField)
    assert all(pair.used for pair in made.pairs)
    for image, model in enumerate(made.models):
        assert model is not None
        assert np.abs(model(NODES) - at(image, NODES)).max() < 0.1


def test_a_pair_wrong_by_three_pixels_is_named_and_does_no_harm() -> None:
    models = truths(8, 1)
    rng = np.random.default_rng(2)
    chosen = planned(8, 0, None)
    for wrong in chosen:
        noisy = [pair(models, i, k, rng.normal(0, 0.05, 2)) for i, k in chosen]
        at = chosen.index(wrong)
        noisy[at] = pair(models, *wrong, (3.0, 0.0))
        made = adjust(noisy, 8, 0, SHAPE, Affine)
        assert [(p.first, p.second) for p in made.pairs if not p.used] == [wrong]
        assert 2.5 < made.pairs[at].misfit < 3.5
        for found, truth in zip(made.models, models, strict=True):
            assert found is not None
            assert error(found, truth) < 0.25


def test_pairs_that_nothing_joins_to_the_reference_are_not_called_wrong() -> None:
    models = truths(5, 3)
    made = adjust([pair(models, i, k) for i, k in [(0, 1), (1, 2), (0, 2), (3, 4)]], 5, 0, SHAPE, Affine)
    assert [model is None for model in made.models] == [False, False, False, True, True]
    apart = made.pairs[3]
    assert apart.used
    assert apart.weight == 1.0
    assert np.isnan(apart.misfit)
    assert "left out as well" in left_out_because(made.pairs, 3)
    assert "can be trusted" in left_out_because([replace(apart, status="unreliable", model=None)], 3)
    assert "agrees with the others (by 3.0 px)" in left_out_because([replace(apart, weight=0.0, misfit=3.0)], 3)


def test_pairs_that_share_no_ground_are_passed_over() -> None:
    # Two tracks, image by image: 0, 2, 4 and 1, 3, 5.
    shared = {(i, k): float((i - k) % 2 == 0) for i in range(6) for k in range(6)}
    assert planned(6, 0, None, lambda i, k: shared[i, k]) == [(0, 2), (0, 4), (1, 3), (1, 5), (2, 4), (3, 5)]
    assert planned(6, 0, 1, lambda i, k: shared[i, k]) == [(0, 2), (1, 3), (2, 4), (3, 5)]
    assert planned(6, 0, "chain", lambda i, k: shared[i, k]) == [(i, i + 1) for i in range(5)]
    assert planned(4, 0, "all", lambda i, k: None) == planned(4, 0, "all")


def test_the_share_of_the_ground_is_that_of_the_smaller_image() -> None:
    def image(left: float, side: int) -> ImageSource:
        place = Geolocation((10.0, 0.0, left, 0.0, -10.0, 4_000_000.0), "EPSG:32633")
        noise = np.random.default_rng(0).gamma(1, 1, (side, side))
        return ImageSource(replace(featreg.as_image(noise), geolocation=place))

    whole, half, apart = image(500_000, 90), image(500_450, 45), image(503_000, 90)
    bare = ImageSource(featreg.as_image(np.random.default_rng(0).gamma(1, 1, (90, 90))))
    shared = SharedGround([whole, half, apart, bare])
    assert shared(0, 1) == shared(1, 0) == 1.0
    assert shared(0, 2) == 0.0
    assert shared(0, 3) is None


def test_the_network_is_better_than_direct_pairs_where_errors_are_independent() -> None:
    direct, together = [], []
    chosen = planned(10, 0, None)
    for seed in range(20):
        models = truths(10, seed)
        rng = np.random.default_rng([seed, 5])
        noisy = [pair(models, i, k, rng.normal(0, 0.1, 2), 0.1) for i, k in chosen]
        made = adjust(noisy, 10, 0, SHAPE, Translation)
        for i in range(1, 10):
            alone = next(p for p in noisy if (p.first, p.second) == (0, i)).model
            found = made.models[i]
            assert alone is not None
            assert found is not None
            direct.append(error(alone, models[i]))
            together.append(error(found, models[i]))
        assert 0.4 < made.unit < 2.0
    assert np.mean(np.square(together)) < 0.75 * np.mean(np.square(direct))


def test_a_worse_pair_counts_less() -> None:
    models = truths(3, 3)
    good = [pair(models, 0, 1), pair(models, 1, 2), pair(models, 0, 2, (0.3, 0.0), sigma=1.0)]
    found = adjust(good, 3, 0, SHAPE, Affine).models[2]
    assert found is not None
    assert error(found, models[2]) < 0.01


def test_standard_errors_cover_what_all_pairs_of_an_image_share() -> None:
    """Errors of images close in every loop: the network sees none, and the errors must not shrink."""
    ratios = []
    for seed in range(10):
        models = truths(8, seed)
        own = np.random.default_rng([seed, 9]).normal(0, 0.1, (8, 2))
        noisy = [pair(models, i, k, own[k] - own[i], 0.1 * np.sqrt(2)) for i, k in planned(8, 0, None)]
        made = adjust(noisy, 8, 0, SHAPE, Translation)
        for i in range(1, 8):
            found = made.models[i]
            assert found is not None
            ratios.append(((found(NODES) - models[i](NODES)) ** 2).mean() / made.standard_errors[i] ** 2)
    assert 0.5 < np.mean(ratios) < 1.5


def test_models_stay_of_their_kind() -> None:
    angles = [0.0, 1.0, -2.0, 0.5]
    models = [Affine(Rigid(angle, 2.0 * i, -i).matrix[:2]) for i, angle in enumerate(angles)]
    models[0] = Affine(np.eye(3)[:2])
    pairs = [
        replace(pair(models, i, k), model=rigid(NODES, models[k](models[i].inverse(NODES))))
        for i, k in planned(4, 0, None)
    ]
    made = adjust(pairs, 4, 0, SHAPE, Rigid)
    assert all(isinstance(model, Rigid) for model in made.models[1:])
    assert [round(m.rotation_deg, 6) for m in made.models[1:] if isinstance(m, Rigid)] == angles[1:]


def test_what_no_pair_leads_to_has_no_model() -> None:
    models = truths(5, 4)
    pairs = [pair(models, i, k) for i, k in planned(5, 0, "chain")]
    pairs[2] = replace(pairs[2], model=None, status="unreliable", reason="too few")
    made = adjust(pairs, 5, 0, SHAPE, Affine)
    assert [m is not None for m in made.models] == [True, True, True, False, False]
    assert np.isnan(made.standard_errors[3:]).all()


def test_closure_is_what_a_loop_leaves() -> None:
    models = truths(4, 5)
    pairs = [pair(models, i, k) for i, k in planned(4, 0, "all")]
    assert max(loop.misclosure for loop in loops(pairs)) < 1e-9
    pairs[0] = pair(models, 0, 1, (0.3, 0.4))
    found = loops(pairs)
    assert len(found) == 4
    assert closure_of(found, 0) == pytest.approx(np.sqrt(2 / 3) * 0.5, rel=1e-2)
    assert closure_of(found, 9) is None


def test_pairs_planned() -> None:
    assert planned(4, 0, "chain") == [(0, 1), (1, 2), (2, 3)]
    assert planned(4, 3, None) == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    assert len(planned(40, 0, None)) < 3 * 40
    assert len(planned(6, 0, "all")) == 15
    assert planned(4, 0, 1) == planned(4, 0, "chain")
    with pytest.raises(ParameterError, match="whole number"):
        planned(4, 0, "rings")


def walk(seed: int, count: int = 12) -> list[Any]:
    return list(np.cumsum(np.random.default_rng(seed).normal(0, 0.25, (count, 2)), axis=0))


def test_a_random_walk_is_no_jump_and_two_pixels_are() -> None:
    errors = [0.05] * 12
    invented = sum(bool(jumps(walk(seed), errors)) for seed in range(300))
    assert invented <= 3
    found = 0
    for seed in range(300):
        angle = np.random.default_rng([seed, 1]).uniform(0, 2 * np.pi)
        shifts = walk(seed)
        step = shifts[7] - shifts[6] + 2 * np.array([np.cos(angle), np.sin(angle)])
        moved = [s + (step - (shifts[7] - shifts[6]) if i >= 7 else 0) for i, s in enumerate(shifts)]
        told = jumps(moved, errors)
        found += [j.image for j in told] == [7] and np.allclose(told[0][1:], step)
    assert found >= 285


def test_a_jump_behind_a_date_that_was_left_out_and_two_jumps() -> None:
    shifts = walk(3)
    moved: list[Any] = [s + (3.0 if i >= 5 else 0) - (4.0 if i >= 9 else 0) for i, s in enumerate(shifts)]
    moved[5] = None
    assert [jump.image for jump in jumps(moved, [0.05] * 12)] == [6, 9]
    assert jumps(shifts[:4], [0.05] * 4) == []
