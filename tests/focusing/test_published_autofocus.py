"""Autofocus as published: its shares of range cells, its fixed point, its energies."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest

import featreg
from featreg.focusing import FRACTIONS, autofocus, complex_image
from featreg.focusing.phase_error import Band
from featreg.focusing.pulse_spectra import PulseSpectra, pulse_spectra


def test_the_published_forms_take_five_percent_and_all_for_pga() -> None:
    assert [FRACTIONS[f"{name}-paper"] for name in ("pmea", "mea", "mca", "pga")] == [0.05, 0.05, 0.05, 1.0]


def test_published_minimum_entropy_is_the_fixed_point_alone() -> None:
    """phase = angle(sum S conj(FFT(ln p g))), from zero, energies kept, nothing taken back."""
    rng = np.random.default_rng(0)
    image = (rng.normal(size=(64, 40)) + 1j * rng.normal(size=(64, 40))) * rng.uniform(0.5, 3, 40)
    cells: PulseSpectra = pulse_spectra(image, 0, np.arange(40), normalize=False)
    band = Band.of(cells.power())
    found = autofocus.estimate("mea-paper", cells, band, max_iterations=3)
    spectra = np.fft.fft(image.T, axis=1, norm="ortho")
    spectra /= np.sqrt(np.mean(np.sum(np.abs(spectra) ** 2, axis=1)))
    phase = np.zeros(64)
    for _ in range(3):
        g = np.fft.ifft(spectra * np.exp(-1j * phase), axis=1, norm="ortho")
        p = np.abs(g) ** 2 * 64
        phase = np.angle(np.sum(spectra * np.conj(np.fft.fft(np.log(p) * g, axis=1, norm="ortho")), axis=0))
    assert np.abs(np.angle(np.exp(1j * (found.phase - phase)))).max() < 1e-2


def test_the_published_form_keeps_energies_and_counts_points_of_the_image_as_it_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(1)
    image = (rng.normal(size=(64, 64)) + 1j * rng.normal(size=(64, 64))).astype(np.complex64)
    seen: dict[str, Any] = {}
    module: Any = sys.modules[complex_image.__name__]
    real_spectra, real_counts = module.pulse_spectra, module._counts

    def spectra(*args: Any, **keywords: Any) -> Any:
        seen["normalize"] = keywords["normalize"]
        return real_spectra(*args, **keywords)

    def counts(pixels: Any, *args: Any) -> Any:
        seen["pixels"] = pixels
        return real_counts(pixels, *args)

    monkeypatch.setattr(module, "pulse_spectra", spectra)
    monkeypatch.setattr(module, "_counts", counts)
    featreg.focus(image, "pmea-paper", normalize=True, max_iterations=2)
    assert seen["normalize"] is False
    np.testing.assert_array_equal(seen["pixels"], image)
