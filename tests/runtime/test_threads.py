"""How many threads there are, and how many the libraries take."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable
from functools import partial
from typing import Any

import cv2
import numpy as np
import pytest

import featreg
from featreg.errors import ParameterError
from featreg.focusing import pulse_spectra
from featreg.runtime import threads
from featreg.runtime.threads import (
    available_processors,
    end_helpers,
    in_parts,
    limited_threads,
    opencv_threads,
    side_by_side,
    single_threaded,
    stated_threads,
    worker_count,
)
from featreg.simulate import sar_pair


def test_opencv_gets_its_threads_back() -> None:
    before = cv2.getNumThreads()
    for block, inside in ((single_threaded(), 1), (limited_threads(1), 1), (limited_threads(None, 1), before)):
        with block:
            assert cv2.getNumThreads() == inside
        assert cv2.getNumThreads() == before


def test_opencv_gets_its_threads_back_in_whichever_order_blocks_end() -> None:
    """Two threads match at the same time, and the one that began first ends first."""
    before, beside = cv2.getNumThreads(), cv2.getNumThreads() + 1
    first, second, third = (opencv_threads(count) for count in (1, beside, 1))
    for block in (first, second, third):
        block.__enter__()
    second.__exit__(None, None, None)
    assert cv2.getNumThreads() == 1
    first.__exit__(None, None, None)
    assert cv2.getNumThreads() == 1
    third.__exit__(None, None, None)
    assert cv2.getNumThreads() == before
    with opencv_threads(beside):
        with opencv_threads(1):
            pass
        assert cv2.getNumThreads() == beside
    assert cv2.getNumThreads() == before


@pytest.mark.parametrize(("count", "algebra", "seen"), [(1, None, 1), (3, 1, 1), (None, 2, 2), (None, None, None)])
def test_linear_algebra_is_limited_before_it_is_imported(count: Any, algebra: Any, seen: Any) -> None:
    code = f"from featreg.runtime.threads import *\nwith limited_threads({count}, {algebra}):\n"
    code += "    import os; print(os.environ.get('OPENBLAS_NUM_THREADS'), os.environ.get('NUMBA_NUM_THREADS'))"
    environment = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split() == [str(seen)] * 2


def test_work_runs_side_by_side_only_where_threads_were_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    here = threading.get_ident()
    assert side_by_side([threading.get_ident] * 3) == [here] * 3
    with limited_threads(1):
        assert side_by_side([threading.get_ident] * 3) == [here] * 3
    meeting = threading.Barrier(2, timeout=30)

    def met(name: str) -> tuple[str, int, list[int]]:
        meeting.wait()  # passes only where both run at once
        return name, threading.get_ident(), side_by_side([threading.get_ident] * 2)

    def later() -> int:
        time.sleep(0.01)
        return threading.get_ident()

    monkeypatch.setattr(threads, "available_processors", lambda: 2)
    before = threading.active_count()
    with limited_threads(5):
        assert cv2.getNumThreads() == 2
        (first, one, inner), (second, two, other) = side_by_side([lambda: met("a"), lambda: met("b")])
        assert (first, second) == ("a", "b")
        # The thread that asks takes part, and no more run than there are processors, whatever lies in whatever.
        assert here in (one, two)
        assert one != two
        assert {*inner, *other} <= {one, two}
        assert len({*side_by_side([later] * 9)}) == 2
        with pytest.raises(ZeroDivisionError):
            side_by_side([lambda: 1, lambda: 1 // 0, lambda: [][0]])
        assert threading.active_count() == before + 1
        end_helpers()
        assert threading.active_count() == before
        assert side_by_side([int, str]) == [0, ""]
        # What they do may ask for it too.
        assert side_by_side([end_helpers] * 9) == [None] * 9
        assert threading.active_count() == before + 1
        assert len({*side_by_side([later] * 9, threads.LEAST - 1)}) == 1
    assert threading.active_count() == before


def test_a_thread_without_work_helps_with_what_another_has_begun(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "available_processors", lambda: 2)
    helped: dict[str, set[int]] = {"parts": set(), "tasks": set()}
    short_is_over = threading.Event()

    def part(first: int, stop: int) -> None:
        time.sleep(0.005)
        helped["parts"].add(threading.get_ident())
        # Nothing is shared out further inside of parts.
        assert side_by_side([threading.get_ident] * 2) == [threading.get_ident()] * 2

    def task() -> None:
        time.sleep(0.005)
        helped["tasks"].add(threading.get_ident())

    def long() -> int:
        assert short_is_over.wait(30)
        in_parts(part, 100)
        side_by_side([task] * 20)
        return threading.get_ident()

    def short() -> int:
        short_is_over.set()
        return threading.get_ident()

    here = threading.get_ident()
    for work in ([long, short], [short, long]):
        for names in helped.values():
            names.clear()
        short_is_over.clear()
        with limited_threads(2):
            found = side_by_side(work)
        assert len(helped["parts"]) == 2
        # A thread that waits for work of its own may hold locks that the other's needs: it leaves undivided work alone.
        busy = found[work.index(long)]
        assert helped["tasks"] == ({busy} if busy != here else helped["tasks"] | {busy})


def test_two_that_share_out_work_at_once_start_no_more_helpers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "available_processors", lambda: 3)
    meeting, before = threading.Barrier(2, timeout=30), threading.active_count()
    start = threading.Thread.start

    def slowly(self: threading.Thread) -> None:
        time.sleep(0.01)
        start(self)

    def nested() -> None:
        meeting.wait()
        side_by_side([lambda: time.sleep(0.001)] * 6)

    monkeypatch.setattr(threading.Thread, "start", slowly)
    with limited_threads(3):
        side_by_side([nested, nested])
        assert threading.active_count() == before + 2


def test_a_derived_map_that_both_images_need_is_made_once_by_threads_that_help(monkeypatch: pytest.MonkeyPatch) -> None:
    """One thread makes it, in parts, while the other waits for the lock: neither waits for what the other holds."""
    monkeypatch.setattr(threads, "available_processors", lambda: 3)
    lock, made = threading.Lock(), []

    def part(first: int, stop: int) -> None:
        time.sleep(0.001)
        made.append((first, stop))

    def locked() -> int:
        with lock:
            in_parts(part, 50)
            return len(made)

    with limited_threads(3):
        for _ in range(20):
            made.clear()
            found = side_by_side([lambda: side_by_side([locked, locked]), lambda: side_by_side([locked, locked])])
            assert len({*found[0], *found[1]}) == 4
            assert sum(stop - first for first, stop in made) == 200


@pytest.mark.skipif(sys.platform != "linux", reason="looks at the system's list of threads")
def test_helpers_that_were_ended_are_gone_for_the_system_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python knows of their end a moment earlier, in which a process that looks may not be forked."""
    monkeypatch.setattr(threads, "available_processors", lambda: 3)
    with limited_threads(3):
        side_by_side([int] * 3)
        end_helpers()
        before = len(os.listdir("/proc/self/task"))
        for _ in range(100):
            side_by_side([int] * 9)
            end_helpers()
            assert len(os.listdir("/proc/self/task")) == before


