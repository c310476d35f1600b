"""How long work is watched and ended: a caller's `cancel` event and `progress` callback."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, Protocol

from featreg.errors import CancelledError, ParameterError

#: Seconds between two looks at `cancel` of what waits.
GLANCE = 0.2

Progress = Callable[[int, int], None]


class Canceller(Protocol):
    """What `cancel` must offer; a `threading.Event` does."""

    def is_set(self) -> bool: ...


_cancel: ContextVar[Canceller | None] = ContextVar("featreg_cancel", default=None)


@contextmanager
def cancellable(cancel: Canceller | None) -> Iterator[None]:
    """Let every `featreg.runtime.timing.stage` entered inside end the work once `cancel` is set."""
    token = _cancel.set(cancel)
    try:
        yield
    finally:
        _cancel.reset(token)


def check_cancelled() -> None:
    """Raise a `CancelledError` where the work around was cancelled."""
    end_if_set(_cancel.get())


def end_if_set(cancel: Canceller | None) -> None:
    """Raise a `CancelledError` where this event is set."""
    if cancel is not None and cancel.is_set():
        raise CancelledError("the work was cancelled")


def check_watch(progress: Any, cancel: Any) -> None:
    """Raise a `ParameterError` where these are no callback and no event."""
    if progress is not None and not callable(progress):
        raise ParameterError(f"progress must be a function of (done, in all), got {progress!r}")
    if cancel is not None and not callable(getattr(cancel, "is_set", None)):
        raise ParameterError(f"cancel must be an event with is_set(), got {cancel!r}")


class Steps:
    """Counts the steps of a work for a callback that is given (steps done, steps in all)."""

    def __init__(self, total: int, progress: Progress | None = None) -> None:
        self._done, self._total, self._progress = 0, total, progress

    def advance(self) -> None:
        """One step is done; raises a `CancelledError` where the work was cancelled."""
        self._done += 1
        if self._progress is not None:
            self._progress(self._done, self._total)
        check_cancelled()
