"""Phase histories of points by the signal model itself, and grids to focus them on."""

from __future__ import annotations

from typing import Any

import numpy as np

from featreg.focusing.backprojection import SPEED_OF_LIGHT as C
from featreg.focusing.ground_grid import GroundGrid
from featreg.focusing.phase_history import PhaseHistory

BAND, LOW, COUNT = 600e6, 9.3e9, 64
SPAN, PULSES = 3.0, 60
ELEVATION = np.deg2rad(40.0)
GRID = GroundGrid(shape=(41, 51), spacing=0.15)


def echoes(points: Any, amplitudes: Any, middle_deg: float = 20.0, pulses: int = PULSES) -> PhaseHistory:
    """The phase history of (N, 3) points by the signal model itself, summed in float64."""
    azimuth = middle_deg + np.linspace(-SPAN / 2, SPAN / 2, pulses)
    turn = np.deg2rad(azimuth)
    look = np.column_stack([np.cos(turn), np.sin(turn), np.full(pulses, np.tan(ELEVATION))])
    positions = 5000.0 * look
    r0 = np.linalg.norm(positions, axis=1)
    frequencies = np.linspace(LOW, LOW + BAND, COUNT)
    samples = np.zeros((pulses, COUNT), np.complex128)
    for point, amplitude in zip(np.reshape(points, (-1, 3)), np.ravel(amplitudes), strict=True):
        off = np.linalg.norm(positions - point, axis=1) - r0
        samples += amplitude * np.exp(-4j * np.pi * off[:, None] * frequencies / C)
    return PhaseHistory(samples.astype(np.complex64), frequencies, positions, r0, azimuth)


SMALL = GroundGrid(shape=(7, 9), spacing=0.31)
