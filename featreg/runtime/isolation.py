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
import types
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from multiprocessing import spawn
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from typing import Any, ParamSpec, TypeVar

from featreg import errors
from featreg.errors import FeatregError, ParameterError
from featreg.runtime.threads import worker_count
from featreg.runtime.workers import start_worker

P = ParamSpec("P")
T = TypeVar("T")

#: Seconds within which a fresh process must have loaded this package.
START_LIMIT = 300.0
NAME = "featreg-worker"
_script = threading.Lock()


class WorkerLostError(FeatregError):
    """The process of a job died by itself, or was stopped at its time limit."""


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
        if time_limit is not None and not time_limit > 0:
            raise ParameterError(f"time_limit must be a number of seconds > 0, got {time_limit}")
        if multiprocessing.current_process().name == NAME:
            raise ParameterError(
                "a worker cannot start workers: a script that defines a method must keep its work below "
                'if __name__ == "__main__":'
            )
        self.time_limit = time_limit
        self._workers = [_Worker(time_limit, prepare) for _ in range(worker_count(workers))]
        self._idle: queue.SimpleQueue[_Worker] = queue.SimpleQueue()
        for worker in self._workers:
            self._idle.put(worker)
        # One thread waits for each process.
        self._threads = ThreadPoolExecutor(len(self._workers), NAME)

    @property
    def starts(self) -> int:
        """Processes started so far; it grows when one had to be replaced."""
        return sum(worker.starts for worker in self._workers)

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Queue a call; function, arguments and result must be picklable."""
        return self._threads.submit(self._run, fn, args, kwargs)

    def _run(self, *call: Any) -> Any:
        worker = self._idle.get()
        try:
            return worker.run(call)
        finally:
            self._idle.put(worker)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Stop the workers; with `cancel_futures`, drop what is queued and end what is running."""
        self._threads.shutdown(wait=False, cancel_futures=cancel_futures)
        if cancel_futures:
            for worker in self._workers:
                worker.stop()
        ending = threading.Thread(target=self._end)
        ending.start()
        if wait:
            ending.join()

    def _end(self) -> None:
        self._threads.shutdown()
        for worker in self._workers:
            worker.kill()


class _Worker:
    """One process after the other, each with one job at a time."""

    def __init__(self, time_limit: float | None, prepare: Callable[[], None] | None) -> None:
        self.time_limit, self.prepare = time_limit, prepare
        self.starts, self.done = 0, 0
        self.process: Any = None
        self.pipe: Connection | None = None
        self.stopping = False

    def stop(self) -> None:
        """End what is running; called from another thread, so the pipe is left to that of the job."""
        self.stopping = True
        process = self.process
        if process is not None:
            process.kill()

    def run(self, call: tuple[Any, ...]) -> Any:
        """What the call returns or raises; once more in a fresh process where a used one died of it."""
        try:
            content = bytes(ForkingPickler.dumps(call))
        except Exception as error:
            raise ParameterError(f"the job cannot be sent to another process: {error}") from error
        pipe = self._ready()
        used = self.done > 0
        try:
            answer = self._answer(pipe, content)
        except (EOFError, OSError) as error:
            fate = self._fate()
            if not used or self.stopping:
                raise WorkerLostError(f"its process {fate}") from error
            return self.run(call)
        self.done += 1
        good, value = ForkingPickler.loads(answer)
        if not good:
            raise _error(*value)
        return value

    def _answer(self, pipe: Connection, content: bytes) -> bytes:
        pipe.send(_main_module() if b"__main__" in content else None)
        pipe.send_bytes(content)
        if not pipe.poll(self.time_limit):
            self.kill()
            raise WorkerLostError(f"it took longer than {self.time_limit:g} s and was stopped")
        return pipe.recv_bytes()

    def _ready(self) -> Connection:
        """The pipe to a living process, a fresh one where there is none."""
        if self.pipe is not None and self.process.is_alive():
            return self.pipe
        self.kill()
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(theirs,), name=NAME, daemon=True)
        with _without_script():
            process.start()
        theirs.close()
        self.process = process
        self.starts += 1
        if self.stopping:
            self.kill()
            raise WorkerLostError("the work was stopped")
        try:
            self.pipe.send(self.prepare)
            if not self.pipe.poll(START_LIMIT):
                self.kill()
                raise WorkerLostError(f"a worker process was not ready after {START_LIMIT:g} s")
            self.pipe.recv()
        except (EOFError, OSError) as error:
            raise WorkerLostError(f"a worker process {self._fate()} before it was ready") from error
        return self.pipe

    def _fate(self) -> str:
        """How the process ended."""
        self.process.join(5)
        code = self.process.exitcode
        self.kill()
        if code is not None and code < 0:
            with contextlib.suppress(ValueError):
                return f"died of {signal.Signals(-code).name}"
        return f"ended with exit code {code}"

    def kill(self) -> None:
        """End the process, if there is one."""
        process, pipe, self.process, self.pipe, self.done = self.process, self.pipe, None, None, 0
        if process is not None:
            process.kill()
            process.join()
        if pipe is not None:
            pipe.close()


@contextlib.contextmanager
def _without_script() -> Iterator[None]:
    """Let a process started inside the block not load the caller's script.

    A spawned process runs it again, all of it where nothing in it says otherwise, unless it finds an empty one.
    """
    with _script:
        before = sys.modules["__main__"]
        sys.modules["__main__"] = types.ModuleType("__main__")
        try:
            yield
        finally:
            sys.modules["__main__"] = before


def _main_module() -> dict[str, Any]:
    """What a process must load to know the caller's script."""
    main = sys.modules["__main__"]
    name, path = getattr(main.__spec__, "name", None), getattr(main, "__file__", None)
    if name is not None:
        return {"init_main_from_name": name}
    return {} if path is None else {"init_main_from_path": os.path.abspath(path)}


def _serve(pipe: Connection) -> None:
    """Work off calls until the pipe closes: the main loop of a worker process."""
    # Before anything that imports a numeric library.
    start_worker()
    prepare = pipe.recv()
    if prepare is not None:
        prepare()
    pipe.send(None)
    with contextlib.suppress(EOFError, OSError):
        while True:
            script = pipe.recv()
            pipe.send_bytes(_answer(script, pipe.recv_bytes()))


def _answer(script: dict[str, Any] | None, content: bytes) -> bytes:
    """Run a pickled call; (True, value) or (False, (name, text) of the error), pickled."""
    try:
        if script:
            spawn.prepare(script)
        function, args, keywords = ForkingPickler.loads(content)
        value = function(*args, **keywords)
    except BaseException as error:
        return bytes(ForkingPickler.dumps((False, (type(error).__name__, str(error)))))
    try:
        return bytes(ForkingPickler.dumps((True, value)))
    except Exception as error:
        text = f"the result cannot be sent back: {error}"
        return bytes(ForkingPickler.dumps((False, (type(error).__name__, text))))


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
