"""The JSON of a registration is whole, exact and deterministic."""

from __future__ import annotations

import io
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.geometry import Polynomial2
from featreg.interfaces import FailedFit
from featreg.results.json_file import MAX_ROWS, plain, registration_to_dict
from featreg.results.registration import Registration
from featreg.results.tie_point_table import parquet_of
from featreg.types import Gate
from made.written_results import registration

TOP = ["schema_version", "method", "status", "reason", "gates", "seed", "reference", "secondary"]
TOP += ["model", "counts", "blocks", "timings", "provenance", "tie_points"]
COLUMNS = ["reference_x", "reference_y", "secondary_x", "secondary_y", "score"]
COLUMNS += ["residual", "inlier", "stage", "origin", "block"]


def assert_same(a: Registration, b: Registration) -> None:
    for name in ("reference_xy", "secondary_xy", "score", "origin", "covariance", "rotation", "scale_ratio"):
        x, y = getattr(a.matches, name), getattr(b.matches, name)
        assert (x is None) == (y is None), name
        if x is not None:
            np.testing.assert_array_equal(x, y, err_msg=name)
            assert x.dtype == y.dtype
    assert list(a.stages) == list(b.stages)
    for name, mask in a.stages.items():
        np.testing.assert_array_equal(mask, b.stages[name], err_msg=name)
    np.testing.assert_array_equal(a.inliers, b.inliers)
    assert (a.status, a.reason, a.gates, a.timings) == (b.status, b.reason, b.gates, b.timings)
    assert plain(a.provenance) == plain(b.provenance)
    if isinstance(a.model, FailedFit):
        assert a.model == b.model
    else:
        assert not isinstance(b.model, FailedFit)
        assert type(a.model) is type(b.model)
        assert plain(a.model.parameters) == plain(b.model.parameters)


def round_trip(made: Registration, folder: Path) -> tuple[Registration, dict[str, Any]]:
    made.to_json(folder / "out.json")
    data = json.loads((folder / "out.json").read_text(), parse_constant=lambda c: pytest.fail(f"{c} in the JSON"))
    return Registration.from_json(folder / "out.json"), data


def test_everything_comes_back_exactly_refined_points_and_covariances_too(tmp_path: Path) -> None:
    made = registration()
    read, data = round_trip(made, tmp_path)
    assert_same(made, read)
    assert list(data) == TOP
    assert data == registration_to_dict(made)


def test_the_file_says_what_the_contract_says(tmp_path: Path) -> None:
    made = registration()
    _, data = round_trip(made, tmp_path)
    assert data["schema_version"] == 1
    assert (data["method"], data["seed"], data["status"]) == ("sar-orb", 7, "ok")
    assert data["reference"] == {"path": "a.tif", "width": 512, "height": 500}
    assert data["counts"] == {
        "putative": 60,
        "gms": made.stages["gms"].sum(),
        "fsc": made.stages["fsc"].sum(),
        "refine": made.stages["refine"].sum(),
        "inliers": made.inliers.sum(),
    }
    assert data["blocks"] == dict.fromkeys(("total", "computed", "reused", "skipped", "failed"), 0)
    assert data["model"]["type"] == "affine"
    columns = data["tie_points"]["columns"]
    assert columns[:10] == COLUMNS
    assert columns[10:] == ["cov_xx", "cov_xy", "cov_yy", "rotation", "scale_ratio"]
    rows = np.array(data["tie_points"]["rows"], dtype=float)
    stage = rows[:, columns.index("stage")]
    np.testing.assert_array_equal(stage >= 1, made.stages["gms"])
    np.testing.assert_array_equal(stage >= 2, made.stages["fsc"])
    np.testing.assert_array_equal(rows[:, columns.index("residual")], made.residuals())
    assert (rows[:, columns.index("block")] == -1).all()
    assert list(data["tie_points"]["masks"]) == ["refine"]


def test_nested_filters_need_no_masks(tmp_path: Path) -> None:
    made = registration(refined=0, inliers=np.zeros(60, dtype=bool))
    made = replace(made, stages={k: made.stages[k] for k in ("gms", "fsc")})
    read, data = round_trip(made, tmp_path)
    assert "masks" not in data["tie_points"]
    assert_same(made, read)


def test_a_stage_that_keeps_what_an_earlier_one_dropped_comes_back(tmp_path: Path) -> None:
    made = registration()
    odd = {"a": made.stages["fsc"], "b": ~made.stages["fsc"], "c": np.ones(75, dtype=bool)}
    made = replace(made, stages=odd)
    assert_same(made, round_trip(made, tmp_path)[0])


@pytest.mark.parametrize("count", [0, 1])
def test_hardly_any_tie_points(count: int, tmp_path: Path) -> None:
    made = registration(count=count, refined=0)
    assert_same(made, round_trip(made, tmp_path)[0])


def test_failed_fit_comes_back_with_its_reason(tmp_path: Path) -> None:
    made = registration(model=FailedFit("2 points, 3 needed"), status="unreliable", reason="no model")
    read, data = round_trip(made, tmp_path)
    assert data["model"] is None
    assert data["model_failure"] == "2 points, 3 needed"
    assert_same(made, read)
    assert np.isnan(read.residuals()).all()


