"""Comparison: known scores in the table, failures as rows, and a cache that trusts nothing it cannot prove."""

from __future__ import annotations

import csv
import io
import json
import re
import shutil
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from featreg.errors import CancelledError, InputError, ParameterError, UnknownNameError
from featreg.geometry import Rigid
from featreg.interfaces import FailedFit, Matcher
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.study.comparison import compare
from featreg.study.table import COLUMNS, Table
from featreg.types import Image, Matches

TRUTH = Rigid(4.0, 3.0, -2.0)
#: method -> (matches at GMS, px of error of each)
ERRORS = {"sharp": [0.3] * 8 + [9.0] * 2, "blunt": [1.2] * 5 + [9.0] * 5}


@dataclass(frozen=True)
class Stand(Matcher):
    """A Matcher object; `weights` stands for a parameter that is an array."""

    weights: Any = 0
    count: int = 10

    def match(self, reference: Image, secondary: Image) -> Matches:
        return Matches.empty()


class Opaque:
    """A method object whose content nobody can know."""


class Calls(list[tuple[str, int]]):
    """Every call of the stand-in for `featreg.match`."""


@pytest.fixture(autouse=True)
def calls(monkeypatch: pytest.MonkeyPatch) -> Calls:
    made = Calls()

    def match(reference: Any, secondary: Any, *, method: Any = "sharp", seed: int = 0, **keywords: Any) -> Registration:
        import cv2

        name = method if isinstance(method, str) else "sharp"
        made.append((name, cv2.getNumThreads()))
        if name == "broken":
            raise ValueError("the plugin fell over\nand this is the second line")
        if name == "unknown":
            raise UnknownNameError("unknown method 'unknown', did you mean 'sharp'?")
        errors = np.array(ERRORS.get(name, []))
        xy = np.random.default_rng(seed).uniform(0, 90, (len(errors), 2))
        good = errors < 5
        return Registration(
            Matches(xy, TRUTH(xy) + np.stack([errors, 0 * errors], axis=1), np.ones(len(xy))),
            {"gms": np.ones(len(xy), dtype=bool), "fsc": good},
            good,
            TRUTH if len(errors) else FailedFit("no tie points"),
            "ok" if len(errors) else "unreliable",
            "" if len(errors) else "no tie points",
            timings={"detect": 0.25, "match": 0.25 * len(made)},
            provenance={"method": name, "parameters": {"n_features": 5000}},
            reference=InputImage("a", (80, 100)),
        )

    module = ModuleType("featreg.matching")
    module.match = match  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "featreg.matching", module)
    return made


def image(seed: int = 0) -> Any:
    return np.random.default_rng(seed).random((80, 100)).astype(np.float32)


def test_known_scores_stand_in_the_table() -> None:
    table = compare([(image(0), image(1), TRUTH)], ["sharp", "blunt"])
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
    (row,) = compare([(image(0), image(1))], ["sharp"]).rows
    assert (row["nm"], row["inliers"], row["ncm"], row["precision"], row["rmse"]) == (10, 8, None, None, None)


def test_a_failing_method_is_a_row_with_its_reason() -> None:
    table = compare([(image(0), image(1), TRUTH)], ["broken", "unknown", "empty", "sharp"])
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
    table = compare([(image(0), image(1), np.zeros((5, 6, 2))), (image(0), image(1), TRUTH)], ["sharp"])
    assert [row["status"] for row in table.rows] == ["failed", "ok"]
    assert "flow" in table.rows[0]["reason"]


def test_the_first_call_of_each_method_is_not_measured(calls: Calls) -> None:
    import cv2

    before = cv2.getNumThreads()
    table = compare([(image(0), image(1)), (image(2), image(3))], ["sharp", "blunt"])
    assert [name for name, _ in calls] == ["sharp"] * 3 + ["blunt"] * 3
    assert {threads for _, threads in calls} == {1}
    assert cv2.getNumThreads() == before
    # The stand-in's time tells which call it was: 0.25 + 0.25 n.
    assert [row["time_s"] for row in table.rows] == [0.75, 1.5, 1.0, 1.75]
    calls.clear()
    compare([(image(0), image(1))], ["sharp"], warm_up=False)
    assert len(calls) == 1
    calls.clear()
    (row,) = compare([(image(0), image(1))], ["sharp"], timing=False).rows
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
    table = compare([(image(0), image(1))], methods, warm_up=False)
    assert [row["method"] for row in table.rows] == ["sharp", "sharp #2", "few", "blunt", "b", "Stand"]
    assert [name for name, _ in calls] == ["sharp", "sharp", "blunt", "blunt", "blunt", "sharp"]


