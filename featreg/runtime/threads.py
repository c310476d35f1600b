"""Threads of the libraries: how many OpenCV may use."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from featreg.errors import ParameterError


@contextmanager
def single_threaded() -> Iterator[None]:
    """Run OpenCV on one thread inside the block, and on as many as before after it (the setting is per process)."""
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def check_count(name: str, count: Any) -> None:
    """Raise where a number of workers or threads is neither None nor a whole number from 1 on."""
    if count is not None and (isinstance(count, bool) or not hasattr(count, "__index__") or count < 1):
        raise ParameterError(f"{name} must be a whole number >= 1, got {count!r}")


@contextmanager
def limited_threads(count: int | None) -> Iterator[None]:
    """Let OpenCV use at most `count` threads inside the block; None leaves it alone."""
    if count is None:
        yield
        return
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(count)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
