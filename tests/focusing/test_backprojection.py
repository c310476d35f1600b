"""Back-projection: where points focus, how wide, how strong, and that every path computes the same sums."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.errors import ParameterError
from featreg.focusing.backprojection import SPEED_OF_LIGHT as C
from featreg.focusing.backprojection import Window, back_project, carrier
from featreg.focusing.ground_grid import GroundGrid
from featreg.focusing.phase_history import PhaseHistory
from featreg.focusing.phase_history_files import read_phase_history
from made.phase_histories import BAND, COUNT, ELEVATION, GRID, LOW, PULSES, SMALL, SPAN, echoes

# Width at half power, in units of the reciprocal of the extent, of the transform of a window.
WIDTHS = {"none": 0.886, "hamming": 1.303, "hann": 1.441}


def peak(pixels: NDArray[Any]) -> tuple[int, int]:
    row, col = np.unravel_index(np.abs(pixels).argmax(), pixels.shape)
    return int(col), int(row)


def by_loop(h: PhaseHistory, grid: GroundGrid, upsampling: int | None) -> NDArray[np.complex128]:
    """The image by plain loops with Hamming weights: the matched filter, or its interpolation of range profiles."""

    def hamming(place: NDArray[Any]) -> NDArray[Any]:
        weights = 0.54 - 0.46 * np.cos(2 * np.pi * place)
        return np.asarray(weights / weights.sum())

    step = (h.frequencies[-1] - h.frequencies[0]) / (COUNT - 1)
    middle = h.frequencies[0] + step * (COUNT // 2)
    across = hamming(np.linspace(0, 1, COUNT))
    along = hamming((h.azimuth_deg - h.azimuth_deg.min()) / np.ptp(h.azimuth_deg))
    rows, cols = grid.shape
    image = np.zeros(grid.shape, np.complex128)
    for row in range(rows):
        for col in range(cols):
            x, y = (col - (cols - 1) / 2) * grid.spacing, ((rows - 1) / 2 - row) * grid.spacing
            for p in range(len(h)):
                d = np.linalg.norm(h.positions[p] - [x, y, grid.height]) - h.r0[p]
                weighted = h.samples[p] * across * along[p]
                turns = 4j * np.pi * (h.frequencies - middle) / C
                if upsampling is None:
                    value = (weighted * np.exp(turns * d)).sum()
                else:
                    bin_m = C / (2 * step * COUNT * upsampling)
                    left = np.floor(d / bin_m)
                    at, after = ((weighted * np.exp(turns * (left + k) * bin_m)).sum() for k in (0, 1))
                    value = at + (d / bin_m - left) * (after - at)
                image[row, col] += value * np.exp(4j * np.pi * middle * d / C)
    return image


def busy() -> PhaseHistory:
    """Five points, few pulses."""
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-1.2, 1.2, (5, 2)), np.zeros(5)])
    return echoes(points, rng.normal(size=5) + 1j * rng.normal(size=5), pulses=7)


def test_a_point_focuses_where_it_stands_with_its_amplitude_and_phase() -> None:
    place = GRID.to_ground(np.array([[37.0, 8.0]]))[0]
    image = back_project(echoes([*place, 0.0], 2 * np.exp(0.7j)), GRID)
    assert peak(image.pixels) == (37, 8)
    assert place[0] > 0
    assert place[1] > 0  # right of the middle and above it
    np.testing.assert_allclose(image.pixels[8, 37], 2 * np.exp(0.7j), atol=0.01)
    assert image.is_complex
    assert image.all_valid


@pytest.mark.parametrize("window", ["none", "hamming", "hann"])
@pytest.mark.parametrize("axis", ["range", "azimuth"])
def test_the_mainlobe_is_as_wide_as_theory_says(window: Window, axis: str) -> None:
    h = echoes([0.0, 0.0, 0.0], 1.0)
    if axis == "range":
        extent = 2 * BAND * COUNT / (COUNT - 1) * np.cos(ELEVATION) / C
    else:
        centre = LOW + BAND / 2
        extent = 2 * centre * np.cos(ELEVATION) * np.deg2rad(SPAN) * PULSES / (PULSES - 1) / C
    # A row of the turned grid runs along ground range, a column along cross-range.
    line = (1, 401) if axis == "range" else (401, 1)
    fine = GroundGrid(line, spacing=0.01, turn_deg=20.0)
    power = np.abs(back_project(h, fine, range_window=window, azimuth_window=window).pixels.ravel()) ** 2
    above = np.flatnonzero(power > power.max() / 2)
    assert 200 in above
    assert (above[-1] - above[0] + 1) * 0.01 == pytest.approx(WIDTHS[window] / extent, rel=0.1)


def test_the_image_is_linear_in_the_samples() -> None:
    first, second = echoes([0.5, 0.3, 0.0], 1.0), echoes([-1.0, 0.6, 0.0], 2j)
    images = [back_project(h, GRID).pixels for h in (first, second)]
    both = replace(first, samples=3j * first.samples + second.samples)
    np.testing.assert_allclose(back_project(both, GRID).pixels, 3j * images[0] + images[1], atol=1e-5)


def test_a_moved_target_moves_in_the_image_and_a_moved_grid_moves_it_back() -> None:
    start = peak(back_project(echoes([0.0, 0.0, 0.0], 1.0), GRID).pixels)
    moved = echoes([6 * 0.15, 4 * 0.15, 0.0], 1.0)
    assert start == (25, 20)
    assert peak(back_project(moved, GRID).pixels) == (31, 16)
    followed = back_project(moved, replace(GRID, centre=(6 * 0.15, 4 * 0.15))).pixels
    assert peak(followed) == start
    assert abs(followed[start[1], start[0]]) == pytest.approx(1.0, abs=0.01)


def test_a_turned_grid_sees_the_scene_turned_the_other_way() -> None:
    h = echoes([1.5, 0.0, 0.0], 1.0)
    turned = replace(GRID, turn_deg=90.0)
    # The image's +x is ground +y, so ground +x points down.
    assert peak(back_project(h, turned).pixels) == (25, 30)
    xy = np.array([[25.0, 30.0], [3.5, 7.25]])
    np.testing.assert_allclose(turned.to_ground(xy)[0], [1.5, 0.0], atol=1e-12)
    for grid in (GRID, turned, replace(GRID, turn_deg=33.0, centre=(4.0, -9.0))):
        np.testing.assert_allclose(grid.to_pixels(grid.to_ground(xy)), xy, atol=1e-9)
        np.testing.assert_allclose(grid.row_starts[7] + 3 * grid.step, grid.to_ground(np.array([[3.0, 7.0]]))[0])


def test_a_raised_target_lies_over_towards_the_radar_unless_the_grid_is_raised_too() -> None:
    h = echoes([0.0, 0.0, 1.2], 1.0, middle_deg=0.0)
    assert peak(back_project(h, replace(GRID, height=1.2)).pixels) == (25, 20)
    layover = 1.2 * np.tan(ELEVATION) / GRID.spacing
    col, row = peak(back_project(h, GRID).pixels)
    assert row == 20
    assert col - 25 == pytest.approx(layover, abs=1)


def test_the_kernel_equals_a_plain_loop() -> None:
    h = busy()
    image = back_project(h, SMALL, upsampling=16).pixels
    # 1024 = 16 * 64 samples are a fast length, so that the profiles are the same.
    np.testing.assert_allclose(image, by_loop(h, SMALL, 16), atol=3e-6)


@pytest.mark.parametrize(("upsampling", "error"), [(4, 0.1), (16, 6e-3), (64, 5e-4)])
def test_interpolation_comes_to_the_matched_filter(upsampling: int, error: float) -> None:
    h = busy()
    exact = by_loop(h, SMALL, None)
    image = back_project(h, SMALL, upsampling=upsampling).pixels
    assert np.abs(image - exact).max() < error * np.abs(exact).max()


def test_threads_change_no_bit() -> None:
    h = echoes([[0.5, 0.3, 0.0], [-1.0, 0.6, 0.0]], [1.0, 2j], pulses=300)
    one, three = (back_project(h, GRID, workers=n).pixels for n in (1, 3))
    np.testing.assert_array_equal(one, three)


def test_pulses_may_come_in_any_order() -> None:
    h = echoes([0.5, 0.3, 0.0], 1.0, pulses=300)  # more than stand in memory at a time
    mixed = h.take(np.random.default_rng(1).permutation(len(h)))
    np.testing.assert_allclose(back_project(mixed, GRID).pixels, back_project(h, GRID).pixels, atol=1e-5)


def test_the_aperture_may_cross_azimuth_zero() -> None:
    place = [0.75, 0.3, 0.0]
    image = back_project(echoes(place, 1.0, middle_deg=0.0), GRID)
    assert abs(image.pixels[18, 30]) == pytest.approx(1.0, abs=0.01)


def test_beyond_the_unambiguous_range_there_is_nothing() -> None:
    h = echoes([0.0, 0.0, 0.0], 1.0, middle_deg=0.0)
    reach = C * (COUNT - 1) / BAND / 4 / np.cos(ELEVATION)  # 7.9 m of slant range, on the ground
    row = back_project(h, GroundGrid((1, 401), spacing=0.1), range_window="none").pixels[0]
    x = (np.arange(401) - 200) * 0.1
    assert (row[np.abs(x) > reach + 0.1] == 0).all()
    assert (row[np.abs(x) < reach - 0.1] != 0).all()


def test_the_carrier_taken_out_leaves_a_point_in_one_phase() -> None:
    h = echoes([0.45, -0.3, 0.0], 1.0)
    grid = replace(GRID, turn_deg=20.0)
    image, factor = back_project(h, grid).pixels, carrier(h, grid)
    np.testing.assert_allclose(np.abs(factor), 1, atol=1e-6)
    assert factor.dtype == np.complex64
    assert carrier(h, GroundGrid((1, 1)))[0, 0] == pytest.approx(1.0, abs=1e-4)
    bright = np.abs(image) > 0.5 * np.abs(image).max()
    calm, raw = ((values / np.abs(values))[bright].mean() for values in (image * factor, image))
    assert bright.sum() > 9
    assert abs(calm) > 0.98
    assert abs(raw) < 0.5
    # The pulses are then the columns' spectrum: centred on zero, and no wider than the aperture.
    power = np.fft.fftshift((np.abs(np.fft.fft(image * factor, axis=0)) ** 2).sum(axis=1))
    place = np.fft.fftshift(np.fft.fftfreq(grid.shape[0], grid.spacing))
    extent = 2 * (LOW + BAND / 2) * np.cos(ELEVATION) * np.deg2rad(SPAN) / C
    assert abs((power * place).sum() / power.sum()) < 0.05 * extent
    assert power[np.abs(place) < 0.6 * extent].sum() > 0.97 * power.sum()


def test_a_phase_error_of_the_pulses_stands_in_the_columns_spectrum() -> None:
    """What autofocus in the image domain rests on: one row of the columns' FFT is one pulse."""
    rng = np.random.default_rng(2)
    h = echoes(np.column_stack([rng.uniform(-1, 1, (6, 2)), np.zeros(6)]), np.ones(6))
    grid = GroundGrid((121, 81), spacing=0.1, turn_deg=20.0)
    # It vanishes at both ends, so that the image does not move.
    error = 1.5 * np.sin(np.deg2rad(h.relative_azimuth_deg) * 2 * np.pi / np.deg2rad(SPAN))
    disturbed = replace(h, samples=h.samples * np.exp(1j * error)[:, None])
    clean, found = (np.fft.fft(back_project(each, grid).pixels * carrier(h, grid), axis=0) for each in (h, disturbed))
    phase = np.angle((found * clean.conj()).sum(axis=1))
    sine = np.fft.fftfreq(grid.shape[0], grid.spacing) * C / (2 * (LOW + BAND / 2) * np.cos(ELEVATION))
    azimuth = np.rad2deg(np.arcsin(np.clip(sine, -1, 1)))
    support = np.abs(azimuth) < 0.4 * SPAN
    assert support.sum() > 8
    expected = np.interp(azimuth[support], h.relative_azimuth_deg, error)
    np.testing.assert_allclose(phase[support], expected, atol=0.15)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"range_window": "haming"}, "range_window' must be 'hamming'"),
        ({"azimuth_window": "taylor"}, "got 'taylor'"),
        ({"backend": "jax"}, "'numba' or 'torch', got 'jax'"),
        ({"upsampling": 0}, "of at least 1"),
        ({"workers": 0}, "at least 1|>= 1"),
        ({"device": "cuda"}, "needs backend='torch'"),
    ],
)
def test_impossible_parameters(keywords: dict[str, Any], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        back_project(busy(), SMALL, **keywords)


@pytest.mark.parametrize("wrong", [{"shape": (0, 5)}, {"spacing": 0.0}, {"spacing": np.nan}, {"height": np.inf}])
def test_impossible_grids(wrong: dict[str, Any]) -> None:
    with pytest.raises(ParameterError):
        GroundGrid(**wrong)


@pytest.mark.realdata
def test_exact_ranges_sharpen_the_real_image(realdata: Path) -> None:
    """The files' float32 ranges are rounded by a fair part of the wavelength; see `read_phase_history`."""
    h = read_phase_history(realdata / "gotcha", azimuth=(1, 2))
    grid = GroundGrid((301, 301))

    def entropy(history: PhaseHistory) -> float:
        power = np.abs(back_project(history, grid).pixels).astype(np.float64) ** 2
        power /= power.sum()
        return float(-(power * np.log(power + 1e-30)).sum())

    rounded = replace(h, r0=h.r0.astype(np.float32).astype(np.float64))
    assert entropy(h) < entropy(rounded) - 0.02
