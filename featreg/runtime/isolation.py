"""An executor whose jobs cannot harm each other: worker processes that may raise, hang or die.

`concurrent.futures.ProcessPoolExecutor` is broken for good when one of its processes dies, and waits for ever for one
that hangs. Here each worker is a process of its own with one job at a time; the job that kills it, or outlives the
time limit, is the only one lost, and a fresh process takes the next.
"""

from __future__ import annotations

import builtins
import contextlib
import multiprocessing
import os
import queue
import signal
import sys
import threading
import time
import types
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from multiprocessing import spawn
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import ForkingPickler
from typing import Any, ParamSpec, TypeVar

from featreg import errors
from featreg.errors import FeatregError, ParameterError

P = ParamSpec("P")
T = TypeVar("T")

#: Read by the numeric libraries when they are first imported: one thread for each worker.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
#: Seconds within which a fresh process must have loaded this package.
START_LIMIT = 300.0
NAME = "featreg-worker"
_environment = threading.Lock()


class WorkerLostError(FeatregError):
    """The process of a job died by itself (`died`), or was stopped at its time limit."""

    died = False


@dataclass(frozen=True)
class _Job:
    future: Future[Any]
    call: tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any]]


class IsolatedExecutor(Executor):
    """Run jobs in worker processes, one at a time in each, and survive whatever they do.

    Parameters
    ----------
    workers : processes, each limited to one thread of the numeric libraries
    time_limit : seconds that one job may take, measured on the clock; None for no limit. Starting a process does not
        count, compiling kernels in it does.
    prepare : a function of a module, called in each fresh process before its first job's clock starts

    Notes
    -----
    A process that dies while it runs a job may have been damaged by an earlier one, so the job is tried once more in a
    fresh process before its future gets a `WorkerLostError`. Processes are spawned, not forked: forking one that has
    started threads can hang. The caller's script is loaded in them only for a job that uses what is defined in it, such
    as a matcher written there; only then must it keep its work below ``if __name__ == "__main__":``.
    """

    def __init__(
        self, workers: int = 1, time_limit: float | None = None, prepare: Callable[[], None] | None = None
    ) -> None:
        if workers < 1:
            raise ParameterError(f"workers must be a whole number >= 1, got {workers}")
        if time_limit is not None and not time_limit > 0:
            raise ParameterError(f"time_limit must be a number of seconds > 0, got {time_limit}")
        if multiprocessing.current_process().name == NAME:
            raise ParameterError(
                "a worker cannot start workers: a script that defines a method must keep its work below "
                'if __name__ == "__main__":'
            )
        self.time_limit = time_limit
        self._jobs: queue.SimpleQueue[_Job | None] = queue.SimpleQueue()
        self._closed = False
        self._workers = [_Worker(self._jobs, time_limit, prepare) for _ in range(workers)]

    @property
    def starts(self) -> int:
        """Processes started so far; it grows when one had to be replaced."""
        return sum(worker.starts for worker in self._workers)

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Queue a call; function, arguments and result must be picklable."""
        if self._closed:
            raise RuntimeError("this executor was shut down")
        future: Future[T] = Future()
        self._jobs.put(_Job(future, (fn, args, dict(kwargs))))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Stop the workers; with `cancel_futures`, drop what is queued and end what is running."""
        self._closed = True
        if cancel_futures:
            with contextlib.suppress(queue.Empty):
                while True:
                    job = self._jobs.get_nowait()
                    if job is not None:
                        job.future.cancel()
            for worker in self._workers:
                worker.stop()
        for _ in self._workers:
            self._jobs.put(None)
        if wait:
            for worker in self._workers:
                worker.thread.join()


