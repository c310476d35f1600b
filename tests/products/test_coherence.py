"""Coherence of two images: its bias, holes, and what is refused."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.errors import InputError, ParameterError
from featreg.products.coherence import coherence, expected_coherence


@pytest.mark.parametrize("true", [0.0, 0.4, 0.8])
@pytest.mark.parametrize("window", [3, 7])
def test_coherence_and_its_bias(true: float, window: int) -> None:
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(2, 400, 400)) + 1j * rng.normal(size=(2, 400, 400))
    other = true * a + np.sqrt(1 - true**2) * b
    inner = slice(10, -10)
    found = coherence(a, other, window=window)[inner, inner]
    assert found.mean() == pytest.approx(expected_coherence(true, window**2), abs=0.006)
    if true >= 0.4 and window == 7:
        corrected = coherence(a, other, window=window, correct_bias=True)[inner, inner]
        assert corrected.mean() == pytest.approx(true, abs=0.005)
    if true == 0.0:
        looks = window**2
        assert expected_coherence(0.0, looks) == pytest.approx(np.sqrt(np.pi / (4 * looks)), rel=0.03)


def test_coherence_of_equal_shifted_and_empty_images(band_limited: Callable[..., NDArray[np.complex64]]) -> None:
    a = band_limited(200, 4, 0.45)
    np.testing.assert_allclose(coherence(a, 3 * a * np.exp(1j))[2:-2, 2:-2], 1, atol=1e-6)
    assert np.nanmean(coherence(a, np.roll(a, 3, axis=1), window=9)) < 0.2
    holes = a.copy()
    holes[50:80, 60:90] = np.nan
    holes[100:120, 100:120] = 0
    found = coherence(a, holes)
    assert np.isnan(found[54:76, 64:86]).all()
    assert np.isnan(found[104:116, 104:116]).all()
    np.testing.assert_allclose(found[120:, :50][5:-5, 5:-5], 1, atol=1e-6)
    with pytest.raises(InputError, match="complex"):
        coherence(np.abs(a), a)
    with pytest.raises(InputError, match="one shape"):
        coherence(a[:50], a)
    with pytest.raises(ParameterError, match="odd"):
        coherence(a, a, window=4)
