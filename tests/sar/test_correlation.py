"""Dense local correlation against a direct one in numpy, and peaks at known sub-pixel shifts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.errors import ParameterError
from featreg.runtime.threads import limited_threads
from featreg.sar.correlation import local_correlations, peaks, peaks_near, peaks_uphill, quadratic_steps

Texture = Callable[..., NDArray[np.float32]]
F32 = NDArray[np.float32]


def grid_points(shape: tuple[int, int], reach: int, n: int = 40, seed: int = 0) -> NDArray[np.int64]:
    rng = np.random.default_rng(seed)
    inner = [rng.integers(reach + 1, size - reach - 1, n) for size in shape[::-1]]
    return np.column_stack(inner)


def direct(a: F32, b: F32, x: int, y: int, dx: int, dy: int, half: int) -> float:
    p = a[y - half : y + half + 1, x - half : x + half + 1].astype(np.float64)
    q = b[y + dy - half : y + dy + half + 1, x + dx - half : x + dx + half + 1].astype(np.float64)
    p, q = p - p.mean(), q - q.mean()
    return float((p * q).sum() / np.sqrt((p**2).sum() * (q**2).sum()))


def smooth(height: int, width: int, shift: tuple[float, float] = (0.0, 0.0), seed: int = 0) -> F32:
    """A smooth periodic texture, moved by `shift` (x, y) pixels without interpolation error."""
    from scipy.ndimage import fourier_shift, gaussian_filter

    noise = np.random.default_rng(seed).normal(size=(height, width))
    spectrum = np.fft.fft2(gaussian_filter(noise, 1.5, mode="wrap"))
    moved = np.fft.ifft2(fourier_shift(spectrum, shift[::-1])).real
    return np.asarray(moved / moved.std(), np.float32)


@pytest.mark.parametrize(("half", "search"), [(4, 2), (12, 3), (24, 1), (36, 4)])
@pytest.mark.parametrize("offset", [0.0, 30.0])
@pytest.mark.parametrize("few", [0.0, 1e9])
def test_equals_the_direct_correlation(
    sar_texture: Texture, half: int, search: int, offset: float, few: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both ways to sum: running down the image, and window by window."""
    monkeypatch.setattr("featreg.sar.correlation.FEW", few)
    a = np.log(sar_texture(90, 130, seed=1) + 0.01) + np.float32(offset)
    b = np.log(sar_texture(90, 130, seed=1, looks=6) + 0.01) - np.float32(offset)
    xy = grid_points(a.shape, half + search)
    found = local_correlations(a, b, xy, half, search)
    assert found.shape == (len(xy), 2 * search + 1, 2 * search + 1)
    shifts = range(-search, search + 1)
    wanted = [[[direct(a, b, x, y, dx, dy, half) for dx in shifts] for dy in shifts] for x, y in xy.tolist()]
    np.testing.assert_allclose(found, wanted, atol=2e-4)


