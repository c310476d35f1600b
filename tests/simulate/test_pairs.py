"""The simulated pair: exact geometry, speckle that follows its law, and a dynamic range as real images have it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import featreg.simulate
from featreg.errors import ParameterError
from featreg.simulate import SimulatedPair, sar_pair, similarity_matrix
from featreg.simulate.landscape import area_of, clipped, districts, inside, parcels, rectangle, ribbon
from featreg.simulate.paint_kernels import paint_outlines
from featreg.simulate.speckle_field import point_field, point_response, speckle_field


def mapped(matrix: Any, xy: Any) -> Any:
    return xy @ matrix[:, :2].T + matrix[:, 2]


def fitted_position(amplitude: Any, near: Any) -> Any:
    """Position of a point target by least squares of the system's intensity response on a flat background."""
    from scipy.optimize import least_squares

    column, row = np.round(near).astype(int)
    steps = np.arange(-3, 4)
    patch = amplitude[row - 3 : row + 4, column - 3 : column + 4].astype(np.float64) ** 2

    def misfit(p: Any) -> Any:
        shape = np.outer(point_response(steps - p[1]), point_response(steps - p[0])) ** 2
        return (p[2] * shape + p[3] - patch).ravel() / patch.max()

    best = least_squares(misfit, [*(near - [column, row]), patch.max(), np.median(patch)], x_scale=[1, 1, 100, 1])
    return best.x[:2] + np.array([column, row])


@pytest.fixture(scope="module")
def pair() -> SimulatedPair:
    return sar_pair((400, 500), seed=3)


@pytest.mark.parametrize(
    "geometry",
    [
        {},
        {"rotation_deg": -37.0, "scale": 0.93, "shift": (-20.3, 4.7)},
        {"rotation_deg": 0.0, "scale": 1.0, "shift": (3.3, -2.6)},
    ],
)
def test_point_targets_lie_where_the_truth_says(geometry: dict[str, Any]) -> None:
    clean = sar_pair((420, 380), looks=math.inf, seed=5, **geometry)
    assert len(clean.targets) >= 5
    wanted = mapped(clean.truth, clean.targets)
    errors = []
    for at, image_at in ((clean.targets, clean.reference), (wanted, clean.secondary)):
        found = np.array([fitted_position(image_at, xy) for xy in at])
        errors.append(np.hypot(*(found - at).T).max())
    assert max(errors) < 0.05


def test_positive_rotation_turns_counter_clockwise_as_seen() -> None:
    matrix = similarity_matrix((101, 201), 30.0, 2.0, (0.0, 0.0))
    centre = np.array([100.0, 50.0])
    np.testing.assert_allclose(mapped(matrix, centre[None]), centre[None], atol=1e-12)
    right_of_it = mapped(matrix, centre[None] + [10.0, 0.0]) - centre
    np.testing.assert_allclose(right_of_it, [[20 * math.cos(math.pi / 6), -10.0]], atol=1e-12)


def test_truth_is_the_matrix_of_the_arguments(pair: SimulatedPair) -> None:
    np.testing.assert_array_equal(pair.truth, similarity_matrix((400, 500), 6.0, 1.02, (12.0, -7.0)))
    assert pair.truth.dtype == np.float64
    assert pair.reference.shape == pair.secondary.shape == (400, 500)
    assert pair.reference.dtype == pair.secondary.dtype == np.float32


@pytest.mark.parametrize("looks", [1, 4, 16])
def test_speckle_has_unit_mean_and_the_variance_of_its_looks(looks: int) -> None:
    field = speckle_field((500, 500), looks, np.random.default_rng(0))
    assert field.mean() == pytest.approx(1.0, abs=0.01)
    assert field.var() == pytest.approx(1 / looks, rel=0.03)


def test_one_look_speckle_is_exponential() -> None:
    field = speckle_field((500, 500), 1, np.random.default_rng(1))
    for level in (0.1, 1.0, 3.0):
        assert (field > level).mean() == pytest.approx(math.exp(-level), abs=0.01)


def test_speckle_is_correlated_as_the_response_says() -> None:
    field = speckle_field((700, 700), 2, np.random.default_rng(2))
    taps = point_response(np.arange(-8, 9))
    for lag in (1, 2, 5):
        expected = ((taps[lag:] * taps[:-lag]).sum() / (taps**2).sum()) ** 2
        for a, b in ((field[lag:], field[:-lag]), (field[:, lag:], field[:, :-lag])):
            assert np.corrcoef(a.ravel(), b.ravel())[0, 1] == pytest.approx(expected, abs=0.015)


def test_response_is_1_3_pixels_wide() -> None:
    t = np.linspace(0, 2, 2001)
    assert 2 * t[np.argmax(point_response(t) ** 2 < 0.5)] == pytest.approx(1.3, abs=0.02)


def test_point_field_puts_a_peak_at_a_fraction_of_a_pixel() -> None:
    field = point_field(np.array([[20.3, 15.8]]), np.array([5j]), (40, 50))
    assert field.shape == (40, 50)
    expected = 5j * point_response(16 - 15.8) * point_response(20 - 20.3)
    assert field[16, 20] == pytest.approx(complex(expected), rel=1e-5)
    assert not point_field(np.array([[500.0, 3.0]]), np.array([1.0 + 0j]), (40, 50)).any()