class _Worker:
    """A thread that feeds one process after the other."""

    def __init__(
        self,
        jobs: queue.SimpleQueue[_Job | None],
        time_limit: float | None,
        prepare: Callable[[], None] | None,
    ) -> None:
        self.jobs, self.time_limit, self.prepare = jobs, time_limit, prepare
        self.starts, self.done = 0, 0
        self.process: Any = None
        self.pipe: Connection | None = None
        self.stopping = False
        self.thread = threading.Thread(target=self._feed, name="featreg-worker", daemon=True)
        self.thread.start()

    def stop(self) -> None:
        """End what is running; called from another thread, so the pipe is left to this one."""
        self.stopping = True
        process = self.process
        if process is not None:
            process.kill()

    def _feed(self) -> None:
        while (job := self.jobs.get()) is not None:
            if not job.future.set_running_or_notify_cancel():
                continue
            try:
                used = self.process is not None and self.done > 0
                try:
                    value = self._run(job)
                except WorkerLostError as error:
                    if not error.died or not used or self.stopping:
                        raise
                    value = self._run(job)
            except BaseException as error:
                job.future.set_exception(error)
            else:
                job.future.set_result(value)
            # Neither the job nor its images may outlive it in this loop.
            del job
        self._kill()

    def _run(self, job: _Job) -> Any:
        pipe = self._ready()
        try:
            content = ForkingPickler.dumps(job.call)
        except Exception as error:
            raise ParameterError(f"the job cannot be sent to another process: {error}") from error
        try:
            pipe.send(_script() if b"__main__" in bytes(content) else None)
            pipe.send_bytes(content)
            if not pipe.poll(self.time_limit):
                self._kill()
                raise WorkerLostError(f"it took longer than {self.time_limit:g} s and was stopped")
            good, value = pipe.recv()
        except (EOFError, OSError) as error:
            raise self._died() from error
        self.done += 1
        if not good:
            raise _error(*value)
        return value

    def _ready(self) -> Connection:
        """The pipe to a living process, a fresh one where there is none."""
        if self.pipe is not None and self.process.is_alive():
            return self.pipe
        self._kill()
        if self.stopping:
            raise WorkerLostError("the work was stopped")
        context = multiprocessing.get_context("spawn")
        mine, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, self.prepare), name=NAME, daemon=True)
        with _apart():
            self.process.start()
        theirs.close()
        self.pipe, self.done = mine, 0
        self.starts += 1
        try:
            if not mine.poll(START_LIMIT):
                self._kill()
                raise WorkerLostError(f"a worker process was not ready after {START_LIMIT:g} s")
            mine.recv()
        except (EOFError, OSError) as error:
            raise WorkerLostError(f"a worker process {self._fate()} before it was ready") from error
        return mine

    def _died(self) -> WorkerLostError:
        error = WorkerLostError(f"its process {self._fate()}")
        error.died = True
        return error

    def _fate(self) -> str:
        """How the process ended."""
        self.process.join(5)
        code = self.process.exitcode
        self._kill()
        if code is not None and code < 0:
            with contextlib.suppress(ValueError):
                return f"died of {signal.Signals(-code).name}"
        return f"ended with exit code {code}"

    def _kill(self) -> None:
        process, pipe, self.process, self.pipe = self.process, self.pipe, None, None
        if process is not None:
            process.kill()
            process.join()
        if pipe is not None:
            pipe.close()


@contextlib.contextmanager
def _apart() -> Iterator[None]:
    """Let processes started inside the block use one thread of the numeric libraries, and not load the script.

    A spawned process runs the caller's script again, all of it where nothing in it says otherwise, unless it finds an
    empty one.
    """
    with _environment:
        before = {name: os.environ.get(name) for name in THREADS}
        script = sys.modules["__main__"]
        os.environ.update(dict.fromkeys(THREADS, "1"))
        sys.modules["__main__"] = types.ModuleType("__main__")
        try:
            yield
        finally:
            sys.modules["__main__"] = script
            for name, value in before.items():
                if value is None:
                    os.environ.pop(name, None)
                else:
                    os.environ[name] = value


def _script() -> dict[str, Any]:
    """What a process must load to know the caller's script."""
    main = sys.modules["__main__"]
    name, path = getattr(main.__spec__, "name", None), getattr(main, "__file__", None)
    if name is not None:
        return {"init_main_from_name": name}
    return {} if path is None else {"init_main_from_path": os.path.abspath(path)}


def _serve(pipe: Connection, prepare: Callable[[], None] | None) -> None:
    """Work off calls until the pipe closes: the main loop of a worker process."""
    # Ctrl-C reaches every process of the terminal; the parent alone reacts.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_die_with_parent, daemon=True).start()
    import cv2

    if prepare is not None:
        prepare()
    cv2.setNumThreads(1)
    pipe.send(None)
    while True:
        try:
            script = pipe.recv()
            content = pipe.recv_bytes()
        except (EOFError, OSError):
            return
        answer: tuple[bool, Any]
        try:
            if script:
                spawn.prepare(script)
            function, args, keywords = ForkingPickler.loads(content)
            answer = True, function(*args, **keywords)
        except BaseException as error:
            answer = False, (type(error).__name__, str(error))
        try:
            pipe.send(answer)
        except OSError:
            return
        except Exception as error:
            pipe.send((False, (type(error).__name__, f"the result cannot be sent back: {error}")))


def _error(name: str, text: str) -> BaseException:
    """What a job raised, as one of our errors or Python's, else as a `RuntimeError` that names it.

    Not the object itself: an exception of a plugin may go into a pickle and never come out.
    """
    kind = getattr(errors, name, None) or getattr(builtins, name, None)
    plain = FeatregError | ArithmeticError | LookupError | ValueError | TypeError
    if isinstance(kind, type) and issubclass(kind, plain):
        with contextlib.suppress(TypeError):
            return kind(text)
    return RuntimeError(f"{name}: {text}" if text else name)


def _die_with_parent() -> None:
    """End this process when its parent is gone, however it went: a hanging job must not outlive it."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        time.sleep(0.1)
        os._exit(1)
