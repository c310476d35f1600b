"""A phase history of chance, for what is done with one and for the files of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from featreg.focusing.phase_history import PhaseHistory

FREQUENCIES = np.linspace(9.3e9, 9.9e9, 8)


def _history(azimuth_deg: Any, **other: Any) -> PhaseHistory:
    """One pulse per azimuth on a circle; every sample holds the number of its pulse."""
    azimuth = np.asarray(azimuth_deg, np.float64)
    turn = np.deg2rad(azimuth)
    positions = np.column_stack([700 * np.cos(turn), 700 * np.sin(turn), np.full(len(turn), 500.0)])
    samples = np.repeat(np.arange(len(turn), dtype=np.complex64)[:, None], len(FREQUENCIES), axis=1)
    made = {
        "samples": samples,
        "frequencies": FREQUENCIES,
        "positions": positions,
        "r0": np.linalg.norm(positions, axis=1),
        "azimuth_deg": azimuth,
    }
    return PhaseHistory(**{**made, **other})


@pytest.fixture
def history() -> Callable[..., PhaseHistory]:
    """``history(azimuth_deg, **fields)``."""
    return _history
