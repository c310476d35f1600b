"""Comparison: known scores in the table, and failures as rows."""

from __future__ import annotations

import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from featreg.errors import CancelledError, InputError, ParameterError
from featreg.results.registration import Registration
from featreg.study.comparison import compare
from featreg.study.table import COLUMNS
from made.stand_ins import TRUTH, Calls, Stand, noise_image

pytestmark = pytest.mark.usefixtures("calls")


def test_known_scores_stand_in_the_table() -> None:
    table = compare([(noise_image(0), noise_image(1), TRUTH)], ["sharp", "blunt"])
    assert [tuple(row) for row in table.rows] == [COLUMNS] * 2
    sharp, blunt = table.rows
    assert (sharp["pair"], sharp["method"], sharp["status"], sharp["reason"]) == ("pair 1", "sharp", "ok", "")
    assert (sharp["nm"], sharp["ncm"], sharp["precision"], sharp["inliers"]) == (10, 8, 0.8, 8)
    assert sharp["rmse"] == pytest.approx(0.3)
    assert blunt["rmse"] == pytest.approx(1.2)
    assert sharp["grid_rmse"] == 0.0
    assert sharp["rotation_deg"] == pytest.approx(4.0)
    assert table.failed == 0
    assert table.summary() == []


def test_without_truth_there_are_counts_but_no_scores() -> None:
    (row,) = compare([(noise_image(0), noise_image(1))], ["sharp"]).rows
    assert (row["nm"], row["inliers"], row["ncm"], row["precision"], row["rmse"]) == (10, 8, None, None, None)


def test_a_failing_method_is_a_row_with_its_reason() -> None:
    table = compare([(noise_image(0), noise_image(1), TRUTH)], ["broken", "unknown", "empty", "sharp"])
    broken, unknown, empty, sharp = table.rows
    assert (broken["status"], broken["reason"]) == ("failed", "ValueError: the plugin fell over")
    assert (broken["nm"], broken["ncm"], broken["precision"], broken["rmse"], broken["time_s"]) == (
        0,
        0,
        0.0,
        None,
        None,
    )
    assert "did you mean 'sharp'" in unknown["reason"]
    assert (empty["status"], empty["reason"], empty["grid_rmse"]) == ("unreliable", "no tie points", None)
    assert sharp["status"] == "ok"
    assert table.failed == 2
    assert "the plugin fell over" in str(table)


def test_a_flow_of_the_wrong_size_fails_its_rows_only() -> None:
    table = compare(
        [(noise_image(0), noise_image(1), np.zeros((5, 6, 2))), (noise_image(0), noise_image(1), TRUTH)], ["sharp"]
    )
    assert [row["status"] for row in table.rows] == ["failed", "ok"]
    assert "flow" in table.rows[0]["reason"]


def test_the_first_call_of_each_method_is_not_measured(calls: Calls) -> None:
    import cv2

    before = cv2.getNumThreads()
    table = compare([(noise_image(0), noise_image(1)), (noise_image(2), noise_image(3))], ["sharp", "blunt"])
    assert [name for name, _ in calls] == ["sharp"] * 3 + ["blunt"] * 3
    assert {threads for _, threads in calls} == {1}
    assert cv2.getNumThreads() == before
    # The stand-in's time tells which call it was: 0.25 + 0.25 n.
    assert [row["time_s"] for row in table.rows] == [0.75, 1.5, 1.0, 1.75]
    calls.clear()
    compare([(noise_image(0), noise_image(1))], ["sharp"], warm_up=False)
    assert len(calls) == 1
    calls.clear()
    (row,) = compare([(noise_image(0), noise_image(1))], ["sharp"], timing=False).rows
    assert (len(calls), row["time_s"], row["nm"]) == (1, None, 10)


def test_methods_in_every_form_and_labels_that_repeat(calls: Calls) -> None:
    methods = [
        "sharp",
        "sharp",
        ("few", {"method": "blunt"}),
        ("blunt", {}),
        {"method": "blunt", "label": "b"},
        Stand(),
    ]
    table = compare([(noise_image(0), noise_image(1))], methods, warm_up=False)
    assert [row["method"] for row in table.rows] == ["sharp", "sharp #2", "few", "blunt", "b", "Stand"]
    assert [name for name, _ in calls] == ["sharp", "sharp", "blunt", "blunt", "blunt", "sharp"]


def test_keywords_reach_match(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[dict[str, Any]] = []

    def match(reference: Any, secondary: Any, **keywords: Any) -> Registration:
        seen.append(keywords)
        raise InputError("enough")

    monkeypatch.setattr(sys.modules["featreg.matching"], "match", match)
    compare(
        [(noise_image(0), noise_image(1))],
        [("a", {"n_features": 7})],
        seed=3,
        warm_up=False,
        n_features=9,
        model="rigid",
    )
    assert seen == [{"seed": 3, "n_features": 7, "model": "rigid", "method": "a", "executor": "serial"}]


def test_an_executor_predicts_and_a_serial_pass_measures(calls: Calls) -> None:
    steps: list[tuple[int, int]] = []
    pairs = [(noise_image(0), noise_image(1), TRUTH), (noise_image(2), noise_image(3), TRUTH)]
    with ThreadPoolExecutor(2) as executor:
        table = compare(pairs, ["sharp", "broken"], executor=executor, progress=lambda *s: steps.append(s))
    serial = compare(pairs, ["sharp", "broken"])
    for name in set(COLUMNS) - {"time_s"}:
        assert [row[name] for row in table.rows] == [row[name] for row in serial.rows]
    assert all((row["time_s"] is None) == (row["status"] == "failed") for row in table.rows)
    assert steps == [(i, 8) for i in range(1, 9)]


def test_cancel_stops_between_two_steps(calls: Calls) -> None:
    event = threading.Event()
    with pytest.raises(CancelledError, match="1 of 2"):
        compare(
            [(noise_image(0), noise_image(1)), (noise_image(2), noise_image(3))],
            ["sharp"],
            warm_up=False,
            cancel=event,
            progress=lambda done, total: event.set(),
        )
    assert len(calls) == 1


@pytest.mark.parametrize(
    ("pairs", "methods", "error"),
    [
        ([], ["sharp"], InputError),
        (["ab"], ["sharp"], InputError),
        ([(1,)], ["sharp"], InputError),
        ([(noise_image(), noise_image(), "nowhere.csv")], ["sharp"], InputError),
        ([(noise_image(), noise_image())], [], ParameterError),
        ([(noise_image(), noise_image())], [{"n_features": 3}], ParameterError),
        ([(noise_image(), noise_image())], [("a", "b")], ParameterError),
    ],
)
def test_misuse_raises_before_anything_is_computed(pairs: Any, methods: Any, error: Any, calls: Calls) -> None:
    with pytest.raises(error):
        compare(pairs, methods)
    assert calls == []
