"""Jumps of the position over time, told from drift."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from featreg.types import FloatArray

#: Chance that a stack that only drifts shows a jump, and the least step that is called one, px.
CHANCE, LEAST_PX = 0.004, 0.5
#: Fewest steps from which the usual one can be told.
LEAST_STEPS = 5


class Jump(NamedTuple):
    """The first image after a jump, and the step (dx, dy), px, of the model reference -> image at the image centre."""

    image: int
    dx: float
    dy: float


def jumps(shifts: Sequence[FloatArray | None], errors: Sequence[float]) -> list[Jump]:
    """Return the steps from date to date that are no drift.

    Parameters
    ----------
    shifts : (2,) px for each image in the order of time, None where it was left out
    errors : standard error of each, px

    Returns
    -------
    The jumps, in the order of time; none where the dates are too few to tell the usual step

    Notes
    -----
    Generalised extreme Studentized deviates in two dimensions: the largest step is compared with the mean square of the
    others, by the F law with a chance divided by the number of steps; then it is set aside and the next one looked at.
    A step over dates that were left out counts as so many steps of a random walk.

    References
    ----------
    B. Rosner, "Percentage points for a generalized ESD many-outlier procedure", Technometrics 25 (1983) 165,
    DOI 10.1080/00401706.1983.10487848
    """
    from scipy.stats import f as f_law

    known = [i for i, shift in enumerate(shifts) if shift is not None]
    steps: list[tuple[int, FloatArray, float, float]] = []
    for before, after in itertools.pairwise(known):
        here, there = shifts[before], shifts[after]
        if here is not None and there is not None:
            steps.append((after, there - here, float(after - before), float(np.hypot(errors[before], errors[after]))))
    if len(steps) < LEAST_STEPS:
        return []
    usual = [np.asarray(d / np.sqrt(gap)) for _, d, gap, _ in steps]
    found: list[Jump] = []
    left = list(range(len(steps)))
    while len(left) >= LEAST_STEPS:
        # The median step is the trend: it takes two degrees of freedom.
        middle = np.median([usual[n] for n in left], axis=0)
        squares = {n: float(((usual[n] - middle) ** 2).sum()) for n in left}
        largest = max(left, key=lambda n: squares[n])
        others = [squares[n] for n in left if n != largest]
        freedom = 2 * (len(others) - 1)
        variance = sum(others) / freedom
        index, step, _, error = steps[largest]
        limit = 2 * variance * float(f_law.isf(CHANCE / len(steps), 2, freedom))
        if squares[largest] <= max(limit, (3 * error) ** 2, LEAST_PX**2):
            break
        found.append(Jump(index, float(step[0]), float(step[1])))
        left.remove(largest)
    return sorted(found)
