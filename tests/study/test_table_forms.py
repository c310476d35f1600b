"""A table of a comparison as text, Markdown, CSV and LaTeX; giving up wins nothing."""

from __future__ import annotations

import csv
import io
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.study.comparison import compare
from featreg.study.table import COLUMNS, Table
from made.stand_ins import TRUTH, noise_image

pytestmark = pytest.mark.usefixtures("calls")


@pytest.fixture
def table() -> Table:
    pairs = [(noise_image(i), noise_image(i + 1), TRUTH) for i in (0, 2)]
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
    only = compare([(noise_image(0), noise_image(1), TRUTH)], ["sharp"]).to_latex()
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
    first, second = (compare([(noise_image(0), noise_image(1), TRUTH)], ["sharp"], timing=False) for _ in range(2))
    assert first.to_csv() == second.to_csv()
