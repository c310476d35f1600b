"""Workers that raise, hang or die: what they cost, and what they must not."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError, ParameterError
from featreg.runtime.isolation import IsolatedExecutor, WorkerLostError
from featreg.study.comparison import compare

ROGUES = """
import ctypes, os, signal, sys, time
from dataclasses import dataclass
import numpy as np
from featreg.errors import InputError
from featreg.interfaces import Matcher
from featreg.types import Matches


def crash():
    ctypes.string_at(0)


@dataclass(frozen=True)
class Good(Matcher):
    def match(self, reference, secondary):
        xy = np.random.default_rng(0).uniform(5, 60, (40, 2))
        return Matches(xy, xy + (2.0, 1.0), np.ones(40))


@dataclass(frozen=True)
class Raises(Good):
    def match(self, reference, secondary):
        raise ValueError("the plugin fell over")


@dataclass(frozen=True)
class Hangs(Good):
    def match(self, reference, secondary):
        time.sleep(600)


@dataclass(frozen=True)
class Dies(Good):
    def match(self, reference, secondary):
        crash()


@dataclass(frozen=True)
class Exits(Good):
    def match(self, reference, secondary):
        sys.exit("enough")


def cut_off():
    # Killed in the middle of handing its result back, as by the system when memory is short.
    from multiprocessing import connection

    def half(self, content):
        os.write(self.fileno(), bytes(content)[: len(content) // 2])
        os.kill(os.getpid(), signal.SIGKILL)

    connection.Connection._send = half
    return bytes(1 << 20)


STATE = {"poisoned": False}


def poison():
    STATE["poisoned"] = True


def delicate():
    if STATE["poisoned"]:
        os.kill(os.getpid(), signal.SIGKILL)
    return "well"


class Odd(Exception):
    def __init__(self, a, b):
        super().__init__(a)


def odd():
    raise Odd("an exception that goes into a pickle and never comes out", 2)


def unsendable():
    return lambda: 1


def refuse(text):
    raise InputError(text)


def threads():
    import cv2
    return os.environ["OMP_NUM_THREADS"], cv2.getNumThreads(), os.getpid()


def sleep(seconds):
    time.sleep(seconds)
    return seconds
"""


@pytest.fixture(scope="module")
def rogues(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A module of ill-behaved plugins, importable in workers too."""
    home = tmp_path_factory.mktemp("rogues")
    (home / "rogues.py").write_text(ROGUES)
    sys.path.insert(0, str(home))
    import rogues  # type: ignore[import-not-found]

    yield rogues
    sys.path.remove(str(home))


@pytest.fixture(scope="module")
def worker() -> Iterator[IsolatedExecutor]:
    with IsolatedExecutor(1) as executor:
        yield executor


def image(seed: int) -> Any:
    return np.random.default_rng(seed).random((64, 64)).astype(np.float32)


def test_what_a_plugin_does_costs_its_own_row_only(rogues: Any) -> None:
    pair = (image(0), image(1), [[1, 0, 2], [0, 1, 1]])
    methods = [
        rogues.Good(),
        rogues.Raises(),
        rogues.Hangs(),
        rogues.Dies(),
        rogues.Exits(),
        ("good 2", {"method": rogues.Good()}),
    ]
    table = compare([pair], methods, time_limit=5.0, timing=False, filters=["fsc"])
    rows = {row["method"]: row for row in table.rows}
    assert table.failed == 4
    assert rows["Raises"]["reason"] == "ValueError: the plugin fell over"
    assert rows["Hangs"]["reason"] == "WorkerLostError: it took longer than 5 s and was stopped"
    assert rows["Dies"]["reason"] == "WorkerLostError: its process died of SIGSEGV"
    assert "enough" in rows["Exits"]["reason"]
    for name in ("Good", "good 2"):
        assert (rows[name]["nm"], rows[name]["ncm"], rows[name]["precision"]) == (40, 40, 1.0)


@pytest.mark.slow
def test_two_workers_give_the_same_rows_and_the_serial_pass_survives_too(rogues: Any) -> None:
    pairs = [(image(i), image(i + 1), [[1, 0, 2], [0, 1, 1]]) for i in range(2)]
    methods = [rogues.Good(), rogues.Dies(), rogues.Raises()]
    one = compare(pairs, methods, isolate=True, filters=["fsc"])
    two = compare(pairs, methods, workers=2, filters=["fsc"])
    assert one.failed == 4
    for a, b in zip(one.rows, two.rows, strict=True):
        assert {**a, "time_s": None} == {**b, "time_s": None}
        assert (a["time_s"] is None) == (a["status"] == "failed")
        assert (b["time_s"] is None) == (b["status"] == "failed")


def test_errors_come_back_as_what_they_were(rogues: Any, worker: IsolatedExecutor) -> None:
    with pytest.raises(InputError, match="no such thing"):
        worker.submit(rogues.refuse, "no such thing").result()
    with pytest.raises(ZeroDivisionError):
        worker.submit(divmod, 1, 0).result()
    with pytest.raises(RuntimeError, match="Odd: an exception"):
        worker.submit(rogues.odd).result()
    with pytest.raises(RuntimeError, match="the result cannot be sent back"):
        worker.submit(rogues.unsendable).result()
    with pytest.raises(ParameterError, match="cannot be sent"):
        worker.submit(lambda: 1).result()
    assert worker.submit(pow, 2, 10).result() == 1024
    assert worker.starts == 1


def test_a_worker_has_one_thread(rogues: Any, worker: IsolatedExecutor) -> None:
    before = os.environ.get("OMP_NUM_THREADS")
    assert worker.submit(rogues.threads).result()[:2] == ("1", 1)
    assert os.environ.get("OMP_NUM_THREADS") == before


def test_a_job_that_met_a_damaged_process_is_tried_in_a_fresh_one(rogues: Any) -> None:
    with IsolatedExecutor(1) as executor:
        executor.submit(rogues.poison).result()
        assert executor.submit(rogues.delicate).result() == "well"
        assert executor.starts == 2
        with pytest.raises(WorkerLostError, match="died of SIGSEGV"):
            executor.submit(rogues.crash).result()
        assert executor.submit(abs, -3).result() == 3


def test_a_process_killed_while_it_answers_costs_its_own_job_only(rogues: Any) -> None:
    with IsolatedExecutor(2) as executor:
        lost = executor.submit(rogues.cut_off)
        others = [executor.submit(pow, 2, k) for k in range(4)]
        with pytest.raises(WorkerLostError, match="died of SIGKILL"):
            lost.result(60)
        assert [other.result(60) for other in others] == [1, 2, 4, 8]


def test_what_is_queued_is_finished_when_the_executor_is_left(rogues: Any) -> None:
    with IsolatedExecutor(1) as executor:
        futures = [executor.submit(abs, -k) for k in range(3)]
        pid = executor.submit(rogues.threads).result()[2]
    assert [future.result() for future in futures] == [0, 1, 2]
    assert not alive(pid)


SCRIPT = """
import sys
from dataclasses import dataclass
import numpy as np
from featreg import Matches, Matcher, compare

@dataclass(frozen=True)
class Mine(Matcher):
    def match(self, reference, secondary):
        xy = np.random.default_rng(0).uniform(5, 60, (40, 2))
        return Matches(xy, xy, np.ones(40))

def work():
    images = [np.random.default_rng(i).random((64, 64)).astype(np.float32) for i in range(2)]
    print(compare([images], [Mine()], isolate=True, timing=False, filters=["fsc"]).rows[0], flush=True)
"""


@pytest.mark.slow
def test_a_matcher_of_the_callers_script_is_loaded_from_there(tmp_path: Path) -> None:
    for name, call, word in (
        ("good", "if __name__ == '__main__':\n    work()", "'nm': 40"),
        ("bad", "work()", "must keep its work below"),
    ):
        path = tmp_path / f"{name}.py"
        path.write_text(f"{SCRIPT}\n{call}\n")
        done = subprocess.run([sys.executable, str(path)], capture_output=True, text=True, check=True)
        assert word in done.stdout.splitlines()[-1]


def test_shutting_down_ends_what_runs_and_drops_what_waits(rogues: Any) -> None:
    executor = IsolatedExecutor(1)
    pid = executor.submit(rogues.threads).result()[2]
    running, waiting = executor.submit(rogues.sleep, 600), executor.submit(rogues.sleep, 600)
    while not running.running():
        time.sleep(0.01)
    executor.shutdown(cancel_futures=True)
    assert waiting.cancelled()
    assert isinstance(running.exception(), WorkerLostError)
    assert not alive(pid)
    with pytest.raises(RuntimeError, match="shutdown"):
        executor.submit(abs, 1)


@pytest.mark.slow
def test_workers_die_with_their_parent(rogues: Any, tmp_path: Path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(
        "import sys\n"
        f"sys.path.insert(0, {str(Path(rogues.__file__).parent)!r})\n"
        "import rogues\n"
        "from featreg.runtime.isolation import IsolatedExecutor\n"
        "if __name__ == '__main__':\n"
        "    executor = IsolatedExecutor(1)\n"
        "    print(executor.submit(rogues.threads).result()[2], flush=True)\n"
        "    executor.submit(rogues.sleep, 600).result()\n"
    )
    parent = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    pid = int(parent.stdout.readline())
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    parent.stdout.close()
    deadline = time.monotonic() + 20
    while alive(pid) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not alive(pid)


def alive(pid: int) -> bool:
    """Whether a process runs; one that ended and was not waited for does not."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def test_impossible_limits_are_refused() -> None:
    for given in ({"workers": 0}, {"time_limit": 0.0}, {"time_limit": -1.0}):
        with pytest.raises(ParameterError):
            IsolatedExecutor(**given)
