"""Gradient histograms around points: their dominant orientation, and the cells that describe."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.sar.gradients.gradient_field import GradientField
from featreg.sar.keypoints.gradient_histograms import (
    CELLS,
    DIRECTIONS,
    ORIENTATIONS,
    _disc,
    dominant_orientation,
    gloh,
    normalised,
    row_length,
)
from featreg.sar.keypoints.histogram_kernels import polar_of

Texture = Callable[..., NDArray[np.float32]]


def uniform_field(angle: float, shape: tuple[int, int] = (80, 90)) -> GradientField:
    """Unit gradients that all point along `angle`, counter-clockwise as seen."""
    ones = np.ones(shape, np.float32)
    return GradientField(ones * np.float32(math.cos(angle)), ones * np.float32(-math.sin(angle)))


@pytest.mark.parametrize("angle", [0.0, 0.5, 2.0, math.pi, 4.0, 6.2])
def test_the_dominant_orientation_is_that_of_the_gradients(angle: float) -> None:
    found = dominant_orientation(uniform_field(angle), np.array([[40.0, 40.0]]), np.array([15.0]))
    assert abs(math.remainder(float(found[0]) - angle, 2 * math.pi)) < math.radians(1.5)


@pytest.mark.parametrize("harmonics", [0, 2, 4])
def test_no_gradient_has_no_orientation_and_nothing_to_describe(harmonics: int) -> None:
    flat = GradientField(*np.zeros((2, 50, 50), np.float32))
    xy, radius = np.array([[25.0, 25.0]]), np.array([10.0])
    assert dominant_orientation(flat, xy, radius)[0] == 0
    rows = normalised(gloh(flat, xy, radius, np.zeros(1), harmonics))
    assert rows.shape == (1, row_length(harmonics))
    assert not rows.any()


@pytest.mark.parametrize("soft", [True, False])
def test_directions_count_from_that_of_the_point(soft: bool) -> None:
    """Gradients along the point's own direction fall into bin 0, those a quarter turn on into bin 2."""
    xy, radius = np.array([[40.3, 41.8]]), np.array([15.0])
    for turn, bin_ in ((0.0, 0), (math.pi / 2, 2), (-math.pi / 2, 6)):
        field = uniform_field(0.7 + turn)
        histogram = gloh(field, xy, radius, np.array([0.7]), 4, soft=soft).reshape(DIRECTIONS, CELLS)
        np.testing.assert_allclose(histogram[bin_].sum() / histogram.sum(), 1, atol=1e-3)
        assert (histogram[bin_] > 0).all()


@pytest.mark.parametrize("soft", [True, False])
@pytest.mark.parametrize("kept", [0, 1, 2, 3])
def test_harmonics_are_those_of_histograms_that_share_a_direction_between_two_bins(
    sar_texture: Texture, soft: bool, kept: int
) -> None:
    """Up to what eight bins cannot tell apart: the harmonics 8 - k and 8 + k, which they weaken to a tenth and less."""
    from scipy.ndimage import gaussian_filter

    smooth = gaussian_filter(np.log(sar_texture(160, 160) + 1), 2)
    field = GradientField(*(np.gradient(smooth, axis=axis).astype(np.float32) for axis in (1, 0)))
    g = np.random.default_rng(1)
    xy, radius, angle = g.uniform(-5, 165, (200, 2)), g.uniform(8, 30, 200), g.uniform(-4, 7, 200)
    histograms = gloh(field, xy, radius, angle, 4, soft=soft).reshape(200, DIRECTIONS, CELLS)
    harmonics = gloh(field, xy, radius, angle, kept, soft=soft).reshape(200, 1 + 2 * kept, CELLS)
    turn = 2 * math.pi * np.arange(DIRECTIONS) / DIRECTIONS
    waves = [np.full(DIRECTIONS, math.sqrt(0.5))] + [f(k * turn) for k in range(1, kept + 1) for f in (np.cos, np.sin)]
    wanted = np.einsum("nbc,wb->nwc", histograms, np.array(waves)) / 2
    lengths = np.linalg.norm(histograms.reshape(200, -1), axis=1)
    assert lengths.min() > 0
    assert np.abs(harmonics[:, 0] - wanted[:, 0]).max() < 1e-4 * lengths.max()
    off = np.linalg.norm((harmonics - wanted).reshape(200, -1), axis=1) / lengths
    assert np.median(off) < 0.03 * (1 + kept)


def test_harmonics_fade_as_those_of_directions_that_two_of_eight_bins_share() -> None:
    """Eight bins blur a harmonic; the mean over points of every angle sees the blur, and none of what it aliases."""
    n = 1000
    angle = 2 * math.pi * np.arange(n) / n
    xy, radius = np.full((n, 2), 40.0), np.full(n, 15.0)
    field = uniform_field(0.0)
    histograms = gloh(field, xy, radius, angle, 4).reshape(n, DIRECTIONS, CELLS).sum(axis=2)
    harmonics = gloh(field, xy[:1], radius[:1], angle[:1], 3).reshape(7, CELLS).sum(axis=1)
    bins = 2 * math.pi * np.arange(DIRECTIONS) / DIRECTIONS
    for k in range(4):
        wave = np.exp(1j * k * (bins + angle[:, None]))
        wanted = abs((histograms * wave).sum(axis=1).mean()) * math.sqrt((2 if k else 1) / DIRECTIONS)
        found = np.hypot(*harmonics[2 * k - 1 : 2 * k + 1]) if k else harmonics[0]
        assert found == pytest.approx(wanted, rel=1e-3)


