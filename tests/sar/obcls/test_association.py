"""Which target of one image is which of the other: nearest, by vote, by spectra."""

from __future__ import annotations

import numpy as np
import pytest

from featreg.geometry import Rigid
from featreg.sar.obcls.association import fourier_mellin, nearest, vote
from made.parking_lots import CENTRE, parking, rigid, rigid_fit


def test_nearest_is_mutual() -> None:
    a = np.array([[0.0, 0], [1, 0], [50, 0]])
    b = np.array([[0.8, 0], [90, 0]])
    np.testing.assert_array_equal(nearest(a, b), [[1, 0], [2, 1]])
    np.testing.assert_array_equal(nearest(a, b, 10), [[1, 0]])
    assert nearest(a, np.zeros((0, 2))).shape == (0, 2)


@pytest.mark.parametrize("rotation", [0.0, 33.3, 179.0, -90.0])
def test_the_vote_finds_true_pairs_among_as_many_false_ones(rotation: float) -> None:
    rng = np.random.default_rng(0)
    a, truth = rng.uniform(0, 500, (60, 2)), Rigid(rotation, 30.0, -80.0)
    b = np.concatenate(
        [truth(a[:30]) + rng.normal(0, 0.7, (30, 2)), rng.uniform(0, 500, (30, 2)) + truth(a).mean(0) - 250]
    )
    found = vote(a, b, rigid_fit, (500, 500))
    assert isinstance(found.map, Rigid)
    assert abs((found.map.rotation_deg - rotation + 180) % 360 - 180) < 0.4
    true = (found.pairs[:, 0] == found.pairs[:, 1]) & (found.pairs[:, 0] < 30)
    assert true.sum() >= 26
    assert found.log10_chance < -8


def test_the_chance_of_random_targets_is_no_evidence() -> None:
    rng = np.random.default_rng(1)
    for _ in range(5):
        assert vote(rng.uniform(0, 500, (80, 2)), rng.uniform(0, 500, (80, 2)), rigid_fit, (500, 500)).log10_chance > -3


def test_degenerate_targets_are_not_associated() -> None:
    line = np.column_stack([np.arange(0, 400, 60.0), np.full(7, 50.0)])
    for a in (np.zeros((0, 2)), np.zeros((1, 2)), np.zeros((5, 2)), line[:2]):
        assert vote(a, line, rigid_fit, (400, 400)).pairs.shape == (0, 2)
    # Either way round.
    assert vote(line, line, rigid_fit, (400, 400)).pairs.shape == (0, 2)


@pytest.mark.parametrize("rotation", [0.0, 21.7, -152.3])
def test_spectra_and_images_give_rotation_and_shift(rotation: float) -> None:
    truth = rigid(rotation, (9.0, -21.0))
    first, second = (np.log(np.maximum(look, 2)).astype(np.float32) for look in parking(truth, seed=13))
    way = fourier_mellin(first, second)[0]
    some = CENTRE + np.array([[0, 100], [100, 0]])
    assert np.hypot(*(way(some) - truth(some)).T).max() < 4
    assert fourier_mellin(np.zeros((64, 64), np.float32), np.zeros((64, 64), np.float32)) == []
