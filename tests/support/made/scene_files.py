"""Amplitudes of a scene that is read by windows, and windows within it, across its rim and far from it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from featreg.io.raster_source import Window

SHAPE = (150, 170)
WINDOWS = [Window(0, 0, 170, 150), Window(20, 30, 50, 40), Window(-7, 100, 60, 80), Window(150, -9, 40, 30)]


def amplitude(seed: int = 0) -> NDArray[np.float32]:
    return np.random.default_rng(seed).gamma(2.0, 50.0, SHAPE).astype(np.float32)