def test_every_sample_counts_once() -> None:
    xy, radius, angle = np.array([[40.0, 40.0]]), np.array([15.0]), np.array([0.3])
    for harmonics in (0, 4):
        sums = [gloh(uniform_field(1.0), xy, radius, angle, harmonics, soft=soft).sum() for soft in (True, False)]
        np.testing.assert_allclose(sums[0], sums[1], rtol=1e-5)


@pytest.mark.parametrize("sector", range(8))
def test_cells_follow_each_other_counter_clockwise(sector: int) -> None:
    """Gradients only in the direction of a sector's middle are counted in that sector of both rings."""
    xy, radius, angle = np.array([[60.0, 60.0]]), np.array([30.0]), np.array([0.4])
    towards = 0.4 + sector * math.pi / 4
    y, x = np.mgrid[:120, :120]
    direction = np.arctan2(60 - y, x - 60)
    near = np.abs((direction - towards + math.pi) % (2 * math.pi) - math.pi) < math.radians(10)
    field = GradientField(near.astype(np.float32), np.zeros(near.shape, np.float32))
    for harmonics in (0, 4):
        cells = gloh(field, xy, radius, angle, harmonics, soft=False).reshape(-1, CELLS).sum(axis=0)
        assert cells[1 + sector] > 0.9 * cells[1:9].sum()
        assert cells[9 + sector] > 0.9 * cells[9:].sum()


def test_what_lies_outside_the_field_counts_as_nothing() -> None:
    field, radius, angle = uniform_field(1.0), np.array([15.0]), np.zeros(1)
    for harmonics in (0, 4):
        whole = gloh(field, np.array([[40.0, 40.0]]), radius, angle, harmonics).sum()
        corner = gloh(field, np.array([[0.0, 0.0]]), radius, angle, harmonics).sum()
        assert 0.2 < corner / whole < 0.35
        assert gloh(field, np.array([[-500.0, 1e6]]), radius, angle, harmonics).sum() == 0


def test_descriptors_are_unit_vectors_without_large_components() -> None:
    rows = np.random.default_rng(0).gamma(0.3, 1.0, (50, 136)).astype(np.float32)
    for root in (False, True):
        for length in (17, 85, 136):
            np.testing.assert_allclose(np.linalg.norm(normalised(rows[:, :length], root), axis=1), 1, rtol=1e-5)
    np.testing.assert_allclose(normalised(3 * rows), normalised(rows), rtol=1e-4)
    one = np.ones((1, 136), np.float32)
    one[0, 0] = 50
    plain, clipped = one[0, 0] / np.linalg.norm(one), normalised(one)[0, 0]
    assert plain > 0.9
    np.testing.assert_allclose(clipped / normalised(one)[0, 1], 0.2 / plain * 50, rtol=1e-4)


def test_no_cell_of_harmonics_decides_alone() -> None:
    """A cell is shortened as a whole, so that its directions keep their proportion."""
    one = np.ones((1, 5, CELLS), np.float32)
    one[0, :, 3] = [40, 30, 5, 1, 2]
    found = normalised(one.reshape(1, -1))[0].reshape(5, CELLS)
    strong, other = (np.linalg.norm(found[:, k]) for k in (3, 0))
    whole = np.linalg.norm(one)
    np.testing.assert_allclose(strong / other, 0.3 / (np.sqrt(5) / whole), rtol=1e-4)
    np.testing.assert_allclose(found[:, 3] / strong, one[0, :, 3] / np.linalg.norm(one[0, :, 3]), rtol=1e-5)


def test_cells_are_clipped_between_two_normalisations() -> None:
    rng = np.random.default_rng(0)
    cells = rng.normal(size=(50, 5, CELLS)) * rng.gamma(0.3, 1, (50, 1, CELLS))
    cells[7] = 0
    unit = cells / np.maximum(np.sqrt((cells**2).sum(axis=(1, 2), keepdims=True)), 1e-9)
    length = np.sqrt((unit**2).sum(axis=1, keepdims=True))
    clipped = unit * (0.3 / np.maximum(length, 0.3))
    wanted = clipped / np.maximum(np.sqrt((clipped**2).sum(axis=(1, 2), keepdims=True)), 1e-9)
    found = normalised(cells.reshape(50, 5 * CELLS).astype(np.float32))
    np.testing.assert_allclose(found, wanted.reshape(50, 5 * CELLS), atol=1e-6)
    assert (length > 0.3).any()
    assert not found[7].any()


def test_the_root_is_that_of_each_direction_or_of_each_cell() -> None:
    """Of a cell's harmonics the first is its length: the root shortens all of them alike."""
    cells = np.zeros((3, CELLS), np.float32)
    cells[:, 2], cells[:, 9] = [16, 8, 4], [1, 0, -1]
    wanted = np.zeros((3, CELLS))
    wanted[:, 2], wanted[:, 9] = [4, 2, 1], [1, 0, -1]
    np.testing.assert_allclose(normalised(cells.reshape(1, -1), True)[0], wanted.ravel() / math.sqrt(23), rtol=1e-6)
    histogram = np.zeros((1, row_length(4)), np.float32)
    histogram[0, [0, 5, 40]] = [9, 4, 3]
    np.testing.assert_allclose(normalised(histogram, True)[0], np.sqrt(histogram[0] / 16), rtol=1e-6)


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
