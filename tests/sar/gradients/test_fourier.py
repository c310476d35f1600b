"""Fourier transforms in place, against NumPy's."""

from __future__ import annotations

import numpy as np
import pytest

from featreg.sar.gradients.fourier import fast_length, inverse_transform, transform


@pytest.mark.parametrize("shape", [(16, 16), (48, 80), (224, 176), (1, 16)])
def test_there_and_back_without_the_usual_division(shape: tuple[int, int]) -> None:
    g = np.random.default_rng(0)
    values = (g.normal(size=shape) + 1j * g.normal(size=shape)).astype(np.complex64)
    spectrum = values.copy()
    transform(spectrum)
    np.testing.assert_allclose(spectrum, np.fft.fft2(values), atol=1e-5 * np.abs(spectrum).max())
    inverse_transform(spectrum)
    np.testing.assert_allclose(spectrum, values * values.size, atol=1e-5 * values.size)


def test_fast_lengths_are_multiples_of_sixteen_just_above() -> None:
    assert [fast_length(n) for n in (1, 16, 17, 255, 257, 300)] == [16, 16, 32, 256, 288, 320]
    for least in range(1, 2000, 37):
        rest = fast_length(least)
        assert least <= rest < 1.25 * least + 16
        for prime in (2, 3, 5, 7, 11, 13):
            while rest % prime == 0:
                rest //= prime
        assert rest == 1
