"""Lengths whose transforms are slow: empty pulses put into the gap of the band, and taken out again."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg.focusing import complex_image
from featreg.focusing.phase_error import Band, at_quick_length
from featreg.focusing.pulse_spectra import PulseSpectra, pulse_spectra

#: A prime number of pulses, the next quick length, and range cells.
PULSES, QUICK, CELLS = 251, 252, 60


def spectrum(share: float = 0.8, turned: int = 0, seed: int = 0) -> NDArray[np.complex128]:
    """Points over clutter as pulses: (PULSES, CELLS), a share of the pulses with signal, turned around the circle."""
    rng = np.random.default_rng(seed)
    f = np.fft.fftfreq(PULSES)
    pulses = np.fft.fft(rng.normal(size=(PULSES, CELLS)) + 1j * rng.normal(size=(PULSES, CELLS)), axis=0)
    for cell in range(CELLS):
        pulses[:, cell] += 40 * np.exp(-2j * np.pi * f * rng.uniform(20, PULSES - 20))
    return np.asarray(np.roll(pulses * (np.abs(f) < share / 2)[:, None], turned, axis=0))


def cells_of(pulses: NDArray[np.complex128]) -> PulseSpectra:
    return pulse_spectra(np.fft.ifft(pulses, axis=0).astype(np.complex64), 0, np.arange(CELLS), normalize=False)


@pytest.mark.parametrize("turned", [0, 90, 126, 200])
def test_empty_pulses_go_into_the_gap_and_out_again(turned: int) -> None:
    cells = cells_of(spectrum(turned=turned))
    longer = at_quick_length(cells)
    assert (longer.pulses, longer.image_pulses) == (QUICK, PULSES)
    np.testing.assert_array_equal(longer.in_image(longer.power()), cells.power())
    band, quick = Band.of(cells.power()), Band.of(longer.power())
    np.testing.assert_array_equal(longer.spectra[:, quick.order], cells.spectra[:, band.order])
    np.testing.assert_array_equal(quick.place, band.place)
    values = np.arange(len(band.order), dtype=np.float64)
    np.testing.assert_array_equal(longer.in_image(quick.spread(values)), band.spread(values))


def test_the_entropy_is_that_of_as_many_samples_as_the_image_has() -> None:
    cells = cells_of(spectrum())
    longer = at_quick_length(cells)
    plain, finer = cells.criteria(np.zeros(PULSES)), longer.criteria(np.zeros(QUICK))
    np.testing.assert_allclose(finer, plain, atol=3e-3)
    # By the definition; as many samples as there are would give ln(252 / 251) = 0.004 more.
    image = np.fft.ifft(longer.spectra, axis=1, norm="ortho")
    power = np.abs(image) ** 2 * QUICK
    share = power / power.sum()
    assert -np.sum(share * np.log(share)) - np.log(QUICK / PULSES) == pytest.approx(finer[1], abs=1e-4)


@pytest.mark.parametrize("share", [1.0, 0.99])
def test_a_band_without_a_gap_keeps_its_length(share: float) -> None:
    pulses = spectrum(share)
    pulses[100] = 0  # one that chance has emptied is no gap
    assert at_quick_length(cells_of(pulses)).pulses == PULSES


@pytest.mark.parametrize("method", ["mea", "pmea", "pga", "auto"])
def test_a_phase_is_found_as_well_in_the_quick_length(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pulses = spectrum(turned=90)
    along = np.linspace(-1, 1, PULSES)
    phase = np.roll(np.fft.ifftshift(12 * along**2 + 3 * np.sin(7 * along)), 90)
    image = np.fft.ifft(pulses * np.exp(1j * phase)[:, None], axis=0).astype(np.complex64)
    band = Band.of(np.mean(np.abs(pulses) ** 2, axis=1))
    quick = featreg.focus(image, method, fraction=None if method == "pga" else 1.0)
    monkeypatch.setattr(complex_image, "at_quick_length", lambda cells: cells)
    plain = featreg.focus(image, method, fraction=None if method == "pga" else 1.0)
    assert quick.phase.shape == plain.phase.shape == (PULSES,)
    assert quick.status == plain.status == "ok"
    assert band.difference(quick.phase, phase) < 1.2 * band.difference(plain.phase, phase) + 0.01
    assert quick.image_entropy[1] == pytest.approx(plain.image_entropy[1], abs=0.02)
    assert quick.entropy[-1] == pytest.approx(plain.entropy[-1], abs=0.02)


@pytest.mark.parametrize("method", ["mea-paper", "pga-paper"])
def test_as_published_the_image_has_the_length_that_it_has(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(cells: PulseSpectra) -> PulseSpectra:
        raise AssertionError("lengthened")

    monkeypatch.setattr(complex_image, "at_quick_length", never)
    image = np.fft.ifft(spectrum(), axis=0).astype(np.complex64)
    assert featreg.focus(image, method, max_iterations=2).phase.shape == (PULSES,)
    with pytest.raises(AssertionError, match="lengthened"):
        featreg.focus(image, method.removesuffix("-paper"), max_iterations=2)
