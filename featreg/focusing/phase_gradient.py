"""Phase gradient autofocus (PGA): the phase that dominant scatterers have in common."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.focusing.minimum_entropy import Cancelled, Descent
from featreg.focusing.phase_error import Band
from featreg.focusing.pulse_spectra import PulseSpectra
from featreg.types import FloatArray

#: The window ends where the summed profile falls below this share of its peak (-10 dB), and is widened by this.
LEVEL, WIDEN = 0.1, 1.5
#: A window shrinks to no less than this share of the one before, and to no less samples than this.
SHRINK, NARROWEST = 0.8, 5


def phase_gradient(
    cells: PulseSpectra,
    band: Band,
    *,
    shrink: float = SHRINK,
    max_iterations: int = 60,
    tolerance: float = 1e-2,
    each: Cancelled | None = None,
) -> Descent:
    """Estimate one phase per pulse from the strongest scatterer of every range cell.

    Parameters
    ----------
    cells, band : spectra of the range cells, and the pulses that carry signal
    shrink : a window is no narrower than this share of the one before; 0 lets it shrink at once, as published
    max_iterations, tolerance : stop after so many, or when the phase changes by less, RMS radians
    each : called with the number of every iteration; may raise to stop

    Notes
    -----
    The peak of every cell is shifted to the centre, a window cut about it, and the phase integrated from ``angle(
    sum_k conj(G_m) G_m+1)`` along the band: D. E. Wahl, P. H. Eichel, D. C. Ghiglia, C. V. Jakowatz, Phase gradient
    autofocus: a robust tool for high resolution SAR phase correction, IEEE TAES 30 (1994) 827,
    doi:10.1109/7.303752. The window is theirs (-10 dB of the summed profile, half as wide again, shrinking); the
    estimator is the maximum-likelihood one of the phase difference.
    """
    phase = np.zeros(cells.pulses)
    width = cells.pulses
    entropy: list[float] = []
    change = np.inf
    for used in range(max_iterations + 1):
        entropy.append(cells.criteria(phase)[1])
        if used == max_iterations or change < tolerance:
            break
        if each is not None:
            each(used)
        profile = _profile(cells, phase)
        width = _width(profile, width, shrink)
        found = _gradient(cells, band, phase, width)
        change = band.difference(found, np.zeros(cells.pulses))
        phase = band.spread(np.angle(np.exp(1j * (phase + found)[band.order])))
    return Descent(phase, np.array(entropy), float(change))


def _centred(cells: PulseSpectra, strip: slice, phase: FloatArray) -> NDArray[Any]:
    """Corrected cells with their peaks at sample 0."""
    from scipy.fft import ifft

    image = ifft(cells.spectra[strip] * np.exp(-1j * phase).astype(np.complex64), axis=1, norm="ortho")
    peak = np.abs(image).argmax(axis=1)
    samples = (np.arange(cells.pulses) + peak[:, None]) % cells.pulses
    return np.take_along_axis(image, samples, axis=1)


def _profile(cells: PulseSpectra, phase: FloatArray) -> FloatArray:
    def task(strip: slice) -> FloatArray:
        return np.asarray(np.sum(np.abs(_centred(cells, strip, phase)) ** 2, axis=0, dtype=np.float64))

    return np.asarray(np.sum(cells.over(task), axis=0))


def _width(profile: FloatArray, before: int, shrink: float) -> int:
    """Samples of the next window, odd."""
    half = len(profile) // 2
    out = np.maximum(profile[: half + 1], np.r_[profile[:1], profile[-1 : -half - 1 : -1]])
    below = np.flatnonzero(out < LEVEL * out[0])
    wanted = 2 * int(WIDEN * (below[0] if len(below) else half)) + 1
    return int(np.clip(wanted, max(NARROWEST, int(shrink * before)), before))


def _gradient(cells: PulseSpectra, band: Band, phase: FloatArray, width: int) -> FloatArray:
    from scipy.fft import fft

    window = np.zeros(cells.pulses, np.float32)
    reach = min(width // 2, (cells.pulses - 1) // 2)
    window[: reach + 1] = 1
    window[cells.pulses - reach :] = 1

    def task(strip: slice) -> NDArray[np.complex128]:
        pulses = fft(_centred(cells, strip, phase) * window, axis=1, norm="ortho")[:, band.order]
        return np.asarray(np.sum(np.conj(pulses[:, :-1]) * pulses[:, 1:], axis=0, dtype=np.complex128))

    steps = np.angle(np.sum(cells.over(task), axis=0))
    return band.spread(band.without_line(band.spread(np.r_[0.0, np.cumsum(steps)])))
