"""Running the blocks: one after the other, in threads, in processes, in any executor, on a dask cluster.

The results come in any order; whoever takes them sorts them by block.
"""

from __future__ import annotations

import logging
import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, Protocol

from featreg.errors import CancelledError, FeatregError, ParameterError
from featreg.runtime.watching import Canceller

#: Tasks handed over ahead of the results for each worker, and for an executor of unknown size.
AHEAD = 3
UNKNOWN = 64
#: How often worker processes that die are replaced before the run gives up.
REPLACED = 3
#: Seconds between two looks at `cancel`, and between two looks of a worker for its parent.
GLANCE = 0.2

logger = logging.getLogger(__name__)

Task = Callable[[Any], Any]


class Lane(Protocol):
    """A way to run tasks: `run` yields (position of the item, result) in the order of completion."""

    own_process: bool

    def run(
        self, function: Callable[..., Any], common: Sequence[Any], items: Sequence[Any], cancel: Canceller | None
    ) -> Iterator[tuple[int, Any]]: ...


@contextmanager
def open_lane(executor: Any, workers: int | None) -> Iterator[Lane]:
    """Return how blocks are run.

    Parameters
    ----------
    executor : "serial", "threads", "processes", a `concurrent.futures.Executor`, a `dask.distributed.Client`, or None
        for processes where they can be forked safely, else threads
    workers : how many, of the named ones; None takes every processor this process may use
    """
    count = available_processors() if workers is None else workers
    if isinstance(count, bool) or count < 1:
        raise ParameterError(f"workers must be a whole number >= 1, got {workers!r}")
    if executor is None:
        executor = "serial" if count == 1 else ("processes" if can_fork() else "threads")
    if isinstance(executor, str):
        if executor not in ("serial", "threads", "processes"):
            raise ParameterError(
                f"executor must be 'serial', 'threads', 'processes', an Executor or a dask Client, got '{executor}'"
            )
        if executor == "processes":
            with _Processes(count) as lane:
                yield lane
            return
        with single_threaded_libraries():
            if executor == "serial":
                yield _Serial()
                return
            pool = ThreadPoolExecutor(count, thread_name_prefix="featreg-block")
            try:
                yield _Futures(pool, count, own_process=False)
            finally:
                pool.shutdown(wait=True, cancel_futures=True)
        return
    if not callable(getattr(executor, "submit", None)):
        raise ParameterError(f"executor must be a name, an Executor or a dask Client, got {type(executor).__name__}")
    if isinstance(executor, ThreadPoolExecutor):
        with single_threaded_libraries():
            yield _Futures(executor, getattr(executor, "_max_workers", UNKNOWN), own_process=False)
        return
    dask = type(executor).__module__.startswith("distributed")
    known = _dask_threads(executor) if dask else getattr(executor, "_max_workers", UNKNOWN)
    options = {"pure": False, "retries": 2} if dask else {}
    yield _Futures(executor, known, own_process=True, options=options)


