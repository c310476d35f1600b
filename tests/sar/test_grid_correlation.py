"""Correlation on a grid of windows: the same numbers as window by window, and covariances that hold."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.displacement.band import band
from featreg.sar.correlation import local_correlations, peaks
from featreg.sar.grid_correlation import Expected, WindowGrid, grid_correlations, grid_peaks, piece_middles


def speckle(seed: int, shape: tuple[int, int] = (150, 170)) -> NDArray[np.float32]:
    return np.random.default_rng(seed).normal(0, 1, shape).astype(np.float32)


def plain(
    first: NDArray[np.float32], second: NDArray[np.float32], top: int, left: int, side: int, dx: int, dy: int
) -> float:
    a = first[top : top + side, left : left + side].astype(np.float64)
    b = second[top + dy : top + dy + side, left + dx : left + dx + side].astype(np.float64)
    return float((a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum()))


@pytest.mark.parametrize(("step", "window"), [(8, 32), (7, 21), (40, 20)])
def test_equals_the_correlation_of_single_windows(step: int, window: int) -> None:
    first, second = speckle(0), speckle(1) + np.roll(speckle(0), (1, 2), (0, 1))
    grid = WindowGrid(np.arange(5, 110, step), np.arange(6, 130, step), window)
    found = grid_correlations(first, second, grid, 3)
    assert found.shape == (*grid.shape, 7, 7)
    for j, top in enumerate(grid.tops[:4]):
        for i, left in enumerate(grid.lefts):
            for dx, dy in ((0, 0), (3, -3), (-1, 2)):
                assert abs(found[j, i, 3 + dy, 3 + dx] - plain(first, second, top, left, window, dx, dy)) < 1e-5


def test_agrees_with_the_kernels_of_the_refinement() -> None:
    """Those subtract the mean of a window, which band-passed maps hardly have."""
    first, second = (band(speckle(seed)) for seed in (7, 8))
    grid = WindowGrid(np.arange(5, 100, 8), np.arange(6, 120, 8), 41)
    y, x = np.meshgrid(grid.tops + 20, grid.lefts + 20, indexing="ij")
    single = local_correlations(first, second, np.column_stack([x.ravel(), y.ravel()]), 20, 3)
    assert np.abs(grid_correlations(first, second, grid, 3).reshape(single.shape) - single).max() < 2e-3


def test_pieces_are_read_at_shifts_of_their_own() -> None:
    first = speckle(2)
    second = np.empty_like(first)
    second[:, :80], second[:, 80:] = np.roll(first, (1, 2), (0, 1))[:, :80], np.roll(first, (2, 3), (0, 1))[:, 80:]
    # Pieces of 8 px from 16 on: the boundary lies between two of them.
    grid = WindowGrid(np.array([24, 48]), np.array([24, 48, 96]), 48)
    still = Expected.still(grid)
    x, _ = piece_middles(grid)
    pieces = still.pieces + np.array([2, 1])
    pieces[:, x > 80] += 1
    found = grid_correlations(first, second, grid, 1, Expected(still.shift + np.array([2.5, 1.5]), still.slope, pieces))
    # But for the strip of one window that shows the other side.
    assert (found[:, :, 1, 1] > 0.9).all()
    assert np.abs(found[:, :, 0, 0]).max() < 0.2


def test_pieces_that_show_another_motion_are_left_out() -> None:
    first, other = speckle(2), speckle(9)
    second = np.concatenate([first[:, :80], other[:, 80:]], axis=1)
    grid = WindowGrid(np.array([24]), np.array([48]), 48)
    still = Expected.still(grid)
    pieces = still.pieces.copy()
    pieces[:, piece_middles(grid)[0] > 80] += 5
    assert grid_correlations(first, second, grid, 1, Expected(still.shift, still.slope, pieces))[0, 0, 1, 1] > 0.999
    assert grid_correlations(first, second, grid, 1)[0, 0, 1, 1] < 0.8


def test_an_empty_window_correlates_with_nothing() -> None:
    first = speckle(5)
    first[:60, :60] = 0.0
    found = grid_correlations(first, speckle(6), WindowGrid(np.array([10]), np.array([10, 80]), 24), 2)
    assert (found[0, 0] == 0).all()
    assert (found[0, 1] != 0).any()


def test_no_windows() -> None:
    none = np.zeros(0, np.int64)
    grid = WindowGrid(none, none, 16)
    assert grid_correlations(speckle(0), speckle(1), grid, 2).shape == (0, 0, 5, 5)


def test_ellipses_hold_as_many_errors_as_they_say() -> None:
    """Two dates of one texture, moved by a fraction of a pixel: 68 and 95 % of the errors lie in their ellipses."""
    inside = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        texture = np.asarray(cv2.GaussianBlur(rng.normal(0, 1.5, (420, 420)), (0, 0), 1.2), np.float32)
        moved = cv2.warpAffine(texture, np.array([[1, 0, 0.3], [0, 1, -0.4]]), (420, 420), flags=cv2.INTER_CUBIC)
        noise = rng.normal(0, 0.6, (2, *texture.shape)).astype(np.float32)
        first, second = band(texture + noise[0]), band(np.asarray(moved, np.float32) + noise[1])
        starts = np.arange(10, 340, 32)
        grid = WindowGrid(starts, starts, 64)
        expected = Expected.still(grid)
        found = peaks(grid_correlations(first, second, grid, 2).reshape(-1, 5, 5)).shift.reshape(*grid.shape, 2)
        made = grid_peaks(first, second, grid, expected, found)
        # Read where they are, the peaks need nothing taken back to the middle.
        assert np.allclose(made.shift, found, atol=1e-9)
        error, covariance = made.shift - (0.3, -0.4), made.covariance
        inside.append(np.einsum("jik,jikl,jil->ji", error, np.linalg.inv(covariance), error).ravel())
    squared = np.concatenate(inside)
    assert 0.60 <= (squared < 2.279).mean() <= 0.76
    assert 0.91 <= (squared < 5.991).mean() <= 0.98