def test_work_is_done_where_no_more_threads_can_be_had(monkeypatch: pytest.MonkeyPatch) -> None:
    """Under a limit of processes, or while the interpreter ends."""

    def none_left(self: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threads, "available_processors", lambda: 3)
    with limited_threads(3):
        monkeypatch.setattr(threading.Thread, "start", none_left)
        assert side_by_side([threading.get_ident] * 4) == [threading.get_ident()] * 4


def test_after_an_error_nothing_more_is_begun(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "available_processors", lambda: 2)
    ran: list[int] = []

    def interrupted() -> None:
        raise KeyboardInterrupt

    def later(number: int) -> None:
        time.sleep(0.01)
        ran.append(number)

    work: list[Callable[[], None]] = [interrupted, *(partial(later, number) for number in range(200))]
    with limited_threads(2):
        with pytest.raises(KeyboardInterrupt):
            side_by_side(work)
        assert len(ran) < 100
        # The next work is done as ever.
        assert side_by_side([int, str]) == [0, ""]


def test_a_helper_that_an_interrupt_kept_from_being_listed_ends_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "available_processors", lambda: 2)
    start, before = threading.Thread.start, set(threading.enumerate())

    def interrupted(self: threading.Thread) -> None:
        start(self)
        raise KeyboardInterrupt

    with limited_threads(2):
        with monkeypatch.context() as patched:
            patched.setattr(threading.Thread, "start", interrupted)
            with pytest.raises(KeyboardInterrupt):
                side_by_side([int, str])
        assert side_by_side([int, str]) == [0, ""]
    for thread in set(threading.enumerate()) - before:
        thread.join(30)
        assert not thread.is_alive()


