"""Corners to a fraction of a pixel: saddles, edges that meet, blobs, centroids."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.sar.keypoints.corners import orientation, refine_centroid, refine_corner
from made.edge_pictures import U8, pictures

OFFSETS = [(0.0, 0.0), (0.3, -0.2), (-0.45, 0.4), (0.1, 0.49), (-0.25, -0.35)]
offsets = pytest.mark.parametrize("offset", OFFSETS)


def grid() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    y, x = np.mgrid[:31, :33].astype(np.float64)
    return x, y


@offsets
@pytest.mark.parametrize("start", [(0, 0), (1, 0), (0, -1)])
def test_a_saddle_corner_is_found_by_its_gradients(offset: tuple[float, float], start: tuple[int, int]) -> None:
    x, y = grid()
    q = np.array([16.0, 15.0]) + offset
    u, v = (x - q[0]) / 1.5, (y - q[1]) / 1.5
    gx, gy = (np.tanh(v) / np.cosh(u) ** 2).astype(np.float32), (np.tanh(u) / np.cosh(v) ** 2).astype(np.float32)
    found, _ = refine_corner(gx, gy, np.array([[16 + start[0], 15 + start[1]]]), 2.0)
    np.testing.assert_allclose(found[0], q, atol=0.05)


@offsets
def test_two_edges_that_meet_are_perpendicular_to_their_gradients(offset: tuple[float, float]) -> None:
    """Eq. 6 for ideal thin edges: every gradient is orthogonal to the line to the corner, so the answer is exact."""
    x, y = grid()
    q = np.array([16.0, 15.0]) + offset
    angle = np.arctan2(y - q[1], x - q[0])
    strength = np.cos(2 * angle) ** 2
    gx, gy = (-np.sin(angle) * strength).astype(np.float32), (np.cos(angle) * strength).astype(np.float32)
    found, _ = refine_corner(gx, gy, np.array([[16, 15]]), 2.0)
    np.testing.assert_allclose(found[0], q, atol=1e-3)


def test_a_corner_that_runs_away_or_is_no_corner_stays_at_its_pixel() -> None:
    x, y = grid()
    angle = np.arctan2(y - 15.0, x - 19.0)  # three pixels to the right of the start
    far = (-np.sin(angle)).astype(np.float32), np.cos(angle).astype(np.float32)
    edge = np.ones(x.shape, np.float32), np.zeros(x.shape, np.float32)
    flat = np.zeros(x.shape, np.float32), np.zeros(x.shape, np.float32)
    for gx, gy in (far, edge, flat):
        stays, stable = refine_corner(gx, gy, np.array([[16, 15]]), 2.0)
        np.testing.assert_array_equal(stays, [[16.0, 15.0]])
        assert not stable.any()


@offsets
@pytest.mark.parametrize("form", ["bright", "ring"])
def test_a_blob_of_edges_is_centred(offset: tuple[float, float], form: str) -> None:
    x, y = grid()
    q = np.array([16.0, 15.0]) + offset
    r = np.hypot(x - q[0], y - q[1])
    values = np.exp(-0.5 * (r / 1.0) ** 2) if form == "bright" else np.exp(-0.5 * ((r - 2.5) / 0.8) ** 2)
    edges = np.rint(240 * values).astype(np.uint8)
    found, _ = refine_centroid(edges, np.array([[16, 15]]), 1.0)
    np.testing.assert_allclose(found[0], q, atol=0.05)


def plain_centroid(edges: U8, start: tuple[int, int], sigma: float, reach: float) -> tuple[float, float] | None:
    """The iterated centroid of one point, term by term; None where it runs away."""
    ys, xs = np.mgrid[-3:4, -3:4]
    q = np.array(start, np.float64)
    first = edges[start[1] - 3 : start[1] + 4, start[0] - 3 : start[0] + 4].astype(np.float64)
    ring = (first.sum() - first[1:6, 1:6].sum()) / 24
    for _ in range(8):
        cx, cy = np.rint(q).astype(int)
        if not (3 <= cx < edges.shape[1] - 3 and 3 <= cy < edges.shape[0] - 3):
            return None
        near = edges[cy - 3 : cy + 4, cx - 3 : cx + 4].astype(np.float64)
        near = near.max() - near if first[3, 3] < ring else near - near.min()
        weight = near * np.exp(-((xs + cx - q[0]) ** 2 + (ys + cy - q[1]) ** 2) / (2 * sigma**2))
        if not weight.sum() > 0:
            return None
        moved = np.array([cx + (weight * xs).sum() / weight.sum(), cy + (weight * ys).sum() / weight.sum()])
        if np.hypot(*(moved - start)) > reach:
            return None
        step, q = np.abs(moved - q).sum(), moved
        if step < 1e-2:
            break
    return float(q[0]), float(q[1])


@pictures
@pytest.mark.parametrize(("sigma", "close"), [(1.0, 1e-5), (0.4, 1e-3)])  # sums in float32, weights to 1e-4
def test_the_centroid_is_that_of_the_plain_sums(picture: U8, sigma: float, close: float) -> None:
    rng = np.random.default_rng(5)
    at = rng.integers(3, np.array(picture.shape[::-1]) - 3, (150, 2))
    found, good = refine_centroid(picture, at, sigma)
    for start, place, stable in zip(at, found, good, strict=True):
        wanted = plain_centroid(picture, (int(start[0]), int(start[1])), sigma, 2.0)
        assert stable == (wanted is not None)
        np.testing.assert_allclose(place, start if wanted is None else wanted, atol=close)


def test_a_blob_far_away_or_no_blob_leaves_the_point() -> None:
    x, y = grid()
    for edges in (np.rint(240 * np.exp(-0.5 * ((x - 20) ** 2 + (y - 15) ** 2) / 4)), np.full(x.shape, 7)):
        found, _ = refine_centroid(edges.astype(np.uint8), np.array([[16, 15]]), 3.0)
        np.testing.assert_array_equal(found, [[16.0, 15.0]])


@pytest.mark.parametrize("at", [(0, 0), (2, 15), (32, 30), (16, 1)])
def test_points_beside_the_border_stay(at: tuple[int, int]) -> None:
    edges = np.random.default_rng(0).integers(0, 256, (31, 33)).astype(np.uint8)
    g = np.random.default_rng(1).normal(size=(2, 31, 33)).astype(np.float32)
    np.testing.assert_array_equal(refine_corner(g[0], g[1], np.array([at]), 2.0)[0], [at])
    np.testing.assert_array_equal(refine_centroid(edges, np.array([at]), 1.0)[0], [at])


def test_no_points_give_no_points() -> None:
    none = np.zeros((0, 2), np.int64)
    flat = np.zeros((20, 20), np.float32)
    assert refine_corner(flat, flat, none, 2.0)[0].shape == (0, 2)
    assert refine_centroid(flat.astype(np.uint8), none, 1.0)[0].shape == (0, 2)
    assert orientation(flat, none, 15).shape == (0,)
