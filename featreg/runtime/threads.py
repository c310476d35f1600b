"""Threads: how many this process may use, and how many of them the numeric libraries take."""

from __future__ import annotations

import logging
import operator
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar, copy_context
from functools import partial
from itertools import pairwise
from typing import Any, TypeVar

from featreg.errors import ParameterError

logger = logging.getLogger(__name__)
T = TypeVar("T")

#: What OpenCV had before each block of `opencv_threads` that has not ended, in the order in which they began.
_before: list[list[int]] = []
_before_lock = threading.Lock()
#: The threads that were asked for around; None where nobody asked for more than one.
_team: ContextVar[_Team | None] = ContextVar("featreg_threads", default=None)
#: Fewest pixels of a part: about 0.2 ms, where a thread that waits begins after 0.02 to 0.2 ms.
LEAST = 1 << 18
#: How long the system may take to end a thread, s.
LONGEST_END = 1.0

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
    """Run OpenCV on `count` threads inside the block, on as many as before after it.

    The setting is the process's. Where blocks of several threads overlap, that of the last to begin holds, and OpenCV
    has what it had when all have ended, in whichever order.
    """
    import cv2

    with _before_lock:
        mine = [cv2.getNumThreads()]
        _before.append(mine)
        cv2.setNumThreads(count)
    try:
        yield
    finally:
        with _before_lock:
            place = next(k for k, one in enumerate(_before) if one is mine)
            if place == len(_before) - 1:
                cv2.setNumThreads(mine[0])
            else:
                # A block that began later goes on, and gives back at its end what there was before this one.
                _before[place + 1][0] = mine[0]
            del _before[place]


def single_threaded() -> AbstractContextManager[None]:
    """Run OpenCV on one thread inside the block; work runs side by side instead."""
    return opencv_threads(1)


@contextmanager
def limited_threads(count: int | None, algebra: int | None = None) -> Iterator[None]:
    """Let this package and the libraries use at most `count` threads inside the block; None leaves the libraries alone.

    `algebra` is the limit of the linear algebra where it is to be another.

    OpenCV is told directly. The linear algebra starts its threads when it is first imported, which is why the commands
    import nothing heavy before this: a limit set later leaves the threads there, and they forbid a fork.
    """
    algebra = count if algebra is None else algebra
    if algebra is not None and "numpy" not in sys.modules:
        limit_algebra(algebra)
    # More threads than processors would only wait for one another.
    size = min(count or 1, available_processors())
    team = _Team(size) if size > 1 else None
    token = _team.set(team)
    try:
        with nullcontext() if count is None else opencv_threads(size):
            yield
    finally:
        _team.reset(token)
        if team is not None:
            team.dismiss()


def side_by_side(work: Sequence[Callable[[], T]], size: int = LEAST) -> list[T]:
    """Run functions that do not touch each other's things, and return what they return, in order.

    They run at the same time where `limited_threads` around allows more than one thread; one after the other where
    nobody asked for more, inside of `in_parts`, and where each takes no longer than a light pass over `size` pixels,
    fewer than `LEAST`. The results are the same.
    """
    team = _team.get()
    if team is None or len(work) < 2 or size < LEAST:
        return [function() for function in work]
    return team.run(work, divided=False)


