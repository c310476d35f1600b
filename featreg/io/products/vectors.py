"""State vectors of an orbit as products list them: times to seconds, and no more of them than an image needs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from featreg.types import FloatArray

#: State vectors kept on either side of an image's time, and at most in all.
BESIDE, MOST = 5, 120


def seconds(stamps: Sequence[str], epoch: str) -> FloatArray:
    """(N,) seconds from `epoch` of ISO 8601 times in UTC, to a nanosecond.

    Raises
    ------
    ValueError
        One of them is no time.
    """
    since = np.datetime64(_plain(epoch), "ns")
    times = np.array([np.datetime64(_plain(stamp), "ns") for stamp in stamps])
    if np.isnat(times).any() or np.isnat(since):
        raise ValueError("a time is missing")
    return np.asarray((times - since) / np.timedelta64(1, "s"), np.float64)


def thinned(times: FloatArray, first: float, last: float) -> Any:
    """Indices of the state vectors around the seconds from `first` to `last`, evenly thinned where there are many."""
    early, late = min(first, last), max(first, last)
    low = max(int(np.searchsorted(times, early)) - BESIDE, 0)
    high = min(int(np.searchsorted(times, late)) + BESIDE, len(times))
    count = high - low
    return low + np.unique(np.linspace(0, count - 1, min(count, MOST)).round().astype(int))


def _plain(stamp: str) -> str:
    return str(stamp).strip().removesuffix("Z").removesuffix("+00:00")
