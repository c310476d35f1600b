"""Maxima of a map, between its pixels; halvings of images, and gradients beside pixels without data."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.io import as_image
from featreg.sar.gradients.gradient_field import from_base, octave, ratio_field
from featreg.sar.keypoints.maxima import interpolated, local_maxima, parabola_peak, quadratic_peak, quadratic_steps
from featreg.sar.pyramid import to_base

Texture = Callable[..., NDArray[np.float32]]


def test_maxima_of_a_bump_between_the_pixels() -> None:
    y, x = np.mgrid[:30, :40]
    bump = np.exp(-((x - 17.3) ** 2 + (y - 12.8) ** 2 + 0.6 * (x - 17.3) * (y - 12.8)) / 20).astype(np.float32)
    found = local_maxima(bump, np.ones(bump.shape, np.bool_), 0.5, 10)
    assert found.tolist() == [[17, 13]]
    np.testing.assert_allclose(quadratic_peak(bump, found), [[17.3, 12.8]], atol=0.02)


def test_tops_of_surfaces_are_those_of_least_squares_or_the_middle() -> None:
    """Against numpy's formulas on squares of noise: half of them have no top, some one that is too far."""
    p = np.random.default_rng(0).normal(size=(500, 3, 3)).astype(np.float32)
    p[:400, 1, 1] += 2
    q = p.astype(np.float64)
    slope = np.stack([q[:, 1, 2] - q[:, 1, 0], q[:, 2, 1] - q[:, 0, 1]], axis=1) / 2
    xx, yy = (q[:, 1, 2] + q[:, 1, 0], q[:, 2, 1] + q[:, 0, 1]) - 2 * q[:, 1, 1]
    xy = (q[:, 2, 2] + q[:, 0, 0] - q[:, 0, 2] - q[:, 2, 0]) / 4
    curve = np.stack([np.stack([xx, xy], axis=1), np.stack([xy, yy], axis=1)], axis=1)
    wanted = np.asarray(-np.linalg.solve(curve, slope[:, :, None])[:, :, 0])
    top = np.asarray((np.linalg.eigvalsh(curve) < 0).all(axis=1) & (np.abs(wanted) <= 1).all(axis=1))
    np.testing.assert_allclose(quadratic_steps(p.reshape(500, 9)), wanted * top[:, None], atol=1e-9)
    assert 100 < top.sum() < 450


def test_maxima_come_highest_first_and_at_most_so_many(sar_texture: Texture, monkeypatch: pytest.MonkeyPatch) -> None:
    response, allowed = sar_texture(), np.ones((200, 220), np.bool_)
    allowed[:, :50] = False
    every = local_maxima(response, allowed, 0.0, 10**6)
    values = response[every[:, 1], every[:, 0]]
    assert (np.diff(values) <= 0).all()
    assert every[:, 0].min() >= 50
    np.testing.assert_array_equal(local_maxima(response, allowed, 0.0, 100), every[:100])
    # Large maps are looked at in bands first; where these hold too few maxima, or too low ones, it is for nothing.
    monkeypatch.setattr("featreg.sar.keypoints.maxima.LARGE", 1000)
    for count in (1, 30, 100, 1000, 10**6):
        np.testing.assert_array_equal(local_maxima(response, allowed, 0.0, count), every[:count])
    sloping = response * np.linspace(0, 1, 200, dtype=np.float32)[:, None] ** 8
    assert len(local_maxima(sloping, allowed, 0.0, 100)) == 100
    for x, y in every[:50]:
        assert response[y, x] == response[y - 1 : y + 2, x - 1 : x + 2].max()
    assert len(local_maxima(response, allowed, 1e9, 5)) == 0


def test_a_plateau_has_one_maximum() -> None:
    response = np.zeros((20, 20), np.float32)
    response[5, 5:9] = 1
    assert local_maxima(response, np.ones(response.shape, np.bool_), 0.5, 10).tolist() == [[5, 5]]


def test_parabola_and_bilinear_values_are_exact() -> None:
    t = np.array([-0.4, 0.0, 0.3])
    values = [-((k - t) ** 2) for k in (-1, 0, 1)]
    np.testing.assert_allclose(parabola_peak(*values), t, atol=1e-12)
    assert parabola_peak(np.array([3.0]), np.array([1.0]), np.array([2.0]))[0] == 0
    y, x = np.mgrid[:10, :12].astype(np.float32)
    at_points = np.array([[3.25, 7.5], [0.0, 0.0], [11.0, 9.0]])
    np.testing.assert_allclose(interpolated(2 * x - y, at_points), 2 * at_points[:, 0] - at_points[:, 1], atol=1e-5)


def test_halvings_leave_alpha_large_enough_and_points_where_they_are(sar_texture: Texture) -> None:
    picture = as_image(sar_texture(160, 200))
    for alpha in (1.0, 2.0, 2.5, 5.0):
        level, local = octave(picture, alpha, 1.25)
        assert local >= min(alpha, 1.25)
        np.testing.assert_allclose(local * picture.shape[0] / level.shape[0], alpha)
        assert alpha < 2.5 or level.shape[0] < picture.shape[0]
        points = np.array([[3.0, 4.0], [100.0, 50.0]])
        np.testing.assert_allclose(to_base(from_base(points, level, picture), level, picture), points)


def test_ratio_gradients_end_three_alpha_from_nodata(sar_texture: Texture) -> None:
    mask = np.ones((90, 100), np.bool_)
    mask[40:50, 45:52] = False
    y, x = np.mgrid[:90, :100]
    apart = np.maximum(np.maximum(40 - y, y - 49), np.maximum(45 - x, x - 51))
    field = ratio_field(as_image(sar_texture(90, 100), mask=mask), 2.0, 0.01)
    length = np.hypot(field.x, field.y)
    assert not length[apart <= 6].any()
    assert (length[apart == 7] > 0).all()
