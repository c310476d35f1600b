"""Threads: how many this process may use, and how many of them the numeric libraries take."""

from __future__ import annotations

import operator
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar, copy_context
from typing import Any, TypeVar

from featreg.errors import ParameterError

T = TypeVar("T")
#: How many threads were asked for around; 1 where nobody asked.
_asked: ContextVar[int] = ContextVar("featreg_threads", default=1)

#: Read by the numeric libraries when they are first imported.
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def available_processors() -> int:
    """How many processors this process may use; under a container or taskset fewer than there are."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1


def worker_count(workers: Any, default: int | None = None, name: str = "workers") -> int:
    """Return `workers`; where it is None, `default`, or every processor this process may use.

    `name` is what the caller calls the number.

    Raises
    ------
    ParameterError
        It is no whole number >= 1.
    """
    if workers is None:
        return available_processors() if default is None else default
    try:
        count = 0 if isinstance(workers, bool) else operator.index(workers)
    except TypeError:
        count = 0
    if count < 1:
        raise ParameterError(f"{name} must be a whole number >= 1, got {workers!r}")
    return count


@contextmanager
def opencv_threads(count: int) -> Iterator[None]:
    """Run OpenCV on `count` threads inside the block, on as many as before after it; the setting is per process."""
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(count)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def single_threaded() -> AbstractContextManager[None]:
    """Run OpenCV on one thread inside the block; work runs side by side instead."""
    return opencv_threads(1)


@contextmanager
def limited_threads(count: int | None, algebra: int | None = None) -> Iterator[None]:
    """Let the libraries use at most `count` threads inside the block; None leaves them alone.

    `algebra` is the limit of the linear algebra where it is to be another.

    OpenCV is told directly. The linear algebra starts its threads when it is first imported, which is why the commands
    import nothing heavy before this: a limit set later leaves the threads there, and they forbid a fork.
    """
    algebra = count if algebra is None else algebra
    if algebra is not None and "numpy" not in sys.modules:
        limit_algebra(algebra)
    token = _asked.set(1 if count is None else count)
    try:
        with nullcontext() if count is None else opencv_threads(count):
            yield
    finally:
        _asked.reset(token)


def side_by_side(work: Sequence[Callable[[], T]]) -> list[T]:
    """Run functions that do not touch each other's things, and return what they return, in order.

    They run at the same time where `limited_threads` around allows more than one thread, which then share OpenCV's;
    one after the other where nobody asked for more. The results are the same.
    """
    threads = min(_asked.get(), len(work))
    if threads < 2:
        return [function() for function in work]
    with opencv_threads(_asked.get() // threads), ThreadPoolExecutor(threads) as pool:
        running = [pool.submit(copy_context().run, _alone, function) for function in work]
        return [future.result() for future in running]


def _alone(function: Callable[[], T]) -> T:
    """Run a function in a context of its own, in which no more threads are asked for."""
    _asked.set(1)
    return function()


def use_one_thread() -> None:
    """Let nothing in this process run side by side from here on, whatever was asked for where it was forked from."""
    import cv2

    cv2.setNumThreads(1)
    _asked.set(1)


def limit_algebra(count: int) -> None:
    """Tell this process's libraries of linear algebra that are not imported yet to use `count` threads."""
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, str(count)))