@contextmanager
def single_threaded_libraries() -> Iterator[None]:
    """One thread of OpenCV inside; blocks run side by side instead."""
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def available_processors() -> int:
    """How many processors this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1


def can_fork() -> bool:
    """Whether this process may be forked: on Linux, and while it has one thread, those of libraries included.

    A fork copies one thread only; a lock that another one held would stay locked for ever.
    """
    if sys.platform != "linux":
        return False
    try:
        return len(os.listdir("/proc/self/task")) == 1
    except OSError:
        return False


def keep_freed_memory() -> None:
    """Let this process keep the memory that a block gives back for the next one; a process of ours only.

    The C library of Linux returns large arrays to the system at once, and the faults of their pages, taken anew for
    each block, cost a sixth of its time (measured). Elsewhere nothing happens.
    """
    if sys.platform != "linux":
        return
    import ctypes

    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return
    mmap_threshold, trim_threshold = -3, -1
    mallopt(mmap_threshold, 32 << 20)
    mallopt(trim_threshold, 256 << 20)


class _Serial:
    own_process = False

    def run(
        self, function: Callable[..., Any], common: Sequence[Any], items: Sequence[Any], cancel: Canceller | None
    ) -> Iterator[tuple[int, Any]]:
        for position, item in enumerate(items):
            _look(cancel)
            yield position, function(*common, item)


class _Futures:
    """Any object with `submit`, whose futures have `add_done_callback`, `result` and `cancel`."""

    def __init__(self, executor: Any, workers: int, *, own_process: bool, options: dict[str, Any] | None = None):
        self._executor = executor
        self._ahead = max(AHEAD * max(workers, 1), 2)
        self._options = options or {}
        self.own_process = own_process

    def run(
        self, function: Callable[..., Any], common: Sequence[Any], items: Sequence[Any], cancel: Canceller | None
    ) -> Iterator[tuple[int, Any]]:
        done: queue.SimpleQueue[tuple[int, Any]] = queue.SimpleQueue()
        pending: dict[int, Any] = {}
        waiting = iter(enumerate(items))
        try:
            while True:
                while len(pending) < self._ahead:
                    position, item = next(waiting, (-1, None))
                    if position < 0:
                        break
                    future = self._executor.submit(function, *common, item, **self._options)
                    pending[position] = future
                    future.add_done_callback(lambda f, at=position: done.put((at, f)))
                if not pending:
                    return
                try:
                    position, future = done.get(timeout=GLANCE)
                except queue.Empty:
                    _look(cancel)
                    continue
                del pending[position]
                yield position, future.result()
                _look(cancel)
        finally:
            for future in pending.values():
                future.cancel()


class _Processes:
    """Own worker processes, forked; those that die are replaced and what they had in hand is done again."""

    own_process = True

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> _Processes:
        # A library that starts threads of its own here would forbid the fork.
        self._libraries = single_threaded_libraries()
        self._libraries.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._close()
        self._libraries.__exit__(None, None, None)

    def run(
        self, function: Callable[..., Any], common: Sequence[Any], items: Sequence[Any], cancel: Canceller | None
    ) -> Iterator[tuple[int, Any]]:
        left = dict(enumerate(items))
        if self._pool is None and len(left) > 1:
            # Here, so that the workers inherit what the first block has imported and compiled.
            _look(cancel)
            yield 0, function(*common, left.pop(0))
        for attempt in range(REPLACED + 1):
            positions = list(left)
            lane = _Futures(self._open(), self._workers, own_process=True)
            try:
                for at, result in lane.run(function, common, [left[p] for p in positions], cancel):
                    del left[positions[at]]
                    yield positions[at], result
                return
            except BrokenExecutor as error:
                logger.warning("a worker process died (attempt %d); its blocks are done again", attempt + 1)
                self._close()
                last = error
        raise FeatregError(
            f"worker processes died {REPLACED + 1} times ({last}), perhaps for want of memory; use fewer workers, "
            "and --resume keeps the finished blocks"
        ) from last

    def _open(self) -> ProcessPoolExecutor:
        if self._pool is None:
            import multiprocessing

            method = "fork" if can_fork() else "forkserver" if sys.platform != "win32" else "spawn"
            context = multiprocessing.get_context(method)
            self._pool = ProcessPoolExecutor(
                self._workers, mp_context=context, initializer=_start_worker, initargs=(os.getpid(),)
            )
        return self._pool

    def _close(self) -> None:
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


def _start_worker(parent: int) -> None:
    """Leave Ctrl-C to the parent, end with it, and use one thread."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    keep_freed_memory()
    # Inherited through a fork, the variables are late for the libraries, but not for those still to be imported.
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    if sys.platform == "linux" and os.getppid() == parent:
        threading.Thread(target=watch, name="featreg-parent-watch", daemon=True).start()


def _dask_threads(client: Any) -> int:
    try:
        return max(1, int(sum(client.nthreads().values())))
    except Exception:  # a cluster that does not say how large it is still takes tasks
        return UNKNOWN


def _look(cancel: Canceller | None) -> None:
    if cancel is not None and cancel.is_set():
        raise CancelledError("the scene was cancelled; with resume= the finished blocks are kept")
