"""Complex samples that the tests of this folder share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray


def _band_limited(side: int, seed: int, width: float = 0.3) -> NDArray[np.complex64]:
    """Circular complex noise whose spectrum ends at `width` cycles per sample."""
    rng = np.random.default_rng(seed)
    spectrum = np.fft.fft2(rng.normal(size=(side, side)) + 1j * rng.normal(size=(side, side)))
    f = np.abs(np.fft.fftfreq(side))
    spectrum[f > width] = 0
    spectrum[:, f > width] = 0
    return np.fft.ifft2(spectrum).astype(np.complex64)


@pytest.fixture(scope="session")
def band_limited() -> Callable[..., NDArray[np.complex64]]:
    return _band_limited
