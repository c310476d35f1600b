"""Sweeps: one method over a grid of its parameters, by the machinery of comparisons."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg import Experiment
from featreg.cli.main import main
from featreg.cli.sweep import parse_grid
from featreg.errors import ParameterError
from featreg.io import write_geotiff
from featreg.report.from_study import report_of
from featreg.simulate import sar_pair
from featreg.study.protocol import Protocol
from featreg.study.table import Table

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    home = tmp_path_factory.mktemp("sweep")
    pair = sar_pair((128, 128), rotation_deg=3.0, scale=1.0, shift=(3.0, -2.0), seed=1)
    write_geotiff(home / "a.tif", pair.reference)
    write_geotiff(home / "b.tif", pair.secondary)
    (home / "truth.json").write_text(json.dumps({"matrix": pair.truth.tolist()}))
    return home


@pytest.fixture
def run(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Any:
    monkeypatch.chdir(folder)

    def run(*arguments: str) -> tuple[int, str, str]:
        capsys.readouterr()
        code = main(["sweep", "a.tif", "b.tif", *arguments])
        return code, *capsys.readouterr()

    return run


def test_every_combination_is_a_row(run: Any, folder: Path, tmp_path: Path) -> None:
    grid = ("--method", "orb", "--grid", "n_features=300,900", "--grid", "fsc.threshold=1,2.5")
    command = (*grid, "--truth", "truth.json", "--no-times", "--no-isolate", "--save", str(tmp_path / "sweep.yaml"))
    code, out, err = run(*command, "--format", "csv")
    assert (code, err) == (0, "")
    rows = list(csv.DictReader(io.StringIO(out)))
    points = [(row["n_features"], row["fsc.threshold"]) for row in rows]
    assert points == [("300", "1"), ("300", "2.5"), ("900", "1"), ("900", "2.5")]
    assert rows[0]["method"] == "orb n_features=300 fsc.threshold=1"
    assert float(rows[2]["nm"]) > float(rows[0]["nm"])
    text = run(*command)[1]
    assert text.count("- orb: filters gms, fsc, refine; NM counted at gms; budget n_features swept") == 1
    assert "differ" not in text
    data = json.loads(run(*command, "--format", "json")[1])
    assert [row["n_features"] for row in data["rows"]] == [300, 300, 900, 900]


def test_the_heat_map_has_the_means_at_each_point(folder: Path) -> None:
    made = Experiment(
        [(folder / "a.tif", folder / "b.tif", folder / "truth.json")],
        ["orb"],
        grid={"n_features": [300, 900], "refine": [True, False]},
        seeds=[0, 1],
        protocol=Protocol(timing=False),
    )
    study = made.run(isolate=False)
    table = study.table()
    assert table.grid == ("n_features", "refine")
    down, across, cells = table.pivot("n_features", "refine", "ncm")
    assert (down, across) == ([300, 900], [True, False])
    wanted = [r["ncm"] for r in table.rows if r["n_features"] == 900 and r["refine"] is False]
    assert cells[1][1] == np.mean(wanted)
    sweep = report_of(study).sweep
    assert sweep is not None
    assert list(sweep.parameters) == ["n_features", "refine"]
    np.testing.assert_array_equal(sweep.metrics["ncm"], cells)
    assert sweep.better["ncm"] == "high"
    with pytest.raises(ParameterError, match="did you mean 'n_features'"):
        table.pivot("n_feature", "refine", "ncm")


def test_a_point_without_a_value_is_empty() -> None:
    rows = [
        {"pair": "p", "method": f"m{k}", "k": k, "status": "ok", "rmse": v, "reason": ""}
        for k, v in ((1, 0.5), (2, None))
    ]
    assert Table(rows).pivot("k", "pair", "rmse") == ([1, 2], ["p"], [[0.5], [None]])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), ["missing option '--grid'"]),
        (("--grid", "fsc.threshold"), ["KEY=A,B,C", "'fsc.threshold'"]),
        (("--grid", "fsc.threshold="), ["KEY=A,B,C"]),
        (("--grid", "fsc.treshold=1"), ["'fsc.treshold'", "'fsc.threshold'"]),
        (("--grid", "n_features=100,100"), ["a value twice"]),
        (("--grid", "seed=1,2"), ["'seed' cannot be swept"]),
        (("--grid", "n_features=100", "--n-features", "5"), ["'n_features' is swept"]),
        (("--grid", "n_features=100", "--grid", "n_features=5"), ["given twice"]),
        (("--grid", "n_features=0"), ["n_features", ">= 1"]),
        (("--grid", "n_features=100", "--method", "orbb"), ["'orbb'", "'orb'"]),
    ],
    ids=lambda value: " ".join(value)[:30] if isinstance(value, tuple) else None,
)
def test_misuse_is_one_line(arguments: tuple[str, ...], words: list[str], run: Any) -> None:
    code, out, err = run(*arguments)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    for word in words:
        assert word in err


def test_values_are_read_as_set_reads_them() -> None:
    assert parse_grid(["a=1,2.5,true,word"]) == {"a": [1, 2.5, True, "word"]}
