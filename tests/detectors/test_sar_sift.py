"""SAR-SIFT: gradient histograms, maxima, the SAR-Harris detector and the ratio GLOH descriptor."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg import registry
from featreg.errors import ParameterError
from featreg.io import as_image
from featreg.sar.gradients.gradient_field import GradientField, from_base, octave, ratio_field
from featreg.sar.keypoints.gradient_histograms import (
    CELLS,
    DIRECTIONS,
    dominant_orientation,
    gloh,
    normalised,
    row_length,
)
from featreg.sar.keypoints.maxima import interpolated, local_maxima, parabola_peak, quadratic_peak, quadratic_steps
from featreg.sar.pyramid import to_base
from featreg.types import Features, Image

Texture = Callable[..., NDArray[np.float32]]


def uniform_field(angle: float, shape: tuple[int, int] = (80, 90)) -> GradientField:
    """Unit gradients that all point along `angle`, counter-clockwise as seen."""
    ones = np.ones(shape, np.float32)
    return GradientField(ones * np.float32(math.cos(angle)), ones * np.float32(-math.sin(angle)))


def detect(picture: Image, **parameters: Any) -> Features:
    return registry.create("detector", "sar-harris", **parameters).detect_features(picture)


def describe(picture: Image, features: Features, **parameters: Any) -> NDArray[np.float32]:
    found = registry.create("descriptor", "ratio-gloh", **parameters).describe_features(picture, features).descriptors
    assert found is not None
    return found.astype(np.float32)


def at(xy: Any, scale: float = 20.0, angle: Any = 0.0) -> Features:
    xy = np.asarray(xy, np.float64)
    return Features(xy, scale, angle, np.ones(len(xy)), np.zeros(len(xy), np.int64))


# Histograms


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


# Maxima


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


# Detector


def test_points_follow_a_scene_that_moves_by_a_fraction_of_a_pixel(sar_texture: Texture) -> None:
    from scipy.ndimage import fourier_shift, gaussian_filter

    shift = np.array([0.4, -0.3])
    smooth = gaussian_filter(sar_texture(240, 240).astype(np.float64), 1.2, mode="wrap")
    moved = np.maximum(np.fft.ifft2(fourier_shift(np.fft.fft2(smooth), shift[::-1])).real, 0)
    a, b = (detect(as_image(v.astype(np.float32)), scales=3) for v in (smooth, moved))
    apart = np.hypot(*(a.xy[:, None] + shift - b.xy[None]).transpose(2, 0, 1))
    near = apart.min(axis=1) < 1
    assert near.mean() > 0.8
    found = (b.xy[apart.argmin(axis=1)] - a.xy)[near]
    np.testing.assert_allclose(found.mean(axis=0), shift, atol=0.05)
    assert np.median(np.hypot(*(found - shift).T)) < 0.15


def test_edges_and_flat_areas_are_no_corners() -> None:
    x = np.mgrid[:150, :150][1]
    edge = as_image(np.where(x < 75, 1, 5).astype(np.float32))
    assert len(detect(edge)) == 0


def test_the_scale_follows_the_layer(sar_texture: Texture) -> None:
    found = detect(as_image(sar_texture(300, 300)), n_features=3000, subscale=False)
    assert len(set(found.level)) >= 6
    np.testing.assert_allclose(found.scale, 12 * 2 ** (found.level / 3))
    between = detect(as_image(sar_texture(300, 300)), n_features=3000)
    steps = 3 * np.log2(between.scale / 12) - between.level
    assert np.abs(steps).max() <= 0.5 + 1e-9
    assert (steps != 0).any()


@pytest.mark.parametrize(("n_features", "thin", "step"), [(300, True, 2), (300, False, 1), (2000, True, 1)])
def test_every_other_scale_does_where_there_are_pixels_enough(
    sar_texture: Texture, n_features: int, thin: bool, step: int
) -> None:
    """With 53 pixels for each of 300 keypoints; the scales that are left lie where they would anyway."""
    picture = as_image(sar_texture(126, 126))
    found = detect(picture, n_features=n_features, thin=thin, scales=4, support=6.0)
    np.testing.assert_array_equal(np.unique(found.level), np.arange(0, 4, step))
    around = 6.0 * 2 ** (found.level / 3)
    assert (np.abs(np.log2(found.scale / around)) <= step / 6 + 1e-9).all()


def test_the_smaller_of_a_pair_decides_on_the_scales_of_both(sar_texture: Texture) -> None:
    large, small = as_image(sar_texture(126, 126)), as_image(sar_texture(100, 126))
    found = registry.create("detector", "sar-harris", n_features=300, scales=4, support=6.0)
    for pair, step in (((large, large), 2), ((large, small), 1), ((small, large), 1), ((small, small), 1)):
        for picture in pair:
            levels = found.for_pair(*pair).detect_features(picture).level
            np.testing.assert_array_equal(np.unique(levels), np.arange(0, 4, step))


def test_pixels_without_data_are_not_enough(sar_texture: Texture) -> None:
    mask = np.ones((126, 126), np.bool_)
    mask[:40] = False
    found = detect(as_image(sar_texture(126, 126), mask=mask), n_features=300, scales=4, support=6.0)
    assert set(found.level.tolist()) == {0, 1, 2, 3}


def test_gain_moves_nothing(sar_texture: Texture) -> None:
    first, second = (detect(as_image(sar_texture() * np.float32(gain))) for gain in (1, 1024))
    np.testing.assert_allclose(first.xy, second.xy, atol=1e-3)
    np.testing.assert_allclose(first.score, second.score, rtol=1e-3)


def test_no_support_touches_nodata_and_what_lies_there_has_no_influence(sar_texture: Texture) -> None:
    amplitude = sar_texture(260, 260)
    mask = np.ones(amplitude.shape, np.bool_)
    mask[100:130, 120:150] = False
    first, second = (detect(as_image(a, mask=mask)) for a in (amplitude, np.where(mask, amplitude, 99)))
    np.testing.assert_array_equal(first.xy, second.xy)
    assert len(first) > 50
    y, x = np.nonzero(~np.pad(mask, 1))
    apart = np.hypot(first.xy[:, None, 0] + 1 - x, first.xy[:, None, 1] + 1 - y).min(axis=1)
    assert (apart >= first.scale / 2 ** (1 / 6) - 1.5).all()
    one, two = (describe(as_image(a, mask=mask), first) for a in (amplitude, np.where(mask, amplitude, 99)))
    np.testing.assert_array_equal(one, two)


# Descriptor


def test_turning_image_and_point_by_a_quarter_keeps_the_descriptor(sar_texture: Texture) -> None:
    amplitude = sar_texture()
    xy = np.random.default_rng(0).integers(50, 150, (40, 2)).astype(np.float64)
    turned = np.column_stack([xy[:, 1], amplitude.shape[1] - 1 - xy[:, 0]])
    before = describe(as_image(amplitude), at(xy, angle=0.4))
    after = describe(as_image(np.rot90(amplitude).copy()), at(turned, angle=0.4 + math.pi / 2))
    other = describe(as_image(np.rot90(amplitude).copy()), at(turned, angle=0.4))
    before, after, other = (d / np.linalg.norm(d, axis=1, keepdims=True) for d in (before, after, other))
    assert np.einsum("ij,ij->i", before, after).min() > 0.98
    assert np.einsum("ij,ij->i", before, other).mean() < 0.9


def test_gain_and_nothing(sar_texture: Texture) -> None:
    picture, louder = (as_image(sar_texture() * np.float32(gain)) for gain in (1, 500))
    points = at(np.random.default_rng(1).uniform(0, 200, (30, 2)))
    np.testing.assert_allclose(describe(picture, points), describe(louder, points), atol=2e-3)
    assert describe(picture, Features.empty()).shape == (0, 85)


def test_speckle_leaves_descriptors_of_one_place_alike(sar_texture: Texture) -> None:
    """Fresh speckle on the same scene: the same place is nearer than another one in nearly every case."""
    rng = np.random.default_rng(3)
    scene = sar_texture(300, 300, looks=50.0)
    first, second = (as_image(scene * np.sqrt(rng.gamma(4, 0.25, scene.shape)).astype(np.float32)) for _ in range(2))
    points = at(rng.uniform(60, 240, (80, 2)), scale=30.0)
    likeness = describe(first, points) @ describe(second, points).T
    assert (likeness.argmax(axis=1) == np.arange(80)).mean() > 0.9


def test_an_image_twice_as_large_is_described_alike_in_its_first_octave(sar_texture: Texture) -> None:
    """Halving the image whose pixels are all doubled gives the image back."""
    amplitude, xy = sar_texture(150, 160), np.random.default_rng(0).uniform(30, 120, (20, 2))
    large = as_image(amplitude.repeat(2, axis=0).repeat(2, axis=1))
    angle = np.linspace(0, 6, 20)
    small = describe(as_image(amplitude), at(xy, 24.0, angle))
    np.testing.assert_allclose(describe(large, at(2 * xy + 0.5, 48.0, angle)), small, atol=1e-5)


@pytest.mark.parametrize("scale", [1e-6, 5.0, 40.0, 1e7])
def test_any_scale_can_be_described(sar_texture: Texture, scale: float) -> None:
    assert np.isfinite(describe(as_image(sar_texture()), at([[100, 100]], scale=scale))).all()


@pytest.mark.parametrize(
    ("kind", "name", "parameters"),
    [
        ("detector", "sar-harris", {"scales": 0}),
        ("detector", "sar-harris", {"factor": 1.0}),
        ("detector", "sar-harris", {"alpha": float("nan")}),
        ("detector", "sar-harris", {"d": 0.25}),
        ("detector", "sar-harris", {"threshold": -1.0}),
        ("detector", "sar-harris", {"quota_decay": 0.5}),
        ("descriptor", "ratio-gloh", {"finest": 0.0}),
        ("descriptor", "ratio-gloh", {"step": 0.5}),
        ("descriptor", "ratio-gloh", {"factor": 1.0}),
    ],
    ids=str,
)
def test_impossible_parameters_are_refused(kind: Any, name: str, parameters: dict[str, Any]) -> None:
    with pytest.raises(ParameterError):
        registry.create(kind, name, **parameters)


def test_the_angle_of_a_point_turns_with_the_image(sar_texture: Texture) -> None:
    amplitude = sar_texture(240, 240)
    first = detect(as_image(amplitude), n_features=300)
    second = detect(as_image(np.rot90(amplitude).copy()), n_features=300)
    moved = np.column_stack([first.xy[:, 1], 239 - first.xy[:, 0]])
    apart = np.hypot(*(moved[:, None] - second.xy[None]).transpose(2, 0, 1))
    rows, partner = np.flatnonzero(apart.min(axis=1) < 0.1), apart.argmin(axis=1)
    assert len(rows) > 150
    turn = second.angle[partner[rows]] - first.angle[rows]
    off = np.abs((turn - math.pi / 2 + math.pi) % (2 * math.pi) - math.pi)
    assert (off < math.radians(10)).mean() > 0.85


def test_few_keypoints_of_a_large_image_are_none_of_the_finest_scales(sar_texture: Texture) -> None:
    """Scales finer than `finest` are left out, in both images of a pair or in neither; small images keep all."""
    large, small = as_image(sar_texture(300, 300)), as_image(sar_texture(120, 120))
    detector = registry.create("detector", "sar-harris", n_features=100)
    levels = {name: set(found.level.tolist()) for name, found in {
        "large": detector.detect_features(large),
        "many": registry.create("detector", "sar-harris", n_features=1000).detect_features(large),
        "small": detector.detect_features(small),
        "asked": registry.create("detector", "sar-harris", n_features=100, coarse=False).detect_features(large),
        "pair": detector.for_pair(large, small).detect_features(large),
    }.items()}  # fmt: skip
    assert min(levels["large"]) == 3
    assert {min(levels[name]) for name in ("many", "small", "asked", "pair")} == {0}
    assert detector.for_pair(large, large) is detector
