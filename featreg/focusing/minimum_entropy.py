"""Minimum entropy (MEA) and maximum contrast (MCA) autofocus by a fixed point, with a free phase for every pulse."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from featreg.focusing.phase_error import Band
from featreg.focusing.pulse_spectra import PulseSpectra
from featreg.types import FloatArray

Cancelled = Callable[[int], None]

#: Steps of maximum contrast with which minimum entropy begins: entropy alone is slow far from focus.
WARM = 8
#: Offset of the logarithmic weights. From -ln(min p) on, a step cannot raise the entropy; this is 8 times faster.
OFFSET = 2.0
#: Distance from the fixed point, radians RMS, at which the phase has settled.
TOLERANCE = 1e-3
#: Fastest and slowest convergence that is believed when that distance is extrapolated.
RATES = (0.3, 0.98)


@dataclass(frozen=True, eq=False)
class Descent:
    """An estimated phase, and how it was reached.

    Parameters
    ----------
    phase : (N,) float64 radians in the order of the FFT, 0 where no pulse carries signal
    entropy : (iterations + 1,) float64 nats of the cells used, before the first and after every iteration
    change : distance from the fixed point or last change of the phase, radians RMS, constant and linear terms apart
    """

    phase: FloatArray
    entropy: FloatArray
    change: float

    @property
    def iterations(self) -> int:
        return len(self.entropy) - 1


def minimum_entropy(
    cells: PulseSpectra,
    band: Band,
    start: FloatArray | None = None,
    *,
    contrast_only: bool = False,
    warm: int = WARM,
    offset: float = OFFSET,
    plain: bool = False,
    max_iterations: int = 60,
    tolerance: float = TOLERANCE,
    each: Cancelled | None = None,
) -> Descent:
    """Estimate one phase per pulse by the fixed point of the entropy, or of the contrast.

    Parameters
    ----------
    cells, band : spectra of the range cells, and the pulses that carry signal
    start : (N,) radians to begin with; default 0
    contrast_only : maximise the sum of p^2 (MCA) all the way
    warm : so many steps of maximum contrast first
    offset : added to the logarithm in the weights of the entropy
    plain : the fixed point alone: weights ln p, of either sign, from the first step on, and no step taken back
    max_iterations, tolerance : stop after so many, or when the phase is nearer to the fixed point, RMS radians, as
        extrapolated from its last two changes
    each : called with the number of every iteration; may raise to stop

    Notes
    -----
    With S the spectra, g the corrected cells and p their power over its mean, a step is ``phase = angle(sum_k S conj(
    FFT(w g)))``, w = p for the contrast and ``max(ln p + offset, 0)`` for the entropy: the surrogate of T. J. Kragh,
    A. A. Kharbouch, Monotonic iterative algorithm for minimum-entropy autofocus, ICIP 2006,
    doi:10.1109/ICIP.2006.312400, with a smaller offset than the one for which it is proven to be monotonic. A step
    that raises the criterion is taken back and the offset raised.
    """
    if plain:
        warm, offset = 0, 0.0
    phase = np.zeros(cells.pulses) if start is None else start
    entropy: list[float] = []
    best, previous, change, distance = np.inf, phase, np.inf, np.inf
    for used in range(max_iterations + 1):
        contrast = contrast_only or used < warm
        if used == max_iterations or distance < tolerance:
            entropy.append(cells.criteria(phase)[1])
            break
        if each is not None:
            each(used)
        step = cells.step(phase, contrast=contrast, offset=offset, clamped=not plain)
        entropy.append(step.entropy)
        if not plain and not contrast and used > warm and step.objective > best + 1e-7 * abs(best):
            phase, offset, change, distance = previous, offset + 2, np.inf, np.inf
            best = np.inf
            continue
        best = step.objective
        previous = phase
        phase = band.spread(np.angle(step.correlation[band.order]))
        if contrast and not contrast_only:
            continue  # however small, the steps of the warm-up are no sign of having arrived
        before, change = change, band.difference(phase, previous)
        rate = float(np.clip(change / before if before > 0 else 0.0, *RATES))
        distance = change * rate / (1 - rate) if np.isfinite(before) else np.inf
    return Descent(phase, np.array(entropy), float(distance))