def test_speckle_of_the_two_images_is_independent() -> None:
    same_place = {"rotation_deg": 0.0, "scale": 1.0, "shift": (0.0, 0.0), "change": 0.0, "seed": 2}
    noisy = sar_pair((300, 300), looks=4, **same_place)  # type: ignore[arg-type]
    clean = sar_pair((300, 300), looks=math.inf, **same_place)  # type: ignore[arg-type]
    np.testing.assert_array_equal(clean.reference, clean.secondary)
    intensity = clean.reference**2 + featreg.simulate.NOISE
    plain = intensity < 2
    first, second = (image[plain] ** 2 / intensity[plain] for image in (noisy.reference, noisy.secondary))
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.02
    assert first.mean() == pytest.approx(1.0, abs=0.03)
    assert first.var() == pytest.approx(0.25, rel=0.15)


def test_same_seed_same_pair_and_other_seed_other_pair(pair: SimulatedPair) -> None:
    again, other = sar_pair((400, 500), seed=3), sar_pair((400, 500), seed=4)
    np.testing.assert_array_equal(again.reference, pair.reference)
    np.testing.assert_array_equal(again.secondary, pair.secondary)
    assert not np.array_equal(other.reference, pair.reference)


def test_reference_does_not_depend_on_the_rotation(pair: SimulatedPair) -> None:
    np.testing.assert_array_equal(sar_pair((400, 500), rotation_deg=-80.0, seed=3).reference, pair.reference)


def test_whole_pixel_shift_moves_the_whole_image() -> None:
    moved = sar_pair((200, 240), looks=math.inf, rotation_deg=0, scale=1, shift=(9.0, -4.0), change=0, seed=8)
    # away from the border, where the response leans on pixels that only one image has
    np.testing.assert_allclose(moved.secondary[10:180, 30:220], moved.reference[14:184, 21:211], rtol=0.02, atol=0.01)


def test_strips_leave_no_seam(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = sar_pair((200, 150), looks=math.inf, seed=1)
    monkeypatch.setattr("featreg.simulate.pairs.STRIP", 37)
    striped = sar_pair((200, 150), looks=math.inf, seed=1)
    np.testing.assert_allclose(striped.reference, whole.reference, rtol=1e-4)
    np.testing.assert_allclose(striped.secondary, whole.secondary, rtol=1e-4)


def test_painted_outline_holds_the_samples_whose_centre_is_inside() -> None:
    rng = np.random.default_rng(0)
    for corners in (rectangle([11.3, 8.8], 14.2, 7.7, 0.4), rng.uniform(-6, 30, (9, 2))):
        canvas = np.zeros((20, 25, 2), np.float32)
        paint_outlines(canvas, corners, np.array([len(corners)]), np.array([[2.0, 3.0]]))
        y, x = np.indices((20, 25)).reshape(2, -1)
        expected = inside(corners, np.column_stack([x, y]).astype(float)).reshape(20, 25)
        np.testing.assert_array_equal(canvas, expected[..., None] * np.array([2.0, 3.0]))


def test_later_outlines_cover_earlier_ones() -> None:
    squares = np.concatenate([rectangle([4, 4], 6.5, 6.5, 0), rectangle([6, 6], 6.5, 6.5, 0)])
    canvas = np.zeros((12, 12, 1), np.float32)
    paint_outlines(canvas, squares, np.array([4, 8]), np.array([[1.0], [2.0]]))
    assert canvas[2, 2, 0] == 1
    assert canvas[5, 5, 0] == canvas[8, 8, 0] == 2
    assert canvas[11, 11, 0] == 0


def test_change_grows_with_its_share() -> None:
    def changed(share: float) -> float:
        clean = sar_pair((300, 300), looks=math.inf, rotation_deg=0, scale=1, shift=(0, 0), change=share, seed=6)
        ratio = np.abs(np.log((clean.secondary**2 + 0.02) / (clean.reference**2 + 0.02)))
        return float((ratio > 0.4).mean())

    none, little, much = changed(0.0), changed(0.1), changed(0.6)
    assert none == 0
    assert 0.02 < little < 0.2
    assert 0.3 < much < 0.7


@pytest.mark.parametrize("seed", range(3))
def test_dynamic_range_is_that_of_a_real_image(seed: int) -> None:
    made = sar_pair(seed=seed)
    for image in (made.reference, made.secondary):
        assert np.isfinite(image).all()
        assert image.min() > 0
        assert 0.5 < np.log(image).std() < 0.8
        assert 7 < np.percentile(image, 99.9) / np.median(image) < 20


@pytest.mark.parametrize(
    "bad",
    [
        {"shape": (20, 600)},
        {"looks": 0},
        {"looks": 2.5},
        {"scale": 0.0},
        {"change": 1.5},
        {"shift": (math.nan, 0.0)},
        {"rotation_deg": math.inf},
    ],
)
def test_impossible_arguments_are_refused(bad: dict[str, Any]) -> None:
    with pytest.raises(ParameterError, match=next(iter(bad))):
        sar_pair(**bad)


def test_districts_and_parcels_tile_the_ground() -> None:
    rng = np.random.default_rng(0)
    cells = districts(np.array([-50.0, 0.0]), np.array([450.0, 300.0]), 120, rng)
    assert sum(map(area_of, cells)) == pytest.approx(500 * 300)
    for cell in cells:
        fields = parcels(cell, 40, rng)
        assert len(fields) > 1
        assert sum(map(area_of, fields)) == pytest.approx(area_of(cell))


def test_outlines() -> None:
    square = rectangle([0, 0], 2, 2, 0.3)
    assert area_of(square) == pytest.approx(4)
    assert area_of(clipped(square, np.array([1.0, 0.0]), 0.0)) == pytest.approx(2)
    assert len(clipped(square, np.array([1.0, 0.0]), -9.0)) == 0
    np.testing.assert_array_equal(inside(square, np.array([[0.0, 0.0], [5.0, 0.0]])), [True, False])
    assert area_of(ribbon(np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0]]), 3.0)) == pytest.approx(60)
