"""`featreg compare`: its table in every format, and the code of a failed row."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
Run = Callable[..., tuple[int, str, str]]


def test_compare_prints_the_table(run: Run) -> None:
    code, out, err = run("compare", "ref.tif", "sec.tif", "--methods", "sar-orb,orb", "--truth", "truth.json")
    assert (code, err) == (0, "")
    rows = [line for line in out.splitlines() if line.startswith("| ref / sec")]
    assert [row.split(" | ")[1:3] for row in rows] == [["sar-orb", "ok"], ["orb", "ok"]]
    assert "truth: matrix" in out


def test_compare_in_other_formats(run: Run, tmp_path: Path) -> None:
    command = ["compare", "ref.tif", "sec.tif", "--methods", "orb", "--no-times", "--resume", str(tmp_path / "kept")]
    made = {layout: run(*command, "--format", layout)[1] for layout in ("csv", "json", "latex")}
    assert [row["method"] for row in csv.DictReader(io.StringIO(made["csv"]))] == ["orb"]
    assert json.loads(made["json"])["rows"][0]["time_s"] is None
    assert r"\begin{tabular}" in made["latex"]
    assert len(list((tmp_path / "kept").iterdir())) == 1


def test_a_failed_row_gives_code_4(run: Run, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import featreg.matching

    def fail(*_: Any, **__: Any) -> Any:
        raise RuntimeError("out of luck")

    monkeypatch.setattr(featreg.matching, "match", fail)
    code, out, err = run("compare", "ref.tif", "sec.tif", "--methods", "orb", "--no-isolate")
    assert (code, err) == (4, "")
    assert "| failed |" in out
    assert "RuntimeError: out of luck" in out


@pytest.mark.slow
def test_workers_give_the_same_table(run: Run) -> None:
    command = ["compare", "ref.tif", "sec.tif", "sec.tif", "ref.tif", "--methods", "orb,sar-orb", "--no-times"]
    alone, shared = run(*command, "--format", "csv"), run(*command, "--format", "csv", "--workers", "2")
    assert alone == shared
    assert alone[0] == 0