def test_keywords_reach_match(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[dict[str, Any]] = []

    def match(reference: Any, secondary: Any, **keywords: Any) -> Registration:
        seen.append(keywords)
        raise InputError("enough")

    monkeypatch.setattr(sys.modules["featreg.matching"], "match", match)
    compare([(image(0), image(1))], [("a", {"n_features": 7})], seed=3, warm_up=False, n_features=9, model="rigid")
    assert seen == [{"seed": 3, "n_features": 7, "model": "rigid", "method": "a", "executor": "serial"}]


def test_an_executor_predicts_and_a_serial_pass_measures(calls: Calls) -> None:
    steps: list[tuple[int, int]] = []
    pairs = [(image(0), image(1), TRUTH), (image(2), image(3), TRUTH)]
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
            [(image(0), image(1)), (image(2), image(3))],
            ["sharp"],
            warm_up=False,
            cancel=event,
            progress=lambda done, total: event.set(),
        )
    assert len(calls) == 1


def test_cache_saves_every_call_and_knows_its_inputs(tmp_path: Path, calls: Calls) -> None:
    pair = (image(0), image(1), TRUTH)
    first = compare([pair], ["sharp", "blunt", Stand()], cache=tmp_path / "kept")
    assert len(calls) == 6
    calls.clear()
    assert list(compare([pair], ["sharp", "blunt", Stand()], cache=tmp_path / "kept").rows) == list(first.rows)
    assert calls == []

    def computed(**changes: Any) -> int:
        calls.clear()
        given: dict[str, Any] = {
            "pair": pair,
            "method": "sharp",
            "warm_up": False,
            "cache": tmp_path / "kept",
        } | changes
        compare([given.pop("pair")], [given.pop("method")], **given)
        return len(calls)

    assert computed() == 0
    assert computed(threshold=0.1) == 0
    assert computed(pair=(image(0), image(1))) == 0
    assert computed(pair=(image(0), image(2), TRUTH)) == 1
    assert computed(seed=1) == 1
    assert computed(n_features=100) == 1
    assert computed(reference_mask=np.zeros(3)) == 1
    assert computed(reference_mask=np.ones(3)) == 1
    assert computed(reference_mask=np.ones(3)) == 0
    assert computed(initial=TRUTH) == 1
    assert computed(method=Stand(count=3)) == 1
    assert computed(method=Stand(weights=np.zeros(5000))) == 1
    assert computed(method=Stand(weights=np.arange(5000) == 2500)) == 1
    assert computed(method=Stand(weights=np.arange(5000) == 2501)) == 1


def test_what_has_no_certain_digest_is_not_kept(tmp_path: Path, calls: Calls) -> None:
    for _ in range(2):
        compare([(image(0), image(1))], [Stand(weights=Opaque())], cache=tmp_path, warm_up=False)
        compare([(image(0), image(1))], [("f", {"hook": lambda x: x})], cache=tmp_path, warm_up=False)
    assert len(calls) == 4
    assert list(tmp_path.iterdir()) == []


def test_files_are_known_by_their_bytes(tmp_path: Path, calls: Calls) -> None:
    a, b = tmp_path / "a.npy", tmp_path / "b.npy"
    np.save(a, image(0))
    np.save(b, image(1))
    (row,) = compare([(str(a), b)], ["sharp"], cache=tmp_path / "kept", warm_up=False).rows
    assert row["pair"] == "a / b"
    compare([(a, b)], ["sharp"], cache=tmp_path / "kept", warm_up=False)
    assert len(calls) == 1
    np.save(b, image(2))
    compare([(a, b)], ["sharp"], cache=tmp_path / "kept", warm_up=False)
    assert len(calls) == 2


