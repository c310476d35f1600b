"""Adaptive non-maximal suppression, beside comparing every point with every other."""

from __future__ import annotations

import numpy as np

from featreg.sar.keypoints.suppression import suppression_radius, well_spread


def test_the_radius_is_the_distance_to_the_nearest_clearly_stronger_point() -> None:
    rng = np.random.default_rng(0)
    xy, score = rng.uniform(0, 300, (700, 2)), rng.gamma(2, 1, 700)
    away = np.hypot(*(xy[:, None] - xy[None]).transpose(2, 0, 1))
    away[0.9 * score[None] <= score[:, None]] = np.inf
    assert np.allclose(suppression_radius(xy, score), away.min(axis=1))


def test_points_in_a_crowd_give_way_to_those_that_stand_alone() -> None:
    crowd = np.random.default_rng(1).uniform(0, 10, (50, 2))
    alone = np.array([[100.0, 5.0], [5.0, 100.0], [100.0, 100.0]])
    xy = np.concatenate([crowd, alone])
    score = np.concatenate([np.linspace(2, 3, 50), np.ones(3)])
    assert set(well_spread(xy, score, 4, robust=1.0).tolist()) == {49, 50, 51, 52}
    assert len(well_spread(np.zeros((0, 2)), np.zeros(0), 5)) == 0
