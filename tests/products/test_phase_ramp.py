"""The phase ramp of a burst, found in its samples."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.products.phase_ramp import estimate_phase_ramp


def test_no_ramp_is_found_to_be_none_and_bursts_are_refused(band_limited: Callable[..., NDArray[np.complex64]]) -> None:
    side = 256
    plain = band_limited(side, 2)

    def reader(samples: NDArray[Any]) -> Any:
        return lambda x, y, w, h: (samples[y : y + h, x : x + w], np.ones((h, w), bool))

    none = estimate_phase_ramp(reader(plain), plain.shape, strip=100)
    y, x = np.mgrid[:side, :side]
    assert max(np.abs(slope).max() for slope in np.gradient(none.phase(x, y))) < 0.15  # radians per sample
    burst = (plain * np.exp(1j * 0.155 * (y - 128.0) ** 2 / 2)).astype(np.complex64)
    with pytest.raises(InputError, match="one burst"):
        estimate_phase_ramp(reader(np.vstack([burst] * 5)), (5 * side, side))
    white = np.random.default_rng(0).normal(size=(side, side, 2)).astype(np.float32).view(np.complex64)[..., 0]
    assert np.isnan(estimate_phase_ramp(reader(white), white.shape).concentration).all()
    with pytest.raises(InputError, match="at least 64 x 64"):
        estimate_phase_ramp(reader(plain[:20]), (20, side))
