"""Running tasks: one after the other, in threads, in processes, in any executor, on a dask cluster.

The results come in any order; whoever takes them sorts them.
"""

from __future__ import annotations

import logging
import queue
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import closing, contextmanager, nullcontext
from typing import Any, Protocol

from featreg.errors import FeatregError, ParameterError
from featreg.runtime.dask_tasks import DaskTasks
from featreg.runtime.threads import single_threaded, worker_count
from featreg.runtime.watching import GLANCE, Canceller, end_if_set
from featreg.runtime.workers import can_fork, start_worker

#: Tasks handed over ahead of the results for each worker, and for an executor of unknown size.
AHEAD = 3
UNKNOWN = 64
#: How often worker processes that die are replaced before the run gives up.
REPLACED = 3

#: Executors by name.
NAMES = ("serial", "threads", "processes")

logger = logging.getLogger(__name__)


class TaskExecutor(Protocol):
    """A way to run tasks: `run` yields (position of the item, result) in the order of completion."""

    own_process: bool

    def run(
        self, function: Callable[..., Any], common: Sequence[Any], items: Sequence[Any], cancel: Canceller | None
    ) -> Iterator[tuple[int, Any]]: ...


class InProcessExecutor(Executor):
    """Runs a call when it is submitted, in this process."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def check_executor(executor: Any) -> None:
    """Raise where nothing can be run by what is given as `executor`."""
    if isinstance(executor, str):
        if executor not in NAMES:
            raise ParameterError(
                f"executor must be 'serial', 'threads', 'processes', an Executor or a dask Client, got '{executor}'"
            )
    elif executor is not None and not callable(getattr(executor, "submit", None)):
        raise ParameterError(f"executor must be a name, an Executor or a dask Client, got {type(executor).__name__}")


@contextmanager
def open_executor(executor: Any, workers: int | None) -> Iterator[TaskExecutor]:
    """Return how tasks are run.

    Parameters
    ----------
    executor : "serial", "threads", "processes", a `concurrent.futures.Executor`, a `dask.distributed.Client`, or None
        for processes where they can be forked safely, else threads
    workers : how many, of the named ones; None takes every processor this process may use
    """
    check_executor(executor)
    count = worker_count(workers)
    if executor is None:
        executor = "serial" if count == 1 else ("processes" if can_fork() else "threads")
    if isinstance(executor, str):
        # For processes too: a library that starts threads of its own here would forbid the fork.
        with single_threaded():
            if executor == "serial":
                yield _Futures(InProcessExecutor(), ahead=1, own_process=False)
            elif executor == "threads":
                pool = ThreadPoolExecutor(count, thread_name_prefix="featreg-task")
                try:
                    yield _Futures(pool, ahead=AHEAD * count, own_process=False)
                finally:
                    pool.shutdown(wait=True, cancel_futures=True)
            else:
                with closing(_Processes(count)) as processes:
                    yield processes
        return
    if type(executor).__module__.startswith("distributed"):
        yield DaskTasks(executor)
        return
    ahead = AHEAD * getattr(executor, "_max_workers", UNKNOWN)
    here = isinstance(executor, ThreadPoolExecutor | InProcessExecutor)
    with single_threaded() if here else nullcontext():
        yield _Futures(executor, ahead=ahead, own_process=not here)


class _Futures:
    """Any object with `submit`, whose futures have `add_done_callback`, `result` and `cancel`."""

    def __init__(self, executor: Any, *, ahead: int, own_process: bool = True) -> None:
        self._executor, self._ahead = executor, ahead
        self.own_process = own_process

    def run(
        self, function: Callable[..., Any], common: Sequence[Any], items: Sequence[Any], cancel: Canceller | None
    ) -> Iterator[tuple[int, Any]]:
        done: queue.SimpleQueue[tuple[int, Any]] = queue.SimpleQueue()
        pending: dict[int, Any] = {}
        waiting = iter(enumerate(items))
        try:
            while True:
                end_if_set(cancel)
                while len(pending) < self._ahead:
                    position, item = next(waiting, (-1, None))
                    if position < 0:
                        break
                    future = self._executor.submit(function, *common, item)
                    pending[position] = future
                    future.add_done_callback(lambda f, at=position: done.put((at, f)))
                if not pending:
                    return
                try:
                    position, future = done.get(timeout=GLANCE)
                except queue.Empty:
                    continue
                del pending[position]
                yield position, future.result()
        finally:
            for future in pending.values():
                future.cancel()


class _Processes:
    """Own worker processes, forked; those that die are replaced and what they had in hand is done again."""

    own_process = True

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._pool: ProcessPoolExecutor | None = None

    def run(
        self, function: Callable[..., Any], common: Sequence[Any], items: Sequence[Any], cancel: Canceller | None
    ) -> Iterator[tuple[int, Any]]:
        left = dict(enumerate(items))
        if self._pool is None and len(left) > 1:
            # Here, so that the workers inherit what the first task has imported and compiled.
            end_if_set(cancel)
            yield 0, function(*common, left.pop(0))
        for attempt in range(REPLACED + 1):
            positions = list(left)
            pool = _Futures(self._open(), ahead=AHEAD * self._workers)
            try:
                for at, result in pool.run(function, common, [left[p] for p in positions], cancel):
                    del left[positions[at]]
                    yield positions[at], result
                return
            except BrokenExecutor as error:
                logger.warning("a worker process died (attempt %d); its tasks are done again", attempt + 1)
                self.close()
                last = error
        raise FeatregError(
            f"worker processes died {REPLACED + 1} times ({last}), perhaps for want of memory; use fewer workers"
        ) from last

    def _open(self) -> ProcessPoolExecutor:
        if self._pool is None:
            import multiprocessing

            method = "fork" if can_fork() else "forkserver" if sys.platform != "win32" else "spawn"
            context = multiprocessing.get_context(method)
            self._pool = ProcessPoolExecutor(
                self._workers, mp_context=context, initializer=start_worker, initargs=(True,)
            )
        return self._pool

    def close(self) -> None:
        if self._pool is not None:
            # Broken off here by a second Ctrl-C, the workers would wait for work, and the end of this process for them.
            with _uninterrupted():
                self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Ctrl-C is ignored inside, where this thread may say so."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.SIG_DFL if before is None else before)
