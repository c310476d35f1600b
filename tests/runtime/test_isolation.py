"""Workers that raise, hang or die: what they cost, and what they must not."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError, ParameterError
from featreg.runtime.isolation import IsolatedExecutor, WorkerLostError
from featreg.study.comparison import compare


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


def test_impossible_limits_are_refused() -> None:
    for given in ({"workers": 0}, {"time_limit": 0.0}, {"time_limit": -1.0}):
        with pytest.raises(ParameterError):
            IsolatedExecutor(**given)
