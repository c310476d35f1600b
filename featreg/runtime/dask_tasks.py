"""Tasks on a dask cluster, in bundles: a task of its own costs the scheduler and the client milliseconds each.

A bundle takes its share of what is left, so that bundles grow small towards the end and no worker waits long for the
last (guided self-scheduling: C. D. Polychronopoulos, D. J. Kuck, IEEE Transactions on Computers C-36, 1987,
https://doi.org/10.1109/TC.1987.5009495).
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import math
import queue
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from featreg.errors import FeatregError
from featreg.runtime.watching import GLANCE, Canceller, end_if_set

#: Bundles handed over ahead of the results for each thread of the cluster.
AHEAD = 3
#: Most items of a bundle and seconds that it may take, since it is lost with its worker; and for how many bundles a
#: thread those left are meant.
LARGEST, LONGEST, SHARES = 16, 1.0, 4
#: Seconds that the scheduler takes for a bundle, so that many workers get larger ones than their share.
SERVED = 0.004
#: Seconds after which the cluster is asked anew how large it is.
ASKED_EVERY = 5.0
#: Threads of a cluster that does not say how many it has.
UNKNOWN = 16
#: Seconds that a cluster may be without any worker before the run gives up.
FORSAKEN = 300.0

GONE = "the connection to the dask scheduler was lost or closed, and the tasks with it"


class DaskTasks:
    """Runs tasks on the cluster of a `dask.distributed.Client`; workers may come and go meanwhile."""

    own_process = True

    def __init__(self, client: Any) -> None:
        self._client = client
        self._threads, self._asked, self._seen = 0, 0.0, time.monotonic()

    def run(
        self, function: Callable[..., Any], common: Sequence[Any], items: Sequence[Any], cancel: Canceller | None
    ) -> Iterator[tuple[int, Any]]:
        """Yield (position of the item, result) in any order.

        Raises
        ------
        FeatregError
            The scheduler is gone or has had no workers for long, or one bundle took too many workers down.
        """
        done: queue.SimpleQueue[Any] = queue.SimpleQueue()
        pending: dict[Any, list[int]] = {}
        left = deque(enumerate(items))
        count, seconds = 0, 0.0
        # Nobody asked while there was nothing to run.
        self._seen = time.monotonic()
        try:
            while left or pending:
                end_if_set(cancel)
                threads = self._threads_now()
                while left and len(pending) < AHEAD * threads:
                    size = bundle_size(len(left), threads, seconds / count if count else LONGEST)
                    bundle = [left.popleft() for _ in range(size)]
                    future = self._submitted(_each, function, tuple(common), [item for _, item in bundle])
                    pending[future] = [position for position, _ in bundle]
                    future.add_done_callback(done.put)
                finished = _all_of(done)
                if finished:
                    # Together, because each question to the scheduler takes its time.
                    for future, (results, taken) in zip(finished, self._gathered(finished), strict=True):
                        count, seconds = count + len(results), seconds + taken
                        yield from zip(pending.pop(future), results, strict=True)
        finally:
            for future in pending:
                future.cancel()

    def _threads_now(self) -> int:
        now = time.monotonic()
        if not self._threads or now > self._asked + ASKED_EVERY:
            self._threads, self._asked = _threads_of(self._client), now
            if self._threads:
                self._seen = now
            elif now > self._seen + FORSAKEN:
                raise FeatregError(f"the dask cluster has had no workers for {FORSAKEN:g} s; start some and try again")
        return max(1, self._threads)

    def _submitted(self, *call: Any) -> Any:
        with _in_one_line():
            return self._client.submit(*call, pure=False, retries=2)

    def _gathered(self, futures: list[Any]) -> list[Any]:
        with _in_one_line():
            return list(self._client.gather(futures))


def bundle_size(left: int, threads: int, seconds: float) -> int:
    """How many of the items left, which take so many seconds each, make the next task."""
    each = max(seconds, 1e-9)
    # Where the scheduler hands out as fast as all workers work, and where handing out takes as long as the last bundle.
    served = min(threads * SERVED / each, math.sqrt(left * SERVED / each))
    return min(left, max(1, int(min(LARGEST, LONGEST / each, max(left // (SHARES * threads), served)))))


def _each(function: Callable[..., Any], common: tuple[Any, ...], items: Sequence[Any]) -> tuple[list[Any], float]:
    """The results of a bundle, and the seconds that they took on the worker."""
    start = time.monotonic()
    return [function(*common, item) for item in items], time.monotonic() - start


def _all_of(done: queue.SimpleQueue[Any]) -> list[Any]:
    """What is finished, after a short wait where nothing is."""
    finished = []
    try:
        finished.append(done.get(timeout=GLANCE))
        while True:
            finished.append(done.get_nowait())
    except queue.Empty:
        return finished


def _threads_of(client: Any) -> int:
    try:
        return int(sum(client.nthreads().values()))
    except Exception:  # a cluster that does not say how large it is still takes tasks
        return UNKNOWN


@contextmanager
def _in_one_line() -> Iterator[None]:
    """Say in one line what dask says in many; what a task itself raised passes through."""
    try:
        yield
    except (concurrent.futures.CancelledError, asyncio.CancelledError) as error:
        raise FeatregError(GONE) from error
    except Exception as error:
        kind = type(error).__name__ if type(error).__module__.startswith("distributed") else ""
        if kind in ("CommClosedError", "ClosedClientError"):
            raise FeatregError(GONE) from error
        if kind == "KilledWorker":
            last = getattr(getattr(error, "last_worker", None), "address", "unknown")
            raise FeatregError(
                f"the same task took one worker of the dask cluster after the other down, the last {last}, perhaps for "
                "want of memory; give each worker more (--memory-limit of 'dask worker')"
            ) from error
        raise
