"""Parametric minimum-entropy autofocus: a polynomial phase of few coefficients, which works where contrast is low."""

from __future__ import annotations

from typing import Any

import numpy as np

from featreg.focusing.minimum_entropy import Cancelled, Descent
from featreg.focusing.phase_error import Band
from featreg.focusing.pulse_spectra import PulseSpectra
from featreg.types import FloatArray

#: Highest degrees that are fitted one after the other, each from the result before.
DEGREES = (2, 3, 4, 6, 8)
#: Coarse search of the quadratic term: half width in radians and steps of half a cell of its response.
REACH, GRID = 64.0, 33
#: Samples that suffice for the coarse search.
FEW = 1 << 17


def legendre_basis(band: Band, degree: int) -> FloatArray:
    """(N, degree - 1) Legendre polynomials of degree 2 to `degree` over the band, 0 where no pulse carries signal."""
    columns = np.polynomial.legendre.legvander(band.place, degree)[:, 2:]
    return np.column_stack([band.spread(column) for column in columns.T])


def legendre_phase(
    cells: PulseSpectra,
    band: Band,
    *,
    degrees: tuple[int, ...] = DEGREES,
    max_iterations: int = 60,
    each: Cancelled | None = None,
) -> Descent:
    """Estimate a polynomial phase by minimum entropy.

    Parameters
    ----------
    cells, band : spectra of the range cells, and the pulses that carry signal
    degrees : rising degrees up to which coefficients are fitted in turn
    max_iterations : most line searches in all
    each : called with the number of every iteration; may raise to stop

    Notes
    -----
    The quadratic coefficient is searched on a grid (which doubles its reach while the best lies at its edge), because
    the entropy has local minima far from focus; then coefficients of growing degree are refined by L-BFGS with the
    exact gradient. The idea of an order that grows is that of J. Wang, X. Liu, SAR minimum-entropy autofocus using an
    adaptive-order polynomial model, IEEE GRSL 3 (2006) 512, doi:10.1109/LGRS.2006.878446; ours is a fixed sequence.
    """
    from scipy import optimize

    minimize: Any = optimize.minimize
    basis = legendre_basis(band, degrees[-1])
    values = np.zeros(basis.shape[1])
    values[0] = _coarse(cells.thinned(FEW), basis[:, 0])
    entropy = [cells.criteria(np.zeros(cells.pulses))[1]]
    latest = [0.0]
    change = 0.0
    for number, degree in enumerate(degrees):
        left = max_iterations - len(entropy) + 1
        if left <= 0:
            break
        count = degree - 1

        def cost(some: FloatArray, count: int = count) -> tuple[float, FloatArray]:
            phase = basis[:, :count] @ some
            step = cells.step(phase, contrast=False, clamped=False)
            latest[0] = step.entropy
            slope = -2 * np.imag(step.correlation * np.exp(-1j * phase)) / cells.cells
            # The mean over some 10^5 samples is flat; the scale keeps the optimiser's absolute tolerances harmless.
            return 1e3 * step.objective, 1e3 * (basis[:, :count].T @ slope)

        def note(_: FloatArray) -> None:
            entropy.append(latest[0])
            if each is not None:
                each(len(entropy) - 1)

        most = left if number == len(degrees) - 1 else min(left, 12)
        found = minimize(
            cost, values[:count], jac=True, method="L-BFGS-B", callback=note, options={"maxiter": most, "ftol": 1e-8}
        )
        change = float(np.sqrt(np.sum(band.weight * (basis[band.order, :count] @ (found.x - values[:count])) ** 2)))
        values[:count] = found.x
    phase = basis @ values
    entropy[-1] = cells.criteria(phase)[1]
    return Descent(phase, np.array(entropy), change)


def _coarse(cells: PulseSpectra, quadratic: FloatArray) -> float:
    """The coefficient of the quadratic term of least entropy on a grid."""
    reach, count = REACH, GRID
    while True:
        grid = np.linspace(-reach, reach, count)
        cost = [cells.criteria(value * quadratic)[0] for value in grid]
        best = int(np.argmin(cost))
        # A quadratic of N / 8 at the ends of the band smears a point over half of the image.
        if 0 < best < count - 1 or reach > cells.pulses / 16:
            return float(grid[best])
        reach, count = 2 * reach, 2 * count - 1
