"""Complex scenes, phase errors over azimuth that blur them, and how far a found phase is from the true one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

SIDE = 256
BAND = np.abs(np.fft.fftfreq(SIDE)) < 0.4
Complex = NDArray[np.complex128]


def points_in_clutter(points: Sequence[tuple[float, float, float]], clutter: float, seed: int) -> Complex:
    """Points (azimuth, range, amplitude) over clutter, band-limited in both axes."""
    rng = np.random.default_rng(seed)
    f = np.fft.fftfreq(SIDE)
    spectrum = clutter * np.fft.fft2(rng.normal(size=(SIDE, SIDE)) + 1j * rng.normal(size=(SIDE, SIDE)))
    for row, cell, amplitude in points:
        turn = np.exp(2j * np.pi * rng.uniform())
        spectrum += amplitude * turn * np.outer(np.exp(-2j * np.pi * f * row), np.exp(-2j * np.pi * f * cell))
    window = np.where(np.abs(f) < 0.4, 0.54 + 0.46 * np.cos(2 * np.pi * f / 0.8), 0)
    return np.asarray(np.fft.ifft2(spectrum * BAND[:, None] * window))


def rows_and_columns(seed: int = 0, clutter: float = 1e-3) -> Complex:
    """Section 3.1 of the paper: weak points one per range cell, strong ones all in one range cell."""
    rng = np.random.default_rng(seed)
    weak = [(80 + rng.uniform(-3, 3), 30 + 6 * i, 1.0) for i in range(16)]
    return points_in_clutter(weak + [(100 + 8 * i, 200, 1.5) for i in range(16)], clutter, seed)


def low_contrast(seed: int = 0) -> Complex:
    rng = np.random.default_rng(seed)
    fields = np.kron(rng.uniform(0.7, 1.4, (16, 16)), np.ones((16, 16)))
    fields[rng.integers(10, SIDE - 10, 8)] *= 3
    noise = rng.normal(size=(SIDE, SIDE)) + 1j * rng.normal(size=(SIDE, SIDE))
    return np.asarray(np.fft.ifft2(np.fft.fft2(fields * noise) * BAND[:, None]))


def speckle(shape: tuple[int, int] = (SIDE, SIDE), seed: int = 0) -> Complex:
    rng = np.random.default_rng(seed)
    keep = np.abs(np.fft.fftfreq(shape[0])) < 0.4
    return np.asarray(np.fft.ifft2(np.fft.fft2(rng.normal(size=shape) + 1j * rng.normal(size=shape)) * keep[:, None]))


def smooth_phase(n: int = SIDE, strength: float = 1.0) -> NDArray[np.float64]:
    u = 2 * np.fft.fftfreq(n)
    return np.asarray(strength * (12 * u**2 + 5 * u**3 - 4 * u**4))


def mixed_phase(seed: int = 0) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    u = 2 * np.fft.fftfreq(SIDE)
    return np.asarray(
        smooth_phase() + 1.5 * np.sin(2 * np.pi * (2.3 * u + rng.uniform())) + 0.1 * rng.normal(size=SIDE)
    )


def blurred(image: Complex, phase: NDArray[np.float64]) -> NDArray[np.complex64]:
    spectrum = np.fft.fft(image, axis=0) * np.exp(1j * phase)[:, None]
    return np.fft.ifft(spectrum, axis=0).astype(np.complex64)


def phase_error(image: Complex, truth: NDArray[np.float64], found: NDArray[np.float64]) -> float:
    """RMS radians, constant and linear part apart, by the method of the tests, not of the library."""
    power = np.mean(np.abs(np.fft.fft(image, axis=0)) ** 2, axis=1)
    f = np.fft.fftfreq(len(truth))
    order = np.argsort(f)
    turn = (np.exp(1j * (truth - found)) * power)[order]
    slopes = np.linspace(-np.pi, np.pi, 8001)
    keep = power[order] > 1e-3 * power.max()
    match = np.abs(np.exp(-1j * np.outer(slopes, np.arange(len(f))[keep])) @ turn[keep])
    turn = turn[keep] * np.exp(-1j * slopes[match.argmax()] * np.arange(len(f))[keep])
    left = np.angle(turn * np.exp(-1j * np.angle(turn.sum())))
    return float(np.sqrt(np.average(left**2, weights=np.abs(turn))))
