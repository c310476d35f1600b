"""Templates of many channels: against a direct sum, at known displacements, and how far a place stands out."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import fourier_shift, gaussian_filter

from featreg.sar import template_correlation
from featreg.sar.correlation import Peaks, peaks
from featreg.sar.template_correlation import best_places, runner_up
from featreg.types import FloatArray

F32 = NDArray[np.float32]
SIDE, REACH = 17, 6


def channels(shift: tuple[float, float] = (0.0, 0.0)) -> F32:
    """(3, 60, 70) smooth periodic channels, moved by (x, y) px."""
    noise = np.random.default_rng(1).normal(size=(3, 60, 70))
    planes = [
        np.fft.ifft2(fourier_shift(np.fft.fft2(gaussian_filter(plane, 1.5, mode="wrap")), shift[::-1])).real
        for plane in noise
    ]
    return np.asarray(planes, np.float32)


def widened(planes: F32) -> F32:
    return np.pad(planes, ((0, 0), (REACH, REACH), (REACH, REACH)))


CORNERS = np.array([[0, 0], [20, 10], [53, 43], [7, 31]])


def test_the_surface_is_that_of_the_direct_sum() -> None:
    here, there = channels(), widened(channels((1.0, -2.0)))
    found = best_places(here, there, CORNERS, SIDE, REACH, 2)
    direct = np.zeros((len(CORNERS), 2 * REACH + 1, 2 * REACH + 1))
    for row, (x, y) in enumerate(CORNERS):
        template = here[:, y : y + SIDE, x : x + SIDE].astype(np.float64)
        areas = np.lib.stride_tricks.sliding_window_view(there, (SIDE, SIDE), (1, 2))
        area = areas[:, y : y + 2 * REACH + 1, x : x + 2 * REACH + 1].astype(np.float64)
        energy = (area**2).sum(axis=(0, 3, 4))
        energy = np.maximum(energy, 0.3 * energy.max()) * (template**2).sum()
        direct[row] = np.einsum("kij,kvuij->vu", template, area) / np.sqrt(energy)
    wanted = peaks(direct)
    assert np.allclose(found.peaks.height, wanted.height, atol=1e-4)
    assert np.allclose(found.peaks.shift, wanted.shift, atol=1e-3)
    assert np.allclose(found.runner_up, runner_up(direct, 2), atol=1e-4)


@pytest.mark.parametrize("shift", [(3.0, -4.0), (0.3, 1.6)])
def test_a_known_displacement_is_found_to_a_fraction_of_a_pixel(shift: tuple[float, float]) -> None:
    found = best_places(channels(), widened(channels(shift)), CORNERS[1:2], SIDE, REACH, 2)
    assert found.peaks.sound.all()
    assert np.abs(found.peaks.shift - shift).max() < 0.05
    assert found.runner_up.max() < 0.7


def test_large_surfaces_are_kept_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    here, there = channels(), widened(channels((1.0, -2.0)))
    whole = best_places(here, there, CORNERS, SIDE, REACH, 2)
    seen: list[int] = []

    def counted(values: FloatArray) -> Peaks:
        seen.append(len(values))
        return peaks(values)

    monkeypatch.setattr(template_correlation, "BATCH_BYTES", 1)
    monkeypatch.setattr(template_correlation, "peaks", counted)
    single = best_places(here, there, CORNERS, SIDE, REACH, 2)
    assert seen == [1] * len(CORNERS)
    np.testing.assert_array_equal(single.peaks.shift, whole.peaks.shift)
    np.testing.assert_array_equal(single.runner_up, whole.runner_up)


def test_the_best_place_elsewhere_over_the_peak() -> None:
    surfaces = np.zeros((3, 9, 9))
    surfaces[0, 4, 4], surfaces[0, 4, 5], surfaces[0, 0, 8] = 1.0, 0.9, 0.6
    surfaces[1, 0, 0], surfaces[1, 2, 2], surfaces[1, 3, 0] = 0.5, 0.45, 0.25
    surfaces[2] = -1.0
    assert runner_up(surfaces, 2).tolist() == pytest.approx([0.6, 0.5, 0.0])


def test_no_template_has_no_place() -> None:
    found = best_places(channels(), widened(channels()), np.zeros((0, 2), np.int64), SIDE, REACH, 2)
    assert found.peaks.shift.shape == (0, 2)
    assert found.runner_up.shape == (0,)
