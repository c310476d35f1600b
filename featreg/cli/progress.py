"""What is said while a command works, on the standard error where someone looks at it, and when it is interrupted."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import typer

from featreg.runtime.progress import ProgressBar

COMPILING = "compiling kernels, the first time only (about half a minute)"


@contextmanager
def saying_when_interrupted(text: str | None) -> Iterator[None]:
    """Let Ctrl-C say how to go on from what is kept; None says nothing."""
    try:
        yield
    except KeyboardInterrupt as stop:
        if text is not None:
            stop.add_note(text)
        raise


def progress(text: str) -> None:
    """Say what is being done, on stderr and only when someone looks at it."""
    if sys.stderr.isatty():
        typer.echo(f"{text} ...", err=True)


def counter(text: str) -> Callable[[int, int], None] | None:
    """Return a callback that keeps a bar of progress up to date, or None when nobody looks at stderr."""
    return ProgressBar(text) if sys.stderr.isatty() else None


def announce_compiling() -> None:
    """Say that the first run takes longer, where someone looks and it will."""
    if sys.stderr.isatty():
        from featreg.warming import ready

        if not ready():
            progress(COMPILING)
