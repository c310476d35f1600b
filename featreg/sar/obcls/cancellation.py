"""Iterative cancellation of the equations that fit worst, by the median absolute deviation of the errors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from featreg.errors import ParameterError
from featreg.runtime.parameters import Positive, checked
from featreg.sar.obcls.association import Fit, Map
from featreg.types import BoolArray, FloatArray

Rule = Literal["mad", "median+mad"]
#: -1 / (sqrt(2) erfcinv(3 / 2)): makes the median absolute deviation of Gaussian errors their standard deviation.
MU = 1.4826
#: Errors that differ by less than this many pixels are equal: the rounding of the fit.
EQUAL_PX = 1e-6


def check_kappa(first: float, last: float) -> None:
    """Raise `ParameterError` where kappa would rise."""
    if last > first:
        raise ParameterError(f"kappa falls from its first value to its last, got {first} and {last}")


@checked("cancelled")
def cancelled(
    errors_of: Callable[[BoolArray], FloatArray | None],
    count: int,
    *,
    threshold: Rule = "median+mad",
    first: Positive = 3.0,
    last: Positive = 2.0,
    step: Positive = 0.25,
    least: int = 3,
    start: BoolArray | None = None,
) -> BoolArray:
    """Return which equations remain after those with the largest errors were cancelled step by step.

    Parameters
    ----------
    errors_of : given which equations to use, fits them and returns the (count,) absolute errors of all, px; None where
        they cannot be fitted
    count : number of equations
    threshold : "mad" (eta is kappa times the scaled median absolute deviation of the errors, as published, Eq. 4) or
        "median+mad" (the same above the median of the errors)
    first, last, step : kappa falls from first to last
    least : fewest equations that may remain; a step that would leave fewer adds the median to eta too
    start : (count,) equations of the first fit; None for all. Those beyond them that fit it are taken back

    Returns
    -------
    (count,) bool; all False where the equations cannot be fitted

    Raises
    ------
    ParameterError
        An unknown threshold or impossible values of kappa.

    Notes
    -----
    Eq. 3 and 4 of L. Pallotta, G. Giunta, C. Clemente, J. J. Soraghan, "SAR coregistration by robust selection of
    extended targets and iterative outlier cancellation", IEEE Geosci. Remote Sens. Lett. Departures: eta is at
    least a millionth of a pixel, so that errors which are all zero cancel nothing; and `least`, for where
    all errors are about as large, the published eta lies below all of them.
    Errors are lengths, so their median is not near 0: the published threshold cuts off a part of the good equations at
    every step and leaves about a third of them, the most accurate ones of the current fit.
    """
    check_kappa(first, last)
    keep = np.ones(count, np.bool_)
    used = keep if start is None or start.sum() < least else start
    # The small number lets the last kappa in whatever the rounding of the steps before.
    for kappa in np.arange(first, last - 1e-9, -step):
        errors = errors_of(used)
        if errors is None:
            return np.zeros(count, np.bool_)
        eta = _eta(errors[used], float(kappa), threshold)
        remain = keep & (errors <= eta)
        if remain.sum() < least:
            remain = keep & (errors <= eta + np.median(errors[used]))
        if remain.sum() < least:
            break
        keep = used = remain
    return keep


def cancelled_fit(
    fit: Fit, reference_xy: FloatArray, secondary_xy: FloatArray, start: BoolArray | None = None
) -> tuple[Map | None, BoolArray]:
    """Return the map fitted to what `cancelled` leaves of (M, 2) and (M, 2) points, or None, and what that is (M,)."""

    def errors_of(kept: BoolArray) -> FloatArray | None:
        found = fit(reference_xy[kept], secondary_xy[kept])
        return None if found is None else np.hypot(*(found(reference_xy) - secondary_xy).T)

    keep = cancelled(errors_of, len(reference_xy), start=start)
    return fit(reference_xy[keep], secondary_xy[keep]), keep


def _eta(errors: FloatArray, kappa: float, threshold: str) -> float:
    middle = float(np.median(errors))
    deviation = float(np.median(np.abs(errors - middle)))
    return max(kappa * MU * deviation, EQUAL_PX) + (middle if threshold == "median+mad" else 0.0)
