"""The double-angle field, its global search and its windows: turns, contrast, masks, known displacements."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import gamma

from featreg.sar.gradients.ratio import roewa
from featreg.sar.orientation import orientation_kernels as kernels
from featreg.sar.orientation.field import field_of, orientation_field, turned
from featreg.sar.orientation.levels import aligned
from featreg.sar.orientation.search import Grid, scale_steps, search
from featreg.sar.orientation.windows import (
    Surfaces,
    _by_spectra,
    _directly,
    _log10_gamma_tail,
    correlated,
    log10_chance,
    together,
)
from featreg.simulate import sar_pair
from made.images import image_of

F32 = NDArray[np.float32]


@pytest.fixture(scope="module")
def scene() -> F32:
    return np.asarray(sar_pair((240, 240), looks=4, seed=3).reference, np.float32)


def inside(field: F32, margin: int = 20) -> F32:
    return field[margin:-margin, margin:-margin]


def test_a_quarter_turn_turns_the_field_by_half_a_turn(scene: F32) -> None:
    field, other = field_of(scene, 3.0), field_of(np.ascontiguousarray(np.rot90(scene)), 3.0)
    expected = turned(np.ascontiguousarray(np.rot90(field)), 90)
    # The median is that of a sample, which a turn changes.
    assert np.abs(inside(other - expected)).max() < 0.02
    assert np.abs(turned(field, 180) - field).max() < 1e-6


@pytest.mark.parametrize(("shape", "alpha"), [((203, 71), 0.8), ((150, 60), 3.0), ((13, 40), 6.0)])
def test_strips_give_the_field_of_the_whole(scene: F32, shape: tuple[int, int], alpha: float) -> None:
    view = np.ascontiguousarray(scene[: shape[0], : shape[1]])
    gx, gy = roewa(view, alpha)
    step = max(1, math.isqrt(view.size // 5000))
    strength = (gx**2 + gy**2)[::step, ::step]
    expected = (gx + 1j * gy) ** 2 / (gx**2 + gy**2 + np.median(strength[strength > 0]))
    rim = math.ceil(alpha)
    found = field_of(view, alpha)
    for part, axis in ((expected.real, 0), (expected.imag, 1)):
        assert np.abs(found[..., axis] - part)[rim:-rim, rim:-rim].max() < 2e-5
    assert not found[:rim].any()


def test_reversed_contrast_leaves_the_field(scene: F32) -> None:
    smooth = cv2.GaussianBlur(scene, (0, 0), 4) + 0.1 * scene.mean()
    field, reversed_ = (inside(field_of(np.asarray(view, np.float32), 3.0)) for view in (smooth, 1 / smooth))
    likeness = np.vdot(field, reversed_) / math.sqrt(np.vdot(field, field) * np.vdot(reversed_, reversed_))
    assert likeness > 0.95


def test_gain_leaves_the_field_and_its_length_stays_below_one(scene: F32) -> None:
    field = field_of(scene, 3.0)
    assert np.abs(field_of(scene * np.float32(37), 3.0) - field).max() < 1e-3
    assert np.hypot(field[..., 0], field[..., 1]).max() < 1


def test_nothing_is_seen_in_nodata_at_the_border_or_where_all_is_equal(scene: F32) -> None:
    mask = np.ones(scene.shape, np.bool_)
    mask[60:120, 80:150] = False
    field = orientation_field(image_of(scene, mask), 3.0)
    near = cv2.dilate((~mask).astype(np.uint8), np.ones((11, 11), np.uint8)) > 0
    assert not field[near].any()
    assert not field[:3].any()
    assert not field[:, -3:].any()
    assert not field_of(np.full((50, 60), 3, np.float32), 3.0).any()


def test_cross_spectra_are_those_of_turned_maps() -> None:
    rng = np.random.default_rng(0)
    n = 16
    a, b = (rng.normal(size=(n, n)) + 1j * rng.normal(size=(n, n)) for _ in range(2))
    real, imaginary = (np.fft.fft2(part).astype(np.complex64) for part in (a.real, a.imag))
    out = np.empty((n, n), np.complex64)
    at = np.arange(n)
    for quarter in (False, True):
        kernels.cross_spectra(real, imaginary, np.fft.fft2(b).astype(np.complex64), quarter, np.float32(1), out)
        found = np.fft.ifft2(out)
        # b at (x, y) -> (-y, x), all modulo n.
        second = b[at[None, :], -at[:, None] % n] if quarter else b
        for part, other in ((found.real, second), (found.imag, second[-at[:, None] % n, -at[None, :] % n])):
            direct = [[np.sum(a * np.roll(other, (y, x), (0, 1)).conj()).real for x in range(n)] for y in range(n)]
            np.testing.assert_allclose(part, direct, atol=2e-3)


def test_highest_is_the_largest_value_over_its_noise() -> None:
    rng = np.random.default_rng(1)
    found = rng.normal(size=(12, 12, 2)).astype(np.float32)
    energy = rng.uniform(0.5, 2, (6, 6, 2)).astype(np.float32)
    best = np.empty((2, 3))
    kernels.highest(found, energy, np.float32(1), best)
    full = np.repeat(np.repeat(energy, 2, 0), 2, 1)
    scores = np.where(full < 1, -np.inf, found / np.sqrt(full / 2))
    for k in (0, 1):
        row, col = np.unravel_index(scores[..., k].argmax(), (12, 12))
        np.testing.assert_allclose(best[k], [scores[row, col, k], row, col], rtol=1e-5)


@pytest.mark.parametrize(("rotation", "scale"), [(0.0, 1.0), (137.0, 1.0), (-61.0, 1.5), (20.0, 0.62)])
def test_search_finds_any_rotation_and_scale(rotation: float, scale: float) -> None:
    pair = sar_pair((300, 300), looks=1, rotation_deg=rotation, scale=scale, shift=(25, -12), seed=5)
    found = search(image_of(pair.reference), image_of(pair.secondary), Grid(48, 7.5, scale_steps(2.0, 1.15)), most=3)
    xy = np.array([[60.0, 60], [240, 60], [60, 240], [240, 240]])
    off = np.hypot(
        *(xy @ found[0].affine[:, :2].T + found[0].affine[:, 2] - (xy @ pair.truth[:, :2].T + pair.truth[:, 2])).T
    )
    assert off.max() < 20 * max(scale, 1)
    assert found[0].score > 1.25 * found[1].score


def test_search_of_nothing_is_empty() -> None:
    flat = image_of(np.ones((80, 80)))
    assert search(flat, flat, Grid(), most=3) == []
    hidden = image_of(np.ones((80, 80)), np.zeros((80, 80), np.bool_))
    assert search(hidden, flat, Grid(), most=3) == []


def test_scales_begin_at_one_and_reach_both_ends() -> None:
    steps = scale_steps(2.0, 1.15)
    assert steps[0] == 1.0
    assert (min(steps), max(steps)) == pytest.approx((0.5, 2.0))
    assert np.diff(np.log(sorted(steps))).max() <= math.log(1.15)
    assert scale_steps(1.0, 1.1) == (1.0,)


def test_windows_measure_a_shift_and_leave_out_what_is_not_there(scene: F32) -> None:
    mask = np.ones(scene.shape, np.bool_)
    mask[:100, :100] = False
    shifted = np.array([[1.0, 0, 5], [0, 1, -3]])
    level = aligned(image_of(scene), image_of(scene, mask), shifted, 240, 2.0)
    found = correlated(level, 32, 8)
    best = found.values.reshape(len(found), -1).argmax(axis=1)
    # The secondary sampled 5 to the right and 3 above shows each structure 5 to the left and 3 below.
    assert np.mean((best % 17 - 8 == -5) & (best // 17 - 8 == 3)) > 0.95
    assert found.xy.min() >= 15
    assert not ((found.xy < 80).all(axis=1)).any()
    _, within = together(found, 3.0, 0.05, 5)
    np.testing.assert_allclose(within, [[1, 0, -5], [0, 1, 3]], atol=1e-9)
    np.testing.assert_allclose(level.moved(within), [[1, 0, 0], [0, 1, 0]], atol=1e-9)


@pytest.mark.parametrize(("side", "reach"), [(32, 6), (48, 8), (21, 3)])
def test_sums_of_products_are_what_spectra_give(scene: F32, side: int, reach: int) -> None:
    mask = np.ones(scene.shape, np.bool_)
    mask[:90, 100:] = False
    level = aligned(image_of(scene), image_of(scene, mask), np.array([[1.0, 0, 2], [0, 1, 1]]), 240, 1.2)
    # In the corners a part of the displaced window lies outside.
    at = np.array([[0, 0], [0, 240 - side], [240 - side, 0], [240 - side, 240 - side], [80, 91], [97, 120]])
    found, expected = (np.zeros((len(at), 2 * reach + 1, 2 * reach + 1), np.float32) for _ in range(2))
    _directly(level, at, side, reach, found)
    _by_spectra(level, at, side, reach, expected)
    assert np.abs(expected).max() > 0.5
    np.testing.assert_allclose(found, expected, atol=3e-6)


def test_a_share_counts_the_places_near_which_a_surface_is_as_high() -> None:
    rng = np.random.default_rng(4)
    surfaces = rng.normal(size=(5, 15, 15)).astype(np.float32)
    for margin in (1, 2):
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * margin + 1,) * 2)
        at, shares = rng.integers(0, 15 - 2 * margin, (5, 2)), np.empty(5)
        kernels.shares_as_high(surfaces.ravel(), 15, np.argwhere(disc)[:, ::-1] - margin, margin, at, shares)
        for values, (x, y), share in zip(surfaces, at, shares, strict=True):
            around = cv2.dilate(values, disc)[margin:-margin, margin:-margin]
            assert share == np.mean(around >= around[y, x])


def test_stacked_sums_what_each_surface_holds_where_it_is_moved() -> None:
    rng = np.random.default_rng(2)
    surfaces = rng.normal(size=(3, 7, 7)).astype(np.float32)
    moves = rng.integers(-2, 3, (4, 3, 2))
    out = np.empty((4, 3))
    kernels.stacked(surfaces, moves, out)
    for h in range(4):
        total = np.zeros((7, 7))
        for i, (x, y) in enumerate(moves[h]):
            padded = np.pad(surfaces[i], 3)
            total += padded[3 + y : 10 + y, 3 + x : 10 + x]
        row, col = np.unravel_index(total.argmax(), (7, 7))
        np.testing.assert_allclose(out[h], [total[row, col], row - 3, col - 3], rtol=1e-5)


def test_chance_is_fishers() -> None:
    rng = np.random.default_rng(4)
    values = rng.normal(size=(20, 25, 25)).astype(np.float32)
    of_noise = log10_chance(Surfaces(np.zeros((20, 2)), values, np.ones(20), 16), 1)
    assert -3 < of_noise <= 0
    values[:, 12, 12] += 10
    of_peaks = log10_chance(Surfaces(np.zeros((20, 2)), values, np.ones(20), 16), 1)
    # Five of 23^2 positions see the peak: the disc of one pixel around each is a cross.
    assert of_peaks == pytest.approx(gamma.logsf(20 * math.log(23**2 / 5), 20) / math.log(10), abs=1e-6)
    assert _log10_gamma_tail(7.5, 4) == pytest.approx(gamma.logsf(7.5, 4) / math.log(10))
    assert log10_chance(Surfaces(np.zeros((0, 2)), values[:0], np.zeros(0), 16), 1) == 0
