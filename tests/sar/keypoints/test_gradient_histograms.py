"""Directions of gradient fields that are known."""

from __future__ import annotations

import numpy as np
import pytest

from featreg.sar.gradients.gradient_field import GradientField
from featreg.sar.keypoints.gradient_histograms import dominant_orientation
from featreg.sar.keypoints.histogram_kernels import _polar


@pytest.mark.parametrize("degrees", range(-170, 190, 23))
def test_a_field_of_one_direction_has_that_orientation(degrees: int) -> None:
    turn = np.radians(degrees)
    length = np.random.default_rng(0).gamma(1.0, 1.0, (60, 60))
    field = GradientField(*(np.asarray(length * part, np.float32) for part in (np.cos(turn), -np.sin(turn))))
    xy = np.array([[30.0, 30.0], [5.0, 50.0]])
    found = dominant_orientation(field, xy, np.array([12.0, 20.0]))
    off = (found - turn + np.pi) % (2 * np.pi) - np.pi
    assert np.degrees(np.abs(off)).max() < 1.0  # a tenth of a bin


def test_lengths_and_directions_are_those_of_the_arc_tangent() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(2, 1003)).astype(np.float32)
    x[:5], y[:5] = [0, 1, -1, 0, 0], [0, 0, 0, 1, -1]
    length, direction = np.empty_like(x), np.empty_like(x)
    _polar(x, y, length, direction)
    np.testing.assert_allclose(length, np.hypot(x, y), rtol=1e-6)
    off = (direction - np.arctan2(-y, x) + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(off).max() < 1e-5
    assert (direction >= 0).all()
    assert direction.max() < 2 * np.pi
