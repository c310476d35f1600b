"""The pieces of autofocus: kernels, band, range cells and their groups."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import featreg
from featreg.focusing import autofocus, complex_image
from featreg.focusing.legendre_phase import legendre_basis
from featreg.focusing.phase_error import Band
from featreg.focusing.pulse_spectra import PulseSpectra, grouped, pulse_spectra
from featreg.focusing.range_cells import cell_energies, choose_cells, count_points
from made.blurred_scenes import SIDE, low_contrast, smooth_phase


def test_the_kernels_agree_with_plain_numpy() -> None:
    image = low_contrast().astype(np.complex64)
    cells = pulse_spectra(image, 0, np.arange(20, 60))
    phase = smooth_phase(strength=0.3)
    g = np.fft.ifft(cells.spectra * np.exp(-1j * phase), axis=1, norm="ortho")
    p = np.abs(g) ** 2 * SIDE
    np.testing.assert_allclose(p.mean(axis=1), 1, rtol=1e-4)
    for contrast, weight in ((True, p), (False, np.maximum(np.log(p) + 2, 0))):
        step = cells.step(phase, contrast=contrast, offset=2.0)
        expected = np.sum(cells.spectra * np.conj(np.fft.fft(weight * g, axis=1, norm="ortho")), axis=0)
        np.testing.assert_allclose(step.correlation, expected, atol=1e-4 * np.abs(expected).max())
        assert step.objective == pytest.approx(-float(np.mean(p * np.log(p))), rel=1e-5)


def test_the_unclamped_step_is_the_gradient() -> None:
    cells = pulse_spectra(low_contrast().astype(np.complex64), 0, np.arange(40))
    phase, direction = smooth_phase(), np.random.default_rng(0).normal(size=SIDE)
    step = cells.step(phase, contrast=False, clamped=False)
    slope = -2 * np.imag(step.correlation * np.exp(-1j * phase)) / cells.cells
    h = 2e-2
    rise = cells.criteria(phase + h * direction)[0] - cells.criteria(phase - h * direction)[0]
    assert slope @ direction == pytest.approx(rise / (2 * h), rel=0.02)


@pytest.mark.parametrize("start", [0, 40, 250])
def test_the_band_is_found_wherever_it_lies(start: int) -> None:
    power = np.zeros(300)
    power[(start + np.arange(120)) % 300] = 1.0
    band = Band.of(power)
    np.testing.assert_array_equal(band.order, (start + np.arange(120)) % 300)
    np.testing.assert_allclose(band.place[[0, -1]], [-1, 1])
    line = band.spread(np.asarray(3.0 + 2.5 * np.arange(120), np.float64))
    assert band.difference(line, np.zeros(300)) < 1e-6
    basis = legendre_basis(band, 4)
    assert basis.shape == (300, 3)
    assert not basis[power == 0].any()


def test_cells_are_chosen_by_points_then_energy_and_never_empty_ones() -> None:
    energy = np.array([5.0, 0.0, 3.0, 4.0, 1.0])
    np.testing.assert_array_equal(choose_cells(energy, 0.4), [0, 3])
    np.testing.assert_array_equal(choose_cells(energy, 1.0), [0, 2, 3, 4])
    np.testing.assert_array_equal(choose_cells(energy, 0.4, np.array([0, 9, 2, 2, 5])), [3, 4])
    xy = np.array([[0, 0], [0, 3], [2, 1], [2.4, 0]])
    np.testing.assert_array_equal(count_points(xy, 0, 4), [2, 0, 2, 0])
    np.testing.assert_array_equal(count_points(xy, 1, 4), [2, 1, 0, 1])


def test_cells_that_are_mostly_missing_do_not_count() -> None:
    mask = np.ones((40, 30), np.bool_)
    mask[:30, 5] = False
    energy = cell_energies(np.ones((40, 30), np.complex64), 0, mask)
    np.testing.assert_array_equal(np.flatnonzero(energy == 0), [5])


def test_neighbours_share_a_group_and_halves_share_none() -> None:
    assert grouped([3, 4, 6, 20, 21]) == ((0, 3), (3, 5))
    assert grouped(list(range(16))) == ((0, 8), (8, 16))
    cells: PulseSpectra = pulse_spectra(low_contrast().astype(np.complex64), 0, np.arange(0, 200, 5))
    first, second = cells.halves()
    assert first.cells + second.cells == cells.cells == 40
    np.testing.assert_array_equal(first.spectra[1], cells.spectra[2])
    assert cells.thinned(10 * SIDE).cells == 10


@pytest.mark.parametrize("wide", [False, True])
def test_automatic_reports_the_cells_that_it_used_however_many_the_other_set_has(
    monkeypatch: pytest.MonkeyPatch, wide: bool
) -> None:
    strongest, spread = np.arange(60, 80), np.arange(0, 200, 10)
    monkeypatch.setattr(complex_image, "_automatic_cells", lambda *given: spread if given[-1] else strongest)

    def automatic(choose: Any, band_of: Any, **how: Any) -> Any:
        used = choose(wide)
        found = autofocus.estimate("mea", used, band_of(used), max_iterations=2)
        return found, used, autofocus.NO_CHECK

    monkeypatch.setattr(autofocus, "automatic", automatic)
    np.testing.assert_array_equal(featreg.focus(low_contrast()).cells, spread if wide else strongest)
