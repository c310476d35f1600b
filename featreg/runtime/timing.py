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


class stage:  # noqa: N801  # it stands behind `with`, as functions do
    """Add the time spent inside to stage `name` of the collection around, if there is one.

    Raises
    ------
    CancelledError
        The work around was cancelled, see `featreg.runtime.watching`.
    """

    __slots__ = ("name", "start", "timings")

    def __init__(self, name: str) -> None:
        self.name = name

    def __enter__(self) -> None:
        check_cancelled()
        self.timings = _current.get()
        self.start = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        if self.timings is not None:
            self.timings[self.name] = self.timings.get(self.name, 0.0) + time.perf_counter() - self.start
