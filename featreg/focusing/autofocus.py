"""The autofocus methods by name, how far a phase can be trusted, and what is done where no method is named."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from featreg.focusing.legendre_phase import legendre_phase
from featreg.focusing.minimum_entropy import Cancelled, Descent, minimum_entropy
from featreg.focusing.phase_error import Band
from featreg.focusing.phase_gradient import SHRINK, phase_gradient
from featreg.focusing.pulse_spectra import PulseSpectra
from featreg.types import FloatArray

#: Expected error, radians RMS, from which a phase is not to be trusted; homogeneous speckle stays above 0.6.
LIMIT = 0.25
#: Expected error with which `automatic` is content with the strongest cells.
CONTENT = 0.12
#: Steps, offset of the weights and samples with which a phase is tried for having settled.
TRIAL, TRIAL_OFFSET, TRIAL_SAMPLES = 30, 0.0, 1 << 22
#: Share of the free phase's expected error that a polynomial is charged with.
HIDDEN = 0.5
#: Samples on which the parametric start is found.
START_SAMPLES = 1 << 18
#: Offset of the weights directly after a parametric start, and the distance from its fixed point at which it ends.
QUICK_OFFSET, QUICK_TOLERANCE = 0.0, 2e-2


@dataclass(frozen=True)
class Check:
    """How far an estimated phase can be trusted; radians RMS, constant and linear terms apart.

    Parameters
    ----------
    halves : difference of the phases that the two halves of the range cells yield on their own
    unsettled : how far the phase of every pulse moves when minimum entropy goes on from the estimate
    gain : entropy by which one half's phase sharpens the cells of the other half (nats, the lesser of both)
    """

    halves: float
    unsettled: float
    gain: float

    @property
    def deviation(self) -> float:
        """Expected error: two halves with independent errors differ by twice the error of the whole."""
        return float(np.hypot(self.halves / 2, self.unsettled))


NO_CHECK = Check(np.inf, np.inf, -np.inf)


def refined(cells: PulseSpectra, band: Band, max_iterations: int, each: Cancelled | None) -> Descent:
    """Minimum entropy from a parametric start, which finds its way where contrast is low."""
    start = legendre_phase(cells.thinned(START_SAMPLES), band, max_iterations=max_iterations)
    quick = minimum_entropy(
        cells, band, start.phase, warm=0, offset=QUICK_OFFSET, max_iterations=(max_iterations + 1) // 2,
        tolerance=QUICK_TOLERANCE, each=each,
    )  # fmt: skip
    # The fixed point depends a little on the offset, so the last one must be the same for every image.
    left = max_iterations - quick.iterations
    last = minimum_entropy(cells, band, quick.phase, warm=0, max_iterations=left, each=each) if left else quick
    before = cells.criteria(np.zeros(cells.pulses))[1]
    return Descent(last.phase, np.r_[before, quick.entropy[1:], last.entropy[1 if left else len(last.entropy) :]],
                   last.change)  # fmt: skip


def estimate(
    method: str,
    cells: PulseSpectra,
    band: Band,
    *,
    max_iterations: int = 60,
    each: Cancelled | None = None,
) -> Descent:
    """Estimate the phase by one method: "mea", "pmea" (the same on other cells), "mca", "pga" or "legendre".

    Those that end in "-paper" are the plain forms: no steps of contrast before entropy, no step taken back, and of the
    phase gradient a window that may shrink at once.
    """
    if method in ("pga", "pga-paper"):
        shrink = 0.0 if method == "pga-paper" else SHRINK
        return phase_gradient(cells, band, shrink=shrink, max_iterations=max_iterations, each=each)
    if method == "legendre":
        return legendre_phase(cells, band, max_iterations=max_iterations, each=each)
    run: Mapping[str, Callable[..., Descent]] = {
        "mea": minimum_entropy,
        "pmea": minimum_entropy,
        "mca": partial(minimum_entropy, contrast_only=True),
        "mea-paper": partial(minimum_entropy, plain=True),
        "pmea-paper": partial(minimum_entropy, plain=True),
        "mca-paper": partial(minimum_entropy, contrast_only=True),
    }
    return run[method](cells, band, max_iterations=max_iterations, each=each)


def check(cells: PulseSpectra, band: Band, phase: FloatArray, method: Callable[[PulseSpectra], Descent]) -> Check:
    """Look at an estimate with range cells that it has not seen, and with another step size.

    Parameters
    ----------
    cells, band : those of the estimate
    phase : (N,) the estimate
    method : makes an estimate of other cells in the same way
    """
    few = cells.thinned(TRIAL_SAMPLES)
    if len(few.groups) < 2:
        return NO_CHECK
    first, second = few.halves()
    one, other = method(first).phase, method(second).phase
    trial = minimum_entropy(few, band, phase, warm=0, offset=TRIAL_OFFSET, max_iterations=TRIAL)
    none = np.zeros(cells.pulses)
    gains = [half.criteria(none)[0] - half.criteria(seen)[0] for half, seen in ((first, other), (second, one))]
    return Check(band.difference(one, other), band.difference(phase, trial.phase), float(min(gains)))


def automatic(
    choose: Callable[[bool], PulseSpectra], band_of: Callable[[PulseSpectra], Band], *, max_iterations: int = 60,
    each: Cancelled | None = None,
) -> tuple[Descent, PulseSpectra, Check]:  # fmt: skip
    """Estimate the phase as well as we know how.

    Parameters
    ----------
    choose : makes the spectra of the strongest cells, or (True) of as many as there are
    band_of : the pulses that carry signal in them
    max_iterations, each : as in `minimum_entropy`

    Returns
    -------
    The estimate, the cells it was made of, and its check.

    Notes
    -----
    Minimum entropy from a parametric start on the strongest cells. Where its halves disagree, contrast is low: then
    all cells are taken, and the polynomial itself is kept where the free phase adds more noise than it removes error.
    """
    run = partial(refined, max_iterations=max_iterations, each=each)
    cells = choose(False)
    band = band_of(cells)
    found = run(cells, band)
    verdict = check(cells, band, found.phase, partial(run, band=band))
    if verdict.deviation <= CONTENT:
        return found, cells, verdict
    more = choose(True)
    if more.cells <= cells.cells:
        return found, cells, verdict
    band = band_of(more)
    free = run(more, band)
    free_check = check(more, band, free.phase, partial(run, band=band))
    smooth = legendre_phase(more, band, max_iterations=max_iterations)
    smooth_check = check_parametric(more, band, smooth.phase, free.phase, free_check)
    ranked = [(free, more, free_check), (smooth, more, smooth_check), (found, cells, verdict)]
    return min(ranked, key=lambda item: item[2].deviation)


def check_parametric(
    cells: PulseSpectra, band: Band, phase: FloatArray, free: FloatArray, free_check: Check
) -> Check:  # fmt: skip
    """Check a polynomial phase: its halves, and what it leaves out of the free phase beyond that one's own noise."""
    few = cells.thinned(TRIAL_SAMPLES)
    if free_check is NO_CHECK or len(few.groups) < 2:
        return NO_CHECK
    one, other = (legendre_phase(half, band) for half in few.halves())
    left = band.difference(phase, free) ** 2 - free_check.deviation**2
    # Under the noise of the free phase, an error that both halves' polynomials share could hide.
    hidden = (HIDDEN * free_check.deviation) ** 2
    return Check(band.difference(one.phase, other.phase), float(np.sqrt(max(left, hidden))), free_check.gain)