@pytest.mark.parametrize("harm", ["truncate", "foreign", "empty", "text", "stale key"])
def test_a_poisoned_cache_is_computed_afresh(harm: str, tmp_path: Path, calls: Calls) -> None:
    pair = (image(0), image(1), TRUTH)

    def run(method: str) -> Table:
        return compare([pair], [method], cache=tmp_path, warm_up=False)

    clean = run("sharp")
    (file,) = tmp_path.iterdir()
    content = file.read_bytes()
    if harm == "truncate":
        file.write_bytes(content[: len(content) // 2])
    elif harm == "foreign":
        run("blunt")
        (other,) = (f for f in tmp_path.iterdir() if f != file)
        file.write_bytes(other.read_bytes())
    elif harm == "stale key":
        file.write_text(file.read_text().replace(file.stem, "0" * 64))
    else:
        file.write_bytes(b"" if harm == "empty" else b"\x00\xffnot JSON")
    calls.clear()
    assert [row["nm"] for row in run("sharp").rows] == [row["nm"] for row in clean.rows]
    assert len(calls) == 1
    assert run("sharp").rows[0]["rmse"] == clean.rows[0]["rmse"]
    assert len(calls) == 1


def test_failures_are_not_kept_and_times_of_a_pool_are_not_trusted(tmp_path: Path, calls: Calls) -> None:
    compare([(image(0), image(1))], ["broken"], cache=tmp_path, warm_up=False)
    assert list(tmp_path.iterdir()) == []
    with ThreadPoolExecutor(1) as executor:
        compare([(image(0), image(1))], ["sharp"], cache=tmp_path, executor=executor, timing=False)
    calls.clear()
    (row,) = compare([(image(0), image(1))], ["sharp"], cache=tmp_path, warm_up=False).rows
    assert len(calls) == 1
    assert row["time_s"] == 0.5


@pytest.mark.parametrize(
    ("pairs", "methods", "error"),
    [
        ([], ["sharp"], InputError),
        (["ab"], ["sharp"], InputError),
        ([(1,)], ["sharp"], InputError),
        ([(image(), image(), "nowhere.csv")], ["sharp"], InputError),
        ([(image(), image())], [], ParameterError),
        ([(image(), image())], [{"n_features": 3}], ParameterError),
        ([(image(), image())], [("a", "b")], ParameterError),
    ],
)
def test_misuse_raises_before_anything_is_computed(pairs: Any, methods: Any, error: Any, calls: Calls) -> None:
    with pytest.raises(error):
        compare(pairs, methods)
    assert calls == []


@pytest.fixture
def table() -> Table:
    pairs = [(image(i), image(i + 1), TRUTH) for i in (0, 2)]
    return compare(pairs, ["sharp", "blunt", ("no_%luck", {"method": "broken"})], n_features=2000)


def test_summary_does_not_reward_giving_up(table: Table) -> None:
    summary = {(row["pair"], row["method"]): row for row in table.summary()}
    assert len(summary) == 6
    assert summary["median", "sharp"]["ncm"] == 8
    assert summary["mean", "blunt"]["precision"] == 0.5
    assert summary["median", "sharp"]["status"] == "2/2 ok"
    assert summary["median", "no_%luck"]["status"] == "0/2 ok"
    assert summary["median", "no_%luck"]["grid_rmse"] == np.inf
    assert summary["median", "no_%luck"]["precision"] == 0


def test_printed_forms(table: Table, tmp_path: Path) -> None:
    text = str(table)
    assert text == table.to_markdown() == table.to_markdown(tmp_path / "t.md") == (tmp_path / "t.md").read_text()
    lines = text.splitlines()
    assert lines[0] == "| " + " | ".join(COLUMNS) + " |"
    assert {line.count("|") for line in lines[: 2 + 6 + 6]} == {len(COLUMNS) + 1}
    assert "- sharp: filters gms, fsc; NM counted at gms; budget n_features 2000" in lines
    assert "- no_%luck: no result" in lines
    assert "within 1.5 px" in text
    assert "seed 0" in text
    assert "OpenCV " in text

    rows = list(csv.DictReader(io.StringIO(table.to_csv(tmp_path / "t.csv"))))
    assert (tmp_path / "t.csv").exists()
    assert [float(row["rmse"]) for row in rows if row["rmse"]] == [r["rmse"] for r in table.rows if r["rmse"]]

    data = json.loads(table.to_json(), parse_constant=lambda c: pytest.fail(f"{c} in the JSON"))
    assert data["rows"] == [dict(row) for row in table.rows]
    assert (data["failed"], len(data["summary"])) == (2, 6)

    frame = table.to_dataframe()
    assert list(frame.columns) == list(COLUMNS)
    assert len(frame) == 6


def test_latex_escapes_and_sets_the_best_of_the_trusted_in_bold(table: Table) -> None:
    lines = table.to_latex(caption="50 % & more", label="mine").splitlines()
    assert lines[0] == r"% needs \usepackage{booktabs}"
    assert r"\caption{50 \% \& more}" in lines
    assert r"\label{tab:mine}" in lines
    sharp, blunt, broken = (
        next(line for line in lines if f" & {m}" in line) for m in ("sharp", "blunt", r"no\_\%luck")
    )
    assert r"\textbf{0.800}" in sharp
    assert r"\textbf{0.300}" in sharp
    assert r"\textbf{8}" in sharp
    assert r"\textbf{0.500}" not in blunt
    assert r"\textbf" not in broken
    assert r"no\_\%luck$^{\ddagger}$ & " in broken
    assert any(r"$^{\ddagger}$ failed: no\_\%luck on pair 1: " in line for line in lines)
    assert any("Grid RMSE & " in line for line in lines)
    assert any("(px)" in line for line in lines)
    only = compare([(image(0), image(1), TRUTH)], ["sharp"]).to_latex()
    assert r"\textbf" not in only
    row = {"pair": r"a\b{c}", "method": "x<y|~^", "status": "unreliable", "ncm": 5, "reason": "#1 & 2 at 3$"}
    text = Table([row]).to_latex()
    assert r"a\textbackslash{}b\{c\} & x\textless{}y\textbar{}\~{}\^{}$^{\dagger}$ & 5 \\" in text
    assert r"on a\textbackslash{}b\{c\}: \#1 \& 2 at 3\$." in text
    assert r"\caption{Comparison of 1 method over 1 image pair.}" in text


def test_giving_up_wins_no_bold_mean_and_no_bold_at_all_where_it_is_not_trusted() -> None:
    rows: list[dict[str, Any]] = [
        {"pair": pair, "method": method, "status": "ok", "rmse": value, "reason": ""}
        for method, values in (("all", [0.5, 0.7]), ("half", [0.1, None]))
        for pair, value in zip("ab", values, strict=True)
    ]
    lines = Table(rows).to_latex().splitlines()
    assert [line for line in lines if line.startswith(("median", "mean"))] == [
        r"median & all (2/2 ok) & 0.600 \\",
        r"median & half (2/2 ok) & 0.100 \\",
        r"mean & all (2/2 ok) & 0.600 \\",
        r"mean & half (2/2 ok) & 0.100 \\",
    ]
    third: list[dict[str, Any]] = [{**row, "method": "third", "rmse": 0.8} for row in rows if row["method"] == "all"]
    bold = [line for line in Table([*rows, *third]).to_latex().splitlines() if r"\textbf" in line]
    assert bold == [
        r"b & all & \textbf{0.700} \\",
        r"a & half & \textbf{0.100} \\",
        r"median & all (2/2 ok) & \textbf{0.600} \\",
        r"mean & all (2/2 ok) & \textbf{0.600} \\",
    ]
    rows[2]["status"] = "unreliable"  # half on a
    lines = Table([*rows, *third]).to_latex().splitlines()
    assert r"a & half$^{\dagger}$ & 0.100 \\" in lines
    assert r"a & all & \textbf{0.500} \\" in lines
    assert any("among the 5 of 6 results that are trusted" in line for line in lines)


def test_latex_compiles(table: Table, tmp_path: Path) -> None:
    if shutil.which("pdflatex") is None or shutil.which("kpsewhich") is None:
        pytest.skip("LaTeX is not installed")
    if not subprocess.run(["kpsewhich", "booktabs.sty"], capture_output=True, check=False).stdout:
        pytest.skip("booktabs is not installed")
    head = r"\documentclass{article}\usepackage{booktabs}\begin{document}"
    text = f"{head}\n{table.to_latex()}\n{table.to_latex(layout='table2', label='two')}\n\\end{{document}}\n"
    (tmp_path / "t.tex").write_text(text, encoding="utf-8")
    done = subprocess.run(
        ["pdflatex", "-halt-on-error", "-interaction=nonstopmode", "t.tex"],
        cwd=tmp_path, capture_output=True, text=True, errors="replace", check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    assert "Overfull" not in done.stdout


def test_intervals_of_few_pairs_are_not_printed() -> None:
    def text(pairs: int) -> str:
        rows = [
            {"pair": f"p{k}", "method": m, "status": "ok", "rmse": 0.5 + 0.1 * k + 0.3 * (m == "b"), "reason": ""}
            for k in range(pairs)
            for m in "ab"
        ]
        return Table(rows).to_markdown()

    assert "| a | 0.6 |" in text(3)
    assert "n = 3 pairs: too few for an interval" in text(3)
    assert re.search(r"\| a \| 0\.7 \[0\.\d+, 0\.\d+\] \|", text(5))
    assert "n = 5 pairs; studentised bootstrap" in text(5)


def test_the_same_comparison_gives_the_same_table() -> None:
    first, second = (compare([(image(0), image(1), TRUTH)], ["sharp"], timing=False) for _ in range(2))
    assert first.to_csv() == second.to_csv()
