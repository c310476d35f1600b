"""Directions of gradient fields that are known."""

from __future__ import annotations

import numpy as np
import pytest

from featreg.sar.gradients.gradient_field import GradientField
from featreg.sar.keypoints.gradient_histograms import ORIENTATIONS, _disc, dominant_orientation
from featreg.sar.keypoints.histogram_kernels import polar_of


@pytest.mark.parametrize("degrees", range(-170, 190, 23))
def test_a_field_of_one_direction_has_that_orientation(degrees: int) -> None:
    turn = np.radians(degrees)
    length = np.random.default_rng(0).gamma(1.0, 1.0, (60, 60))
    field = GradientField(*(np.asarray(length * part, np.float32) for part in (np.cos(turn), -np.sin(turn))))
    xy = np.array([[30.0, 30.0], [5.0, 50.0]])
    found = dominant_orientation(field, xy, np.array([12.0, 20.0]))
    off = (found - turn + np.pi) % (2 * np.pi) - np.pi
    assert np.degrees(np.abs(off)).max() < 1.0  # a tenth of a bin


def plain_orientation(field: GradientField, x: float, y: float, radius: float) -> float:
    """Lowe's histogram, every sample shared by two bins, smoothed, its peak refined."""
    pattern = _disc(0.14)
    u, v = pattern.samples.astype(np.float64) * radius
    column, row = np.floor(x + u + 0.5).astype(np.int64), np.floor(y - v + 0.5).astype(np.int64)
    height, width = field.x.shape
    inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
    gx, gy = (part[row[inside], column[inside]].astype(np.float64) for part in (field.x, field.y))
    weight = np.hypot(gx, gy) * pattern.weight[inside]
    place = np.arctan2(-gy, gx) % (2 * np.pi) * ORIENTATIONS / (2 * np.pi)
    low = np.floor(place).astype(np.int64)
    histogram = np.zeros(ORIENTATIONS)
    np.add.at(histogram, low % ORIENTATIONS, weight * (low + 1 - place))
    np.add.at(histogram, (low + 1) % ORIENTATIONS, weight * (place - low))
    around = [np.roll(histogram, shift) for shift in range(-2, 3)]
    smooth = np.tensordot([1, 4, 6, 4, 1], around, 1)
    best = int(np.argmax(smooth))
    before, after = smooth[best - 1], smooth[(best + 1) % ORIENTATIONS]
    offset = 0.5 * (before - after) / (before - 2 * smooth[best] + after)
    return float((best + offset) * 2 * np.pi / ORIENTATIONS)


def test_orientations_are_those_of_a_plain_histogram() -> None:
    """Of speckle, some of whose samples lie outside the field."""
    rng = np.random.default_rng(3)
    field = GradientField(*rng.normal(size=(2, 70, 90)).astype(np.float32))
    xy, radius = rng.uniform(0, [90, 70], (200, 2)), rng.uniform(4, 30, 200)
    wanted = [plain_orientation(field, x, y, r) for (x, y), r in zip(xy, radius, strict=True)]
    off = (dominant_orientation(field, xy, radius) - wanted + np.pi) % (2 * np.pi) - np.pi
    # Where two peaks are as high, or a sample lies on the edge of a pixel, rounding decides.
    assert np.quantile(np.abs(off), 0.97) < 1e-4


def test_lengths_and_directions_are_those_of_the_arc_tangent() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(2, 1003)).astype(np.float32)
    x[:5], y[:5] = [0, 1, -1, 0, 0], [0, 0, 0, 1, -1]
    length, direction = np.empty_like(x), np.empty_like(x)
    polar_of(x, y, length, direction)
    np.testing.assert_allclose(length, np.hypot(x, y), rtol=1e-6)
    off = (direction - np.arctan2(-y, x) + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(off).max() < 1e-5
    assert (direction >= 0).all()
    assert direction.max() < 2 * np.pi