def test_a_model_without_a_matrix_comes_back(tmp_path: Path) -> None:
    made = registration()
    model = Polynomial2.from_estimate(made.matches.reference_xy, made.matches.secondary_xy)
    assert not isinstance(model, FailedFit)
    made = replace(made, model=model)
    read, data = round_trip(made, tmp_path)
    assert data["model"]["matrix"] is None
    assert not isinstance(read.model, FailedFit)
    np.testing.assert_array_equal(read.model(np.array([[3.0, 4.0]])), model(np.array([[3.0, 4.0]])))


def test_nan_and_infinity_become_null(tmp_path: Path) -> None:
    made = registration()
    score = made.matches.score.copy()
    score[:3] = np.nan, np.inf, -np.inf
    made = replace(
        made,
        matches=replace(made.matches, score=score),
        gates={"significance": Gate(np.inf)},
        provenance={"threshold": np.float32("nan"), "method": "sar-orb"},
    )
    read, data = round_trip(made, tmp_path)
    assert np.isnan(read.matches.score[:3]).all()
    np.testing.assert_array_equal(read.matches.score[3:], score[3:])
    assert data["gates"]["significance"]["value"] is None
    assert data["provenance"]["threshold"] is None


def test_provenance_is_made_plain() -> None:
    class Odd:
        pass

    values = {"path": Path("a/b"), "pair": (np.int64(2), np.bool_(True)), "array": np.eye(2), "set": {3, 1}, 4: Odd()}
    assert plain(values) == {
        "path": str(Path("a/b")),
        "pair": [2, True],
        "array": [[1.0, 0.0], [0.0, 1.0]],
        "set": [1, 3],
        "4": Odd.__qualname__,
    }


def test_blocks_of_a_scene_are_kept(tmp_path: Path) -> None:
    made = registration()
    counts = {"total": 9, "computed": 6, "reused": 2, "skipped": 1, "failed": 0}
    blocks = np.arange(75) % 9
    made = replace(made, provenance={**made.provenance, "blocks": counts, "tie_point_blocks": blocks})
    read, data = round_trip(made, tmp_path)
    assert data["blocks"] == counts
    assert "tie_point_blocks" not in data["provenance"]
    np.testing.assert_array_equal(read.provenance["tie_point_blocks"], blocks)
    assert_same(made, read)


def test_beyond_20000_rows_stand_in_parquet(tmp_path: Path) -> None:
    made = registration(count=MAX_ROWS, refined=5)
    score = made.matches.score.copy()
    score[0] = np.inf
    made = replace(made, matches=replace(made.matches, score=score))
    read, data = round_trip(made, tmp_path)
    assert "rows" not in data["tie_points"]
    assert data["tie_points"]["file"] == "out.tie_points.parquet"
    assert np.isnan(read.matches.score[0])
    score[0] = np.nan
    assert_same(replace(made, matches=replace(made.matches, score=score)), read)
    assert sorted(p.name for p in tmp_path.iterdir() if p.is_file()) == ["out.json", "out.tie_points.parquet"]


def test_columns_of_any_layout_go_to_parquet() -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    columns = {
        "apart": np.array([1.0, 0, np.nan, 0, np.inf, 0])[::2],
        "truth": np.array([True, False, True]),
        "other_order": np.array([1.5, 2.5, -3.0]).astype(np.dtype(np.float64).newbyteorder()),
        "whole": np.array([1, 2, -3]),
    }
    wanted = {"apart": [1.0, None, None], "truth": [True, False, True], "other_order": [1.5, 2.5, -3.0]}
    assert pq.read_table(io.BytesIO(parquet_of(columns))).to_pydict() == {**wanted, "whole": [1, 2, -3]}
    none = parquet_of({name: values[:0] for name, values in columns.items()})
    assert pq.read_table(io.BytesIO(none)).num_rows == 0


@pytest.mark.parametrize("count", [60, MAX_ROWS + 1])
def test_equal_results_give_equal_bytes(count: int, tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        registration(count=count).to_json(tmp_path / name / "out.json")
    for file in (tmp_path / "a").iterdir():
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes()


def test_one_tie_point_a_line(tmp_path: Path) -> None:
    registration().to_json(tmp_path / "out.json")
    lines = (tmp_path / "out.json").read_text().splitlines()
    assert sum(line.startswith("      [") for line in lines) == 75
    assert len(lines) < 75 + 60


def test_writing_5000_tie_points_takes_a_tenth_of_a_second(tmp_path: Path) -> None:
    made = registration(count=5000, refined=0)
    made.to_json(tmp_path / "warm.json")
    best = np.inf
    for _ in range(3):
        start = time.perf_counter()
        made.to_json(tmp_path / "out.json")
        best = min(best, time.perf_counter() - start)
    # Three times the goal: the machine that runs the tests may be busy.
    assert best < 0.3
