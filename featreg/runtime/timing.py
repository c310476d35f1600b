"""Seconds by stage, without any stage having to return them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from featreg.runtime.watching import check_cancelled

_current: ContextVar[dict[str, float] | None] = ContextVar("featreg_timings", default=None)


@contextmanager
def collecting() -> Iterator[dict[str, float]]:
    """Collect the seconds of every `stage` entered inside, by name; the dict fills while the work runs."""
    timings: dict[str, float] = {}
    token = _current.set(timings)
    try:
        yield timings
    finally:
        _current.reset(token)


@contextmanager
def stage(name: str) -> Iterator[None]:
    """Add the time spent inside to stage `name` of the collection around, if there is one.

    Raises
    ------
    CancelledError
        The work around was cancelled, see `featreg.runtime.watching`.
    """
    check_cancelled()
    timings = _current.get()
    if timings is None:
        yield
        return
    start = time.perf_counter()
    try:
        yield
    finally:
        timings[name] = timings.get(name, 0.0) + time.perf_counter() - start