def test_what_failed_keeps_nothing_alive(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "available_processors", lambda: 2)

    class Large:
        def work(self) -> None:
            raise ZeroDivisionError

    large = Large()
    gone = weakref.ref(large)
    gc.disable()
    try:
        with limited_threads(2):
            with pytest.raises(ZeroDivisionError):
                side_by_side([large.work, lambda: None])
            del large
        assert gone() is None
    finally:
        gc.enable()


def test_parts_make_up_the_whole_whatever_their_number(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "available_processors", lambda: 3)
    calls: list[tuple[int, int]] = []

    def work(first: int, stop: int) -> None:
        calls.append((first, stop))

    def divided(count: int, size: int = threads.LEAST, step: int = 1) -> list[tuple[int, int]]:
        calls.clear()
        in_parts(work, count, size, step)
        found = sorted(calls)
        assert [one[1] for one in found[:-1]] == [other[0] for other in found[1:]]
        assert (found[0][0], found[-1][1]) == (0, count)
        return found

    for count in (0, 1, 7, 100):
        assert divided(count) == [(0, count)]
    with limited_threads(3):
        assert divided(0) == [(0, 0)]
        assert divided(1) == [(0, 1)]
        many = [stop - first for first, stop in divided(1000)]
        # A sixth of the rest each time, down to the least there may be, and what is left over.
        assert many[:3] == [166, 139, 115]
        assert many[:-1] == sorted(many[:-1], reverse=True)
        assert set(many[-6:]) == {1}
        assert [stop - first for first, stop in divided(1000, size=threads.LEAST // 300)] == [301, 301, 398]
        assert len(divided(1000, size=threads.LEAST // 501)) == 1
        even = divided(1001, step=8)
        assert all(first % 8 == 0 for first, _ in even)
        assert len(even) > 12
        assert len(divided(20, step=16)) == 1


def test_a_registration_gives_the_same_bits_for_any_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "available_processors", lambda: 3)
    # Of small images the rows are shared out as well.
    monkeypatch.setattr(threads, "LEAST", 1 << 11)
    pair = sar_pair((361, 383), seed=2)
    found = [featreg.match(pair.reference, pair.secondary, n_features=600, threads=n) for n in (1, 2, 3)]
    for other in found[1:]:
        np.testing.assert_array_equal(other.matches.secondary_xy, found[0].matches.secondary_xy)
        assert {k: g.value for k, g in other.gates.items()} == {k: g.value for k, g in found[0].gates.items()}
        assert {"detect", "describe"} <= other.timings.keys()


def test_the_number_of_workers() -> None:
    assert worker_count(None) == available_processors() >= 1
    assert worker_count(None, 3) == 3
    assert worker_count(np.int64(2), 3) == 2


@pytest.mark.parametrize("given", [0, -1, 1.5, 2.0, True, np.nan])
def test_impossible_workers_are_refused_wherever_they_are_taken(given: Any) -> None:
    from featreg.focusing import focus
    from featreg.products.files import Runner
    from featreg.runtime.executors import open_executor
    from featreg.runtime.isolation import IsolatedExecutor

    with pytest.raises(ParameterError, match=r"workers must be a whole number >= 1, got"):
        worker_count(given)
    with pytest.raises(ParameterError, match="workers must be"), open_executor(None, given):
        pass
    with pytest.raises(ParameterError, match="workers must be"):
        IsolatedExecutor(given)
    with pytest.raises(ParameterError, match="workers must be"):
        _ = Runner(given, None, None).workers
    with pytest.raises(ParameterError, match=r"workers. must be"):
        focus(np.ones((20, 20), np.complex64), workers=given)
    with pytest.raises(ParameterError, match="workers must be"):
        featreg.compare([(np.ones((20, 20), np.float32),) * 2], ["sar-orb"], workers=given)


@pytest.mark.parametrize(
    ("stated", "count"),
    [
        ("3", 3), (" 3 ", 3), ("4,2", 4), ("", None), (" ", None), ("0", None), ("-2", None), ("abc", None),
        ("2.5", None), (",2", None), ("\u00b2", None),
    ],
)  # fmt: skip
def test_a_limit_that_means_nothing_is_said_and_sets_none(
    stated: str, count: int | None, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", stated)
    assert stated_threads() == count
    said = f"OMP_NUM_THREADS is '{stated}', which is no number of threads above 0" in caplog.text
    assert said == (count is None and bool(stated.strip()))
    monkeypatch.setattr(pulse_spectra, "available_processors", lambda: 8)
    monkeypatch.setattr(cv2, "getNumThreads", lambda: 8)
    assert pulse_spectra.default_workers() == (count or 8)
