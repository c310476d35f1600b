"""Who runs the tasks: in which order results come, what a cancellation and a dying worker cost."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from featreg.errors import CancelledError, ParameterError
from featreg.runtime.executors import InProcessExecutor, open_executor
from featreg.runtime.workers import can_fork


@pytest.mark.parametrize("name", ["serial", "threads", "processes"])
def test_every_item_is_done_once(name: str) -> None:
    with open_executor(name, 2) as executor:
        assert executor.own_process == (name == "processes")
        assert dict(executor.run(_double, (), list(range(9)), None)) == {k: 2 * k for k in range(9)}
        assert list(executor.run(_double, (), [], None)) == []


def test_serially_nothing_is_done_ahead() -> None:
    done: list[int] = []
    with open_executor("serial", None) as executor:
        running = executor.run(done.append, (), [1, 2, 3], None)
        assert next(running) == (0, None)
        assert done == [1]


@pytest.mark.parametrize("name", ["serial", "threads", "processes"])
def test_a_cancellation_stops_the_work(name: str) -> None:
    stop = threading.Event()
    with open_executor(name, 2) as executor:
        running = executor.run(_double, (), list(range(1000)), stop)
        assert len(list(itertools.islice(running, 3))) == 3
        stop.set()
        with pytest.raises(CancelledError):
            next(running)


def test_executors_of_others(tmp_path: Path) -> None:
    with ThreadPoolExecutor(2) as threads, open_executor(threads, None) as executor:
        assert not executor.own_process
        assert dict(executor.run(_double, (), [1, 2], None)) == {0: 2, 1: 4}
    with open_executor(InProcessExecutor(), None) as executor:
        assert not executor.own_process
        with pytest.raises(ZeroDivisionError):
            list(executor.run(divmod, (1,), [0], None))
    for given in ("fast", 3, object()):
        with pytest.raises(ParameterError, match="executor must be"), open_executor(given, None):
            pass


ASKED_AROUND = """
import threading, time
from featreg.runtime.threads import limited_threads, side_by_side

def alone(_):
    import cv2
    def by():
        time.sleep(0.05)  # so long that one thread does not do both
        return threading.current_thread() is threading.main_thread()
    return cv2.getNumThreads(), sorted(side_by_side([by] * 2))

if __name__ == "__main__":
    with limited_threads(2, algebra=1):
        from featreg.runtime.executors import open_executor
        from featreg.runtime.workers import can_fork
        print(can_fork())
        with open_executor("processes", 2) as executor:
            print(dict(sorted(executor.run(alone, (), [1, 2, 3], None))))
"""


def test_workers_use_one_thread_whatever_was_asked_around_them(tmp_path: Path) -> None:
    """The command line asks for two around everything, and forks its workers inside that."""
    script = tmp_path / "asked.py"
    script.write_text(ASKED_AROUND)
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=True)
    forked, results = done.stdout.splitlines()
    # The first is done before there are workers, by two threads.
    assert results == str({0: (1, [False, True]), 1: (1, [True, True]), 2: (1, [True, True])})
    assert forked == str(sys.platform == "linux")


def test_workers_that_die_are_replaced(tmp_path: Path) -> None:
    with open_executor("processes", 2) as executor:
        got = dict(executor.run(_dies_once, (str(tmp_path / "died"),), list(range(8)), None))
    assert got == {k: k for k in range(8)}


def _dies_once(flag: str, number: int) -> int:
    if number == 5 and not Path(flag).exists():
        Path(flag).touch()
        os._exit(1)
    return number


def test_a_broken_wait_for_the_workers_is_not_broken_off_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """A second Ctrl-C while the workers end would leave them waiting for ever."""
    before = signal.getsignal(signal.SIGINT)
    during: list[Any] = []
    with open_executor("processes", 2) as executor:
        running = executor.run(_double, (), list(range(6)), None)
        assert next(running) == (0, 0)
        next(running)
        shutdown = ProcessPoolExecutor.shutdown

        def watched(pool: Any, **keywords: Any) -> None:
            during.append(signal.getsignal(signal.SIGINT))
            shutdown(pool, **keywords)

        monkeypatch.setattr(ProcessPoolExecutor, "shutdown", watched)
    assert during == [signal.SIG_IGN]
    assert signal.getsignal(signal.SIGINT) == before


def _double(number: int) -> int:
    return 2 * number


def test_a_process_with_several_threads_is_not_forked() -> None:
    stop = threading.Event()
    thread = threading.Thread(target=stop.wait)
    thread.start()
    try:
        assert not can_fork()
    finally:
        stop.set()
        thread.join()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="processes are forked on Linux only")
def test_forked_workers_end_with_their_parent(tmp_path: Path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(
        "import os, pathlib, sys, time\n"
        "from featreg.runtime.executors import open_executor\n"
        "def work(number):\n"
        "    if number:\n"
        "        pathlib.Path(sys.argv[1], str(os.getpid())).touch()\n"
        "        time.sleep(600)\n"
        "with open_executor('processes', 2) as executor:\n"
        "    list(executor.run(work, (), range(5), None))\n"
    )
    (tmp_path / "pids").mkdir()
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    parent = subprocess.Popen([sys.executable, str(script), str(tmp_path / "pids")], env=os.environ | threads)
    deadline = time.monotonic() + 60
    while len(list((tmp_path / "pids").iterdir())) < 2 and time.monotonic() < deadline:
        time.sleep(0.05)
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    pids = [int(path.name) for path in (tmp_path / "pids").iterdir()]
    assert len(pids) == 2
    while any(map(_alive, pids)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(map(_alive, pids))


def _alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
