"""Merged regions: every window once, none too far from its group's middle, nothing computed that nobody looks at."""

from __future__ import annotations

import numpy as np

from featreg.sar.merged_regions import merged_regions


def test_clusters_are_groups_and_lone_points_stay_alone() -> None:
    rng = np.random.default_rng(0)
    middles = np.array([[200, 200], [1500, 300], [700, 1400]])
    xy = np.concatenate([middle + rng.integers(-30, 31, (12, 2)) for middle in middles] + [np.array([[1800, 1800]])])
    order = rng.permutation(len(xy))
    groups = merged_regions(xy[order], 80, 40_000, (2000, 2000))
    found = sorted(tuple(sorted(order[rows].tolist())) for rows in groups)
    assert found == [tuple(range(12)), tuple(range(12, 24)), tuple(range(24, 36)), (36,)]


def test_every_window_is_of_one_group_and_near_its_middle() -> None:
    rng = np.random.default_rng(1)
    xy, side, most = rng.integers(0, 5000, (300, 2)), 100, 90_000
    groups = merged_regions(xy, side, most, (5000, 5000))
    assert sorted(np.concatenate(groups).tolist()) == list(range(300))
    sizes = [len(rows) for rows in groups]
    assert sizes == sorted(sizes, reverse=True)
    assert max(sizes) > 1
    for rows in groups:
        apart = np.abs(xy[rows][:, None] - xy[rows][None]) + side
        assert (apart.prod(axis=2) <= most).all(axis=1).any()


def test_windows_that_cover_the_image_are_one_region_and_those_of_a_large_image_are_not() -> None:
    y, x = np.mgrid[50:1000:40, 50:1000:40]
    xy = np.column_stack([x.ravel(), y.ravel()])
    assert len(merged_regions(xy, 120, 30_000, (1000, 1000))) == 1
    assert len(merged_regions(xy, 120, 30_000, (3000, 3000))) > 1
    assert merged_regions(np.zeros((0, 2), np.int64), 120, 30_000, (10, 10)) == []