def test_many_rows_do_not_add_up_rounding_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Running sums down 3000 rows, with a bright band at the top."""
    monkeypatch.setattr("featreg.sar.correlation.FEW", 0.0)
    a = smooth(3000, 64)
    a[:200] *= 100
    xy = np.array([[32, 2900], [30, 2950]])
    found = local_correlations(a, a, xy, 10, 2)
    np.testing.assert_allclose(found[:, 2, 2], 1.0, atol=1e-3)


def test_the_order_of_the_points_does_not_matter(sar_texture: Texture) -> None:
    a, b = sar_texture(80, 80), sar_texture(80, 80, seed=1)
    xy = grid_points(a.shape, 12)
    order = np.random.default_rng(0).permutation(len(xy))
    np.testing.assert_array_equal(
        local_correlations(a, b, xy[order], 9, 2), local_correlations(a, b, xy, 9, 2)[order]
    )  # fmt: skip


def test_gain_and_offset_drop_out(sar_texture: Texture) -> None:
    a, b = sar_texture(80, 80), sar_texture(80, 80, looks=9)
    xy = grid_points(a.shape, 12)
    np.testing.assert_allclose(
        local_correlations(a, b, xy, 9, 2), local_correlations(a * 7 + 3, b * 0.5 - 2, xy, 9, 2), atol=1e-3
    )


@pytest.mark.parametrize("level", [0.0, -4.6, 3.7])
def test_a_constant_window_correlates_with_nothing(sar_texture: Texture, level: float) -> None:
    """Flat shadow beside texture: the whole image varies, the window does not."""
    a, b = np.log(sar_texture(100, 120) + 0.1), np.log(sar_texture(100, 120, seed=1) + 0.1)
    a[:, :60] = level
    flat, lively = np.array([[25, 40], [30, 60]]), np.array([[95, 40]])
    for one, other in ((a, b), (b, a), (a, a)):
        np.testing.assert_array_equal(local_correlations(one, other, flat, 12, 2), 0)
        assert np.abs(local_correlations(one, other, lively, 12, 2)).max() <= 1 + 1e-4


def test_a_search_around_other_points_has_a_limit(sar_texture: Texture) -> None:
    a, at = sar_texture(80, 90), np.array([[44, 40]])
    with pytest.raises(ParameterError, match="at most 28 px, got 29"):
        local_correlations(a, a, at, 5, 29, at)
    found = local_correlations(a, a, at, 5, 29)
    assert found[0, 29, 29] == pytest.approx(1, abs=1e-5)


def test_no_points_give_no_correlations(sar_texture: Texture) -> None:
    found = local_correlations(sar_texture(80, 80), sar_texture(80, 80), np.zeros((0, 2), np.int64), 9, 2)
    assert found.shape == (0, 5, 5)
    assert peaks(found).shift.shape == (0, 2)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.3, -0.4), (1.5, 0.25), (-1.2, 1.7)])
def test_peaks_lie_at_the_shift_to_two_hundredths_of_a_pixel(shift: tuple[float, float]) -> None:
    a, b = smooth(200, 200), smooth(200, 200, shift)
    xy = grid_points(a.shape, 28)
    found = peaks(local_correlations(a, b, xy, 24, 3))
    assert found.sound.all()
    assert found.height.min() > 0.8
    error = found.shift - shift
    assert np.sqrt((error**2).sum(axis=1).mean()) < 0.02
    np.testing.assert_allclose(error.mean(axis=0), 0, atol=0.01)


def test_mirrored_maps_give_mirrored_shifts() -> None:
    a, b = smooth(120, 130), smooth(120, 130, (0.6, -0.3))
    xy = grid_points(a.shape, 20)
    plain = peaks(local_correlations(a, b, xy, 15, 2))
    there = np.column_stack([129 - xy[:, 0], xy[:, 1]])
    mirrored = peaks(
        local_correlations(np.ascontiguousarray(a[:, ::-1]), np.ascontiguousarray(b[:, ::-1]), there, 15, 2)
    )
    np.testing.assert_allclose(mirrored.shift, plain.shift * [-1, 1], atol=1e-3)


def test_a_quadratic_is_met_exactly() -> None:
    y, x = np.mgrid[-3:4, -3:4].astype(np.float64)
    dx, dy = x - 0.8, y + 1.3
    found = peaks((0.9 - 0.02 * dx**2 - 0.03 * dy**2 + 0.01 * dx * dy)[None])
    np.testing.assert_allclose(found.shift, [[0.8, -1.3]], atol=1e-9)
    np.testing.assert_allclose(found.curvature, [[[0.04, -0.01], [-0.01, 0.06]]], atol=1e-9)
    assert found.sound.all()


def test_a_peak_at_the_edge_of_the_search_or_a_ridge_is_not_sound() -> None:
    y, x = np.mgrid[-3:4, -3:4].astype(np.float64)
    edge, ridge, flat = 0.1 * x - 0.01 * y**2, 0.5 - 0.01 * (x - y) ** 2, np.zeros((7, 7))
    assert not peaks(np.stack([edge, ridge, flat])).sound.any()


@pytest.mark.parametrize("side", [3, 5, 7])
def test_peaks_equal_the_plain_ones(side: int) -> None:
    """The highest value and the quadratic through its neighbours, for all points at once."""
    rng = np.random.default_rng(side)
    values = rng.normal(size=(300, side, side)).round(1 if side == 5 else 15)
    values[:20] = 0.5
    best = values.reshape(300, -1).argmax(axis=1)
    row, col = best // side, best % side
    inside = (row % (side - 1) > 0) & (col % (side - 1) > 0)
    r, c = (np.clip(at, 1, side - 2) for at in (row, col))
    nine = np.stack([part[y - 1 : y + 2, x - 1 : x + 2] for part, y, x in zip(values, r, c, strict=True)])
    step, curvature, curved = quadratic_steps(nine)
    sound = inside & curved
    found = peaks(values)
    np.testing.assert_array_equal(found.sound, sound)
    np.testing.assert_array_equal(found.height, values.reshape(300, -1).max(axis=1))
    np.testing.assert_allclose(found.curvature, curvature, rtol=0, atol=1e-14)
    wanted = np.column_stack([col, row]) - side // 2 + np.where(sound[:, None], step, 0)
    np.testing.assert_allclose(found.shift, wanted, rtol=0, atol=1e-10)


def climbed_by_rounds(
    first: F32, second: F32, xy: NDArray[np.int64], there: NDArray[np.int64], half: int, search: int, apart: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Whole shifts that are reached uphill, all points a step at a time, and the nine correlations around them."""
    now, nine = np.zeros_like(xy), np.zeros((len(xy), 3, 3))
    wide = local_correlations(first, second, xy, half, apart, there)[:, ::apart, ::apart].reshape(-1, 9).argmax(axis=1)
    if apart > 1:
        now = apart * (np.column_stack([wide % 3, wide // 3]) - 1)
    for _ in range(4 * search):
        nine = local_correlations(first, second, xy, half, 1, there + now)
        best = nine.reshape(-1, 9).argmax(axis=1)
        step = now + np.column_stack([best % 3, best // 3]) - 1
        onward = (np.abs(step) <= search).all(axis=1)
        now[onward] = step[onward]
    return now, nine


@pytest.mark.parametrize(("half", "search", "apart"), [(7, 3, 1), (14, 3, 2), (24, 2, 1), (36, 5, 2), (5, 1, 1)])
def test_uphill_is_where_single_steps_lead(half: int, search: int, apart: int) -> None:
    """Also at the rims of the maps, of which the last window ends where the map does."""
    first, second = smooth(150, 160), smooth(150, 160, (1.3, -0.7), seed=0)
    rng = np.random.default_rng(1)
    rim = half + 2 * search + 3
    xy = np.column_stack([rng.integers(rim, size - rim, 60) for size in (160, 150)])
    xy[0] = 160 - rim, 150 - rim
    there = xy + rng.integers(-search, search + 1, xy.shape) * (np.arange(60) % 2)[:, None]
    now, nine = climbed_by_rounds(first, second, xy, there, half, search, apart)
    found = peaks_uphill(first, second, xy, there, np.zeros_like(xy), half, search, apart)
    wanted = peaks(nine)
    np.testing.assert_array_equal(found.sound, wanted.sound)
    np.testing.assert_allclose(found.height, wanted.height, atol=5e-4)
    np.testing.assert_allclose(found.shift, now + wanted.shift, atol=0.02)
    assert wanted.sound.mean() > 0.3


def test_a_window_at_the_end_of_the_maps_is_read_to_its_end() -> None:
    first = smooth(60, 70)
    at = np.array([[70 - 12 - 4, 60 - 12 - 4], [30, 30]])
    found = peaks_uphill(first, first, at, at, np.zeros_like(at), 12, 2)
    np.testing.assert_allclose(found.shift, 0, atol=0.05)
    np.testing.assert_allclose(found.height, 1, atol=1e-12)


@pytest.mark.parametrize("value", [0.0, -4.6])
def test_uphill_a_constant_window_correlates_with_nothing(value: float) -> None:
    first = smooth(80, 120)
    first[:, :60] = value
    at = np.array([[30, 40]])
    found = peaks_uphill(first, first, at, at, np.zeros_like(at), 12, 2)
    assert not found.sound.any()
    assert found.height == 0


@pytest.mark.parametrize("target", [0, 1])
def test_a_faint_window_beside_a_strong_target_keeps_its_place(target: int) -> None:
    """Contrast of 1.5 %, in maps whose range is a thousand times that."""
    first, second = (0.015 * smooth(90, 100, by) / smooth(90, 100).std() + 4 for by in ((0, 0), (0.8, -1.2)))
    at = np.array([[45, 45], [40, 20]])
    plain = peaks(local_correlations(first - 4, second - 4, at, 14, 3))
    # Far away in both maps; and at the rim of what the first point is compared with.
    for part in (first, second):
        part[5, 5] = 20.0
    if target:
        second[45, 45 + 14 + 4] = 20.0
    found = peaks_uphill(first, second, at, at, np.zeros_like(at), 14, 3, 2)
    assert found.sound.all()
    np.testing.assert_allclose(found.height, plain.height, atol=2e-3)
    np.testing.assert_allclose(found.shift, plain.shift, atol=0.01)


def test_large_windows_correlate_as_finely_as_small_ones() -> None:
    first, second = smooth(640, 650), smooth(640, 650, (0.4, 0.3))
    at = np.array([[320, 318], [324, 322]])
    found = peaks_uphill(first, second, at, at, np.zeros_like(at), 300, 1)
    np.testing.assert_allclose(found.height, [direct(first, second, x, y, 0, 0, 300) for x, y in at], atol=1e-4)


@pytest.mark.parametrize("few", [0.0, 1e9])
@pytest.mark.parametrize("shift", [(0.2, -0.3), (1.3, 0.4)])
def test_peaks_near_are_those_of_all_shifts(few: float, shift: tuple[float, float], monkeypatch: Any) -> None:
    monkeypatch.setattr("featreg.sar.correlation.FEW", few)
    first, second = smooth(160, 170), smooth(160, 170, shift)
    xy = grid_points(first.shape, 30)
    wanted, found = peaks(local_correlations(first, second, xy, 24, 2)), peaks_near(first, second, xy, 24, 1)
    assert found.sound.all()
    np.testing.assert_allclose(found.shift, wanted.shift, atol=5e-3)
    np.testing.assert_allclose(found.height, wanted.height, atol=5e-4)


def test_few_windows_give_the_same_bits_on_any_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(2, 120, 130)).astype(np.float32)
    xy = rng.integers(20, 100, (37, 2))
    whole, found = local_correlations(first, second, xy, 9, 2, xy + 1), []
    monkeypatch.setattr("featreg.runtime.threads.LEAST", 1)
    for threads in (1, 2, 3):
        with limited_threads(threads):
            np.testing.assert_array_equal(local_correlations(first, second, xy, 9, 2, xy + 1), whole)
            found.append(peaks_uphill(first, second, xy, xy + 1, np.zeros_like(xy), 9, 2))
    for other in found[1:]:
        np.testing.assert_array_equal(other.shift, found[0].shift)
