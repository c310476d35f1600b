"""Seconds by stage: summed by name, whatever happens inside, apart for each collection."""

from __future__ import annotations

import threading
import time
from typing import Any

import pytest

from featreg.runtime.timing import collecting, stage


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """A second passes at every look."""
    seconds = iter(range(1000))
    monkeypatch.setattr(time, "perf_counter", lambda: float(next(seconds)))


def test_stages_of_one_name_are_summed_and_nested_ones_counted_in_both() -> None:
    with collecting() as timings:
        with stage("outer"), stage("inner"):
            pass
        with stage("inner"):
            pass
    assert timings == {"outer": 3.0, "inner": 2.0}


def test_a_stage_that_fails_is_counted_and_fails() -> None:
    with collecting() as timings, pytest.raises(KeyError), stage("failing"):
        raise KeyError
    assert timings == {"failing": 1.0}


def test_each_collection_has_its_own_and_without_one_nothing_is_kept() -> None:
    with stage("nowhere"):
        pass
    with collecting() as outer:
        with collecting() as inner, stage("inside"):
            pass
        other: list[Any] = []

        def elsewhere() -> None:
            with collecting() as found, stage("there"):
                pass
            other.append(found)

        thread = threading.Thread(target=elsewhere)
        thread.start()
        thread.join()
    assert (outer, inner, *other) == ({}, {"inside": 1.0}, {"there": 1.0})
