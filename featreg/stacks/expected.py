"""What is expected of the pairs of a stack before any is matched: time span, season, what the user knows."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from featreg.displacement.mintpy import DAY
from featreg.errors import ParameterError

#: Days after which the expected coherence of the ground has fallen to 1/e.
DECAY_DAYS = 365.0
#: By what share it is lower between opposite seasons than within one.
SEASON = 0.5
YEAR = 365.25

Expected = Callable[[int, int], float]


def days_of_images(names: Sequence[str], dates: Iterable[Any] | None) -> list[date] | None:
    """Return the day of each image: those that are given, else the first in each name; None where one has none.

    Parameters
    ----------
    names : of the files
    dates : one an image, as `datetime.date`, "YYYYMMDD" or "YYYY-MM-DD"

    Raises
    ------
    ParameterError
        The dates are no days, or another number than the images.
    """
    if dates is None:
        found = [_day_in(name) for name in names]
        return None if any(day is None for day in found) else [day for day in found if day is not None]
    several = isinstance(dates, Iterable) and not isinstance(dates, str | bytes | Mapping)
    given = list(dates) if several else []
    if len(given) != len(names):
        told = f"{len(given)} of them" if several else repr(dates)
        raise ParameterError(f"dates must be one day for each of the {len(names)} images, got {told}")
    return [_day(day) for day in given]


def _day_in(name: str) -> date | None:
    found = DAY.search(Path(name).name)
    try:
        return None if found is None else date.fromisoformat(found[0])
    except ValueError:  # as 20230231: it was another number
        return None


def _day(given: Any) -> date:
    if isinstance(given, np.datetime64):
        given = given.astype("datetime64[D]").item()
    try:
        if isinstance(given, date):
            return date(given.year, given.month, given.day)
        return date.fromisoformat(str(given)[:10] if "-" in str(given) else str(given))
    except (ValueError, TypeError):  # the latter of a NaT of pandas, which is a date
        raise ParameterError(f"dates must be days as YYYYMMDD or YYYY-MM-DD, got '{given}'") from None


def in_order(count: int, days: Sequence[date] | None) -> list[int]:
    """The numbers of the images in the order of time; images of one day as they are given."""
    return list(range(count)) if days is None else sorted(range(count), key=lambda i: days[i])


def expected_coherence(count: int, days: Sequence[date] | None, given: Any = None) -> Expected | None:
    """Return how alike two images are expected to be, 0 to 1; None where nothing tells it.

    Parameters
    ----------
    count : how many images
    days : of the images, where known
    given : a function of two numbers of images i < k, or a (count, count) table; it counts in place of the days

    Notes
    -----
    Of the days, ``exp(-t / 365 d)`` times 1 within a season and a half between opposite ones, with a cosine between.
    Only the order of pairs is taken from it: a short span first, and of long ones a whole year before half a year.
    """
    if given is not None:
        return _given(count, given)
    if days is None:
        return None
    known = list(days)

    def expected(i: int, k: int) -> float:
        span = abs((known[k] - known[i]).days)
        season = 1 - SEASON * 0.5 * (1 - math.cos(2 * math.pi * span / YEAR))
        return math.exp(-span / DECAY_DAYS) * season

    return expected


def _given(count: int, given: Any) -> Expected:
    if callable(given):

        def asked(i: int, k: int) -> float:
            # Of two images only what is between them counts, so that a function need not answer both ways round.
            return _value(given(min(i, k), max(i, k)), i, k)

        return asked
    try:
        table = np.asarray(given, np.float64)
    except (TypeError, ValueError):
        table = np.zeros(())
    if table.shape != (count, count):
        raise ParameterError(
            f"coherence must be a function of two numbers of images or a ({count}, {count}) table, got "
            f"{type(given).__name__} of shape {table.shape}"
        )

    def looked_up(i: int, k: int) -> float:
        # A table may be filled above its diagonal only.
        values = [v for v in (table[i, k], table[k, i]) if not np.isnan(v)]
        return _value(max(values, default=0.0), i, k)

    return looked_up


def _value(value: Any, i: int, k: int) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise ParameterError(
            f"coherence of images {i} and {k} must be a number between 0 and 1, got {value!r:.60}"
        ) from None
    if math.isnan(number):
        return 0.0
    if not 0 <= number <= 1:
        raise ParameterError(f"coherence of images {i} and {k} must lie between 0 and 1, got {number:g}")
    return number