def in_parts(work: Callable[[int, int], None], count: int, size: int = LEAST, step: int = 1) -> None:
    """Do the work of rows 0 to `count` by calls of `work(first, behind the last)`, side by side as `side_by_side` does.

    Parameters
    ----------
    work : writes what belongs to some of the rows; what it writes does not depend on how they are divided. It asks for
        no derived maps and takes no locks, as a thread that holds one may do it while it waits.
    count : how many rows there are
    size : pixels of a row; a part has at least `LEAST`, and where not two have as many, all are one part. Where the
        work on one takes longer than a light pass, as many as such a pass would do meanwhile
    step : parts begin at multiples of it

    Notes
    -----
    Where one thread was asked for, `work(0, count)` is called. Otherwise each part is that of the rest which would be
    left to each of twice as many threads: what one is late by, the others make up for. Arrays that `work` fills are
    best made before it: glibc gives those that other threads make and free back to the system.
    """
    team = _team.get()
    least = -(-LEAST // max(size, 1) // step) * step
    if team is None or count < 2 * least:
        work(0, count)
        return
    edges = [0]
    while count - edges[-1] >= 2 * least:
        share = (count - edges[-1]) // (2 * team.size)
        edges.append(edges[-1] + max(share // step * step, least))
    team.run([partial(work, *ends) for ends in pairwise([*edges, count])], divided=True)


class _Team:
    """The thread that makes it and helpers that wait for work beside it, started when there is some.

    Starting threads for each piece of work would take as long as many of them, and the processors' caches with it.
    Who has nothing to do takes part in what any other has begun, whatever lies in whatever: one image of a pair is left
    to each of two threads, and when one of them is done, it helps with the rows of the other's.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self._lock = threading.Lock()
        self._open: list[_Job] = []
        self._sleepers: list[_Sleeper] = []
        self._helpers: list[threading.Thread] = []
        #: Which helpers are wanted: those that were started since the last were dismissed.
        self._crew = 0
        #: How many jobs have not ended.
        self.at_work = 0

    def run(self, work: Sequence[Callable[[], T]], divided: bool) -> list[T]:
        """What functions return, in order; the first error that one of them raises.

        `divided` are those that share out nothing further and take no locks: a thread that waits for its own work may
        do them meanwhile.
        """
        job = _Job(work, divided)
        helpers = min(self.size, len(work)) - 1
        with self._lock:
            self._start(helpers)
            self.at_work += 1
            self._open.append(job)
            self._wake(job, helpers)
        try:
            self._take_part(job)
            while not job.done:
                self._once(lambda: job.done, waits_for=job)
        finally:
            with self._lock:
                self.at_work -= 1
                self._close(job)
        return job.results()

    def _start(self, helpers: int) -> None:
        """Start helpers until there are so many; whoever asks holds the lock, so that two who ask start no more."""
        while len(self._helpers) < helpers:
            helper = threading.Thread(target=self._help, args=(self._crew,), name="featreg", daemon=True)
            try:
                helper.start()
            except RuntimeError:
                # The system has no more threads for us, or the interpreter is about to end: fewer do the same.
                break
            self._helpers.append(helper)

    def dismiss(self) -> None:
        """Let the helpers end, also one that an interrupt kept from being listed while it was started."""
        with self._lock:
            self._crew += 1
            for sleeper in self._sleepers:
                sleeper.bell.release()
            self._sleepers.clear()
        for helper in self._helpers:
            helper.join()
            _wait_for_system(helper)
        self._helpers.clear()

    def _help(self, crew: int) -> None:
        """Take part in whatever there is until the crew is dismissed."""
        while self._crew == crew:
            self._once(lambda: self._crew != crew)

    def _once(self, over: Callable[[], bool], waits_for: _Job | None = None) -> None:
        """Take part in a job that was begun by another thread, or sleep until there may be one, or until it is over:
        the crew is dismissed or, where a thread waits for work of its own, that is done."""
        with self._lock:
            if over():
                return
            # The last to be begun lies innermost, and others wait for it.
            job = next((job for job in reversed(self._open) if job.suits(waits_for)), None)
            if job is None:
                sleeper = _Sleeper(waits_for)
                self._sleepers.append(sleeper)
        if job is not None:
            job.context.copy().run(self._take_part, job, waits_for)
            return
        try:
            sleeper.bell.acquire()
        except BaseException:
            with self._lock:
                if sleeper in self._sleepers:
                    self._sleepers.remove(sleeper)
            raise

    def _take_part(self, job: _Job, waits_for: _Job | None = None) -> None:
        """Do what is left of a job, or until that for which a thread waits is done."""
        token = _team.set(None) if job.divided else None
        try:
            while job.step():
                if waits_for is not None and waits_for.done:
                    break
        finally:
            if token is not None:
                _team.reset(token)
        with self._lock:
            if not job.left:
                self._close(job)
            if job.done:
                for sleeper in self._sleepers:
                    if sleeper.waits_for is job:
                        self._sleepers.remove(sleeper)
                        sleeper.bell.release()
                        break

    def _close(self, job: _Job) -> None:
        if job in self._open:
            self._open.remove(job)

    def _wake(self, job: _Job, most: int) -> None:
        """Wake those that can take part in a job: helpers without work first."""
        if not self._sleepers:
            return
        able = [sleeper for sleeper in self._sleepers if job.suits(sleeper.waits_for)]
        able.sort(key=lambda sleeper: sleeper.waits_for is not None)
        for sleeper in able[:most]:
            self._sleepers.remove(sleeper)
            sleeper.bell.release()


def _wait_for_system(thread: threading.Thread) -> None:
    """Wait until the system, too, has ended a thread that Python has: a moment later, in which no fork is safe."""
    place = f"/proc/self/task/{thread.native_id}"
    late = time.monotonic() + LONGEST_END
    while os.path.exists(place) and time.monotonic() < late:
        time.sleep(0.0002)


class _Sleeper:
    """A thread without work, and for which job it waits, if for any."""

    __slots__ = ("bell", "waits_for")

    def __init__(self, waits_for: _Job | None) -> None:
        self.waits_for = waits_for
        self.bell = threading.Lock()
        self.bell.acquire()


class _Job:
    """Functions of which each thread that takes part runs the next that no other has begun."""

    def __init__(self, work: Sequence[Callable[[], Any]], divided: bool) -> None:
        self.divided, self.context = divided, copy_context()
        self._work = work
        # Threads share this iterator: its next step is one of the interpreter's own, which no other thread divides.
        self._next = iter(range(len(work)))
        self._found: list[Any] = [None] * len(work)
        self._errors: dict[int, BaseException] = {}
        self._to_do, self._lock = len(work), threading.Lock()

    @property
    def left(self) -> int:
        """How many functions no thread has begun."""
        return operator.length_hint(self._next)

    @property
    def done(self) -> bool:
        """Whether all have ended."""
        return self._to_do == 0

    def suits(self, waits_for: _Job | None) -> bool:
        """Whether a thread can take part; one that waits for its own work may hold locks that undivided work takes."""
        return bool(self.left) and (waits_for is None or self.divided)

    def step(self) -> bool:
        """Run the next function; False where there is none."""
        i = next(self._next, None)
        if i is None:
            return False
        ended = 1
        try:
            self._found[i] = self._work[i]()
        except BaseException as error:
            self._errors[i] = error
            # What no thread has begun is left out. All that stands before `i` has been begun, so that the first error
            # of all is among those found.
            ended += sum(1 for _ in self._next)
        with self._lock:
            self._to_do -= ended
        return True

    def results(self) -> list[Any]:
        """What the functions returned, when all have; the error of the first that raised one."""
        if not self._errors:
            return self._found
        error = self._errors[min(self._errors)]
        self._errors.clear()
        try:
            raise error
        finally:
            # The error holds this frame: together they would keep what the functions hold until the next collection.
            del error


def stated_threads() -> int | None:
    """How many threads OMP_NUM_THREADS allows; None where it says nothing, or nothing that makes sense, which is said.

    As OpenMP has it: a whole number above 0, or one for each level of nested threads, of which the first counts.
    """
    stated = os.environ.get("OMP_NUM_THREADS", "").strip()
    try:
        count = int(stated.partition(",")[0])
    except ValueError:
        count = 0
    if stated and count < 1:
        logger.warning("OMP_NUM_THREADS is '%s', which is no number of threads above 0: it sets no limit", stated)
    return count if count >= 1 else None


def use_one_thread() -> None:
    """Let nothing in this process run side by side from here on, whatever was asked for where it was forked from."""
    import cv2

    cv2.setNumThreads(1)
    _team.set(None)


def end_helpers() -> None:
    """End the threads that wait for work here, so that this process may be forked; later work starts them again.

    Where it is itself part of what they do, they stay.
    """
    team = _team.get()
    if team is not None and not team.at_work:
        team.dismiss()


def limit_algebra(count: int) -> None:
    """Tell this process's libraries of linear algebra that are not imported yet to use `count` threads."""
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, str(count)))
