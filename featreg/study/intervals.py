"""Intervals of a mean over image pairs, by the studentised bootstrap.

The unit that is resampled is the image pair: what is claimed is how a method does on other pairs like these. The
repetitions with other seeds are no further pairs; they are averaged within theirs, and what they scatter is part of
what the pairs scatter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from featreg.errors import ParameterError
from featreg.types import FloatArray

RESAMPLES = 4000
#: Pairs below which an interval is so wide that it says nothing; it is then not printed.
FEWEST = 5


@dataclass(frozen=True)
class Interval:
    """A mean and where it may lie.

    Parameters
    ----------
    mean : over the pairs, each the mean of its seeds; None where there is no value
    low, high : the interval; None where nothing can be said: fewer than two values, or all of them equal
    count : pairs (or seeds, where there is one pair only) behind it
    over : "pairs" or "seeds", what was resampled
    missing : pairs without a value, as those of a method that gave no model; a mean that leaves them out flatters it
    """

    mean: float | None
    low: float | None
    high: float | None
    count: int
    over: str = "pairs"
    missing: int = 0

    @property
    def excludes_zero(self) -> bool:
        """Whether the interval lies on one side of zero: of a difference, that it is more than chance."""
        return self.low is not None and self.high is not None and (self.low > 0 or self.high < 0)

    @property
    def told(self) -> bool:
        """Whether the interval is printed: it is known, and not that of a few pairs."""
        known = self.low is not None and self.high is not None
        return known and not (self.over == "pairs" and self.count < FEWEST)

    def __str__(self) -> str:
        if self.mean is None:
            return ""
        reach = f" [{_short(self.low or 0.0)}, {_short(self.high or 0.0)}]" if self.told else ""
        return f"{_short(self.mean)}{reach}{f' without {self.missing}' if self.missing else ''}"


def _short(value: float) -> str:
    """Three digits that count, but a number of four or five in full: 1153 and not 1.15e+03."""
    return f"{value:.0f}" if 1000 <= abs(value) < 1e5 else f"{value:.3g}"


def interval(
    groups: Sequence[Sequence[float]],
    confidence: float = 0.95,
    *,
    resamples: int = RESAMPLES,
    seed: int = 0,
    bounds: tuple[float, float] = (-math.inf, math.inf),
) -> Interval:
    """Return the mean of grouped values and its bootstrap interval.

    Parameters
    ----------
    groups : for each image pair, the values of its seeds; values that are not finite and empty groups do not count
    confidence : of the interval
    resamples : bootstrap samples
    seed : of the resampling
    bounds : the least and greatest value there can be, as (0, 1) of a share

    Raises
    ------
    ParameterError
        A confidence outside 0 to 1.

    Notes
    -----
    Percentile and BCa intervals over few pairs are too short: of 2000 simulated comparisons with 10 pairs, normal
    errors, they held the truth in 0.90 of the cases instead of 0.95; resampling pairs and then seeds in each held it
    in 0.90 to 0.99, depending on how the scatter is shared. The studentised interval held it in 0.93 to 0.96 for 5 to
    40 pairs, normal and skewed. Where too many resamples have no scatter (three pairs, or shares that are nearly all
    0 or 1), Student's t takes its place.

    References
    ----------
    Davison & Hinkley, Bootstrap Methods and their Application, 1997, sections 3.8 and 5.2.
    doi:10.1017/CBO9780511802843
    """
    if not 0 < confidence < 1:
        raise ParameterError(f"confidence must lie between 0 and 1, got {confidence}")
    finite = [[value for value in group if math.isfinite(value)] for group in groups]
    finite = [group for group in finite if group]
    over = "pairs"
    if len(finite) == 1 and len(finite[0]) > 1:
        finite, over = [[value] for value in finite[0]], "seeds"
    values = np.array([math.fsum(group) / len(group) for group in finite])
    count = len(values)
    if not count:
        return Interval(None, None, None, 0, over)
    mean = float(values.mean())
    error = float(values.std(ddof=1) / math.sqrt(count)) if count > 1 else 0.0
    if error <= 1e-12 * max(1.0, abs(mean)):
        return Interval(mean, None, None, count, over)
    below, above = _quantiles(values, mean, confidence, resamples, seed)
    low, high = mean - above * error, mean - below * error
    return Interval(mean, max(low, bounds[0]), min(high, bounds[1]), count, over)


def _quantiles(values: FloatArray, mean: float, confidence: float, resamples: int, seed: int) -> tuple[float, float]:
    """The quantiles of the studentised mean under resampling."""
    count, tail = len(values), (1 - confidence) / 2
    centred = values - mean
    drawn = centred[np.random.default_rng(seed).integers(0, count, (resamples, count))]
    shift = drawn.mean(axis=1)
    variance = drawn.var(axis=1) / (count - 1)
    scattered = variance > 1e-12 * float(np.mean(centred**2))
    ratio = np.full(resamples, np.inf) * np.where(shift < 0, -1, 1)
    ratio[scattered] = shift[scattered] / np.sqrt(variance[scattered])
    skipped = math.ceil(tail * resamples)
    # Order statistics, for between an infinite and a finite one there is nothing to interpolate.
    below, above = (float(value) for value in np.sort(ratio)[[skipped, -skipped - 1]])
    if math.isfinite(below) and math.isfinite(above):
        return below, above
    from scipy.stats import t

    reach = float(t.ppf(1 - tail, count - 1))
    return -reach, reach
