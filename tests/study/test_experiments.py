"""Experiments: one schema in three forms, predictions made once, tables that do not depend on who matched."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import featreg
from featreg import Experiment
from featreg.errors import FeatregError, InputError, ParameterError, UnknownNameError
from featreg.io import as_image, write_geotiff
from featreg.report.from_study import report_of
from featreg.simulate import sar_pair
from featreg.study import prediction_cache
from featreg.study.experiment_results import Study
from featreg.study.image_pairs import pairs_in
from featreg.study.protocol import Protocol
from featreg.types import Geolocation

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
Make = Callable[..., Experiment]


def table_of(study: Study) -> list[Any]:
    return [dict(row) for row in study.table().rows]


@pytest.mark.parametrize("suffix", [".yaml", ".toml"])
def test_an_equal_experiment_comes_back(experiment: Make, suffix: str, tmp_path: Path, folder: Path) -> None:
    made = experiment(folder, seeds=[1, 2])
    made.to_file(tmp_path / f"e{suffix}")
    assert Experiment.from_file(tmp_path / f"e{suffix}") == made


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"seeds": 5}, "seeds must be a list"),
        ({"seeds": [1, 1]}, "seeds must differ"),
        ({"seeds": [True]}, "whole numbers"),
        ({"grid": {"n_features": 5}}, "'n_features' needs a list"),
        ({"metrics": []}, "at least one metric"),
        ({"protocol": {"confidence": 95}}, "confidence"),
        ({"protocol": {"n_features": 0}}, "n_features"),
    ],
)
def test_a_mistake_in_an_object(changes: dict[str, Any], why: str) -> None:
    with pytest.raises(ParameterError, match=why):
        Experiment([("a", "b")], ["orb"], **changes)


def test_what_cannot_run_is_refused_before_anything_is_matched(experiment: Make, folder: Path) -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'orb'"):
        experiment(folder, methods=["orbb"]).run()
    with pytest.raises(ParameterError, match=r"method 'orb treshold=1'.*no part .*'treshold'"):
        experiment(folder, methods=["orb"], grid={"treshold": [1]}).run()
    for own in ({"parameters": {"seed": 3}}, {"grid": {"seed": [1, 2]}}, {"methods": [{"method": "orb", "seed": 3}]}):
        with pytest.raises(ParameterError, match="'seed' is no parameter of a method; give a list of seeds"):
            experiment(folder, **own).run()
    city = pairs_in(folder)[0]
    with pytest.raises(InputError, match=r"pair 1: .*no\.csv"):
        experiment(folder, pairs=[(city["reference"], city["secondary"], "no.csv")]).run()
    with pytest.raises(FeatregError, match="not-there"):
        Experiment.from_file("not-there.yaml")
    with pytest.raises(InputError, match=r"must be a \.yaml"):
        Experiment.from_file("e.json")


def test_pairs_of_a_folder_follow_the_rule(folder: Path, tmp_path: Path) -> None:
    found = pairs_in(folder)
    assert [pair["name"] for pair in found] == ["city", "port"]
    assert Path(found[0]["reference"]).name == "city_before.tif"
    assert Path(found[1]["truth"]).name == "port_truth.json"
    for name in ("x-ref.png", "x-sec.png", "x.csv", "alone_1.tif", "4.tif", "notes_1.txt"):
        (tmp_path / name).touch()
    (only,) = pairs_in(tmp_path)
    assert (only["name"], Path(only["truth"]).name) == ("x", "x.csv")
    with pytest.raises(InputError, match="holds no pairs: two images whose names end in"):
        pairs_in(tmp_path.parent / tmp_path.name / "..")


# Running


def test_isolated_threads_processes_and_serial_give_one_table(experiment: Make, folder: Path) -> None:
    made = experiment(folder, metrics=["nm", "ncm", "rmse", "grid_rmse", "repeatability", "recall", "mma@3"])
    serial = made.run(isolate=False)
    assert serial.table().failed == 0
    assert all(row["repeatability"] > 0.1 for row in table_of(serial))
    expected = made.run(workers=2)
    assert table_of(expected) == table_of(serial)
    assert expected.table().to_csv() == serial.table().to_csv()
    with ThreadPoolExecutor(2) as threads:
        assert table_of(made.run(executor=threads, isolate=False)) == table_of(serial)


@pytest.mark.slow
def test_any_executor_gives_the_same_table(experiment: Make, folder: Path) -> None:
    made = experiment(folder)
    serial = table_of(made.run(isolate=False))
    with ProcessPoolExecutor(2, get_context("spawn")) as processes:
        assert table_of(made.run(executor=processes)) == serial
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        assert table_of(made.run(executor=client)) == serial


def count_matching(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    calls: list[str] = []
    real = featreg.match

    def match(*given: Any, **keywords: Any) -> Any:
        calls.append(keywords["method"])
        return real(*given, **keywords)

    monkeypatch.setattr("featreg.matching.match", match)
    return calls


def test_another_metric_or_threshold_matches_nothing_again(
    experiment: Make, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = count_matching(monkeypatch)
    study = experiment(folder).run(resume=tmp_path, isolate=False)
    assert len(calls) == 4
    assert study.table(["auc@3", "ncm"]).metrics == ("auc@3", "ncm")
    with pytest.raises(ParameterError, match="'recall' needs keypoints"):
        study.table(["recall"])
    more = experiment(folder, metrics=["ncm", "recall", "mma@5"], protocol={"timing": False, "threshold": 1.0})
    again = more.run(resume=tmp_path, isolate=False)
    assert len(calls) == 4
    assert all(row["recall"] is not None for row in table_of(again))
    assert any(a["ncm"] != b["ncm"] for a, b in zip(table_of(study), table_of(again), strict=True))


def test_another_protocol_of_matching_is_never_mixed_in(
    experiment: Make, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = count_matching(monkeypatch)
    for protocol in ({}, {"filters": ["fsc"]}, {"n_features": 900}, {"model": "rigid"}, {"refine": False}):
        made = experiment(folder, methods=["orb"], protocol={"timing": False, **protocol})
        made.run(resume=tmp_path, isolate=False)
        made.run(resume=tmp_path, isolate=False)
    assert len(calls) == 10
    assert len(list(tmp_path.glob("*.json"))) == 10


def test_a_plugin_that_changed_is_matched_again(
    experiment: Make, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = count_matching(monkeypatch)
    made = experiment(folder, methods=["orb", "akaze", ("other filter", {"method": "orb", "filters": ["ransac"]})])
    made.run(resume=tmp_path, isolate=False)
    before = len(calls)
    real = prediction_cache._file
    monkeypatch.setattr(prediction_cache, "_file", lambda name: b"edited" if name.endswith(".gms") else real(name))
    made.run(resume=tmp_path, isolate=False)
    assert calls[before:] == ["orb", "orb", "akaze", "akaze"]
    monkeypatch.setattr(prediction_cache, "_core", lambda: b"edited")
    made.run(resume=tmp_path, isolate=False)
    assert len(calls) == 2 * before + 4


@pytest.mark.slow
def test_times_by_stage_come_from_a_serial_pass_and_are_kept(experiment: Make, folder: Path, tmp_path: Path) -> None:
    metrics = ["ncm", "time_s", "act.detect", "act.gms"]
    made = experiment(folder, pairs=pairs_in(folder)[:1], methods=["orb"], protocol={}, metrics=metrics)
    first = made.run(workers=2, resume=tmp_path)
    rows = table_of(first)
    assert all(0 < row["act.gms"] < row["time_s"] and 0 < row["act.detect"] < row["time_s"] for row in rows)
    assert table_of(made.run(resume=tmp_path)) == rows
    assert "first call of each method discarded" in str(first.table())


def test_seeds_are_rows_and_intervals_are_over_pairs(experiment: Make, folder: Path) -> None:
    table = experiment(folder, seeds=[0, 1]).run(isolate=False).table()
    assert [row["seed"] for row in table.rows] == [0, 1] * 4
    assert {(row["pair"], row["method"]) for row in table.summary()} == {
        (a, b) for a in ("median", "mean") for b in ("orb", "few")
    }
    found = table.intervals()["orb"]["ncm"]
    assert (found.count, found.over) == (2, "pairs")
    assert found.mean == pytest.approx(np.mean([row["ncm"] for row in table.rows if row["method"] == "orb"]))
    ((name, rest),) = table.differences().items()
    assert name == "few"
    assert rest["ncm"].mean == pytest.approx(table.intervals()["few"]["ncm"].mean - found.mean)  # type: ignore[operator]
    with pytest.raises(ParameterError, match="did you mean 'orb'"):
        table.differences("orbb")


def test_the_protocol_says_when_methods_are_not_treated_alike(experiment: Make, folder: Path) -> None:
    text = "\n".join(experiment(folder).run(isolate=False).table().protocol)
    assert "the methods differ in their budget" in text
    assert "machine: " in text
    same = experiment(folder, protocol={"timing": False, "filters": ["gms", "fsc"], "n_features": 700}, methods=["orb"])
    assert "differ" not in "\n".join(same.run(isolate=False).table().protocol)


def test_layouts_of_the_paper(experiment: Make, folder: Path) -> None:
    metrics = ["blocks", "nm", "ncm", "precision", "rmse", "time_s", "act", "around_s"]
    table = experiment(folder, protocol={}, metrics=metrics).run(isolate=False).table()
    lines = table.to_markdown(layout="table3").splitlines()
    assert lines[0] == "| Image pair | Method | Blocks | NM | NCM | Precision | RMSE | ACT (s) | Around (s) |"
    assert [line.split(" | ")[0] for line in lines[2:6]] == ["| city", "| ", "| port", "| "]
    assert table.to_csv(layout="table2").splitlines()[0] == "Image pair,Method,NCM,RMSE,Computational time (s)"
    latex = table.to_latex(layout="table3")
    # Where both methods are trusted one of them is the best; of a single one nothing is.
    whole = [pair for pair in ("city", "port") if all(r["status"] == "ok" for r in table.rows if r["pair"] == pair)]
    assert len(whole) == 1
    assert latex.count(r"\textbf") >= 4
    assert latex.count(r"$^{\dagger}$ &") == sum(row["status"] == "unreliable" for row in table.rows)
    with pytest.raises(ParameterError, match="did you mean 'table3'"):
        table.to_markdown(layout="table33")
    with pytest.raises(ParameterError, match=r"needs the metrics .*time_s"):
        experiment(folder, metrics=["ncm"]).run(isolate=False).table().to_markdown(layout="table2")


def test_parquet_holds_rows_and_protocol(experiment: Make, folder: Path, tmp_path: Path) -> None:
    import pandas as pd
    import pyarrow.parquet as pq

    table = experiment(folder).run(isolate=False).table()
    table.to_parquet(tmp_path / "t.parquet")
    frame = pd.read_parquet(tmp_path / "t.parquet")
    assert frame["ncm"].tolist() == [row["ncm"] for row in table.rows]
    note = json.loads(pq.read_schema(tmp_path / "t.parquet").metadata[b"featreg"])
    assert note["protocol"] == list(table.protocol)


def test_truth_from_the_images_own_geolocation(tmp_path: Path) -> None:
    pair = sar_pair((128, 128), rotation_deg=0.0, scale=1.0, shift=(4.0, -6.0), seed=5)
    for name, image, (x, y) in (("a", pair.reference, (0, 0)), ("b", pair.secondary, (-4, 6))):
        place = Geolocation((10.0, 0.0, 5e5 + 10 * x, 0.0, -10.0, 6e6 - 10 * y), "EPSG:32632")
        write_geotiff(tmp_path / f"{name}.tif", image, place)
    truth = featreg.study.image_pairs.resolve([(tmp_path / "a.tif", tmp_path / "b.tif", "geolocation")])[0].truth
    assert truth is not None
    np.testing.assert_allclose(truth([[10, 20], [100, 90]]), [[14, 14], [104, 84]], atol=1e-3)
    (row,) = featreg.compare([(tmp_path / "a.tif", tmp_path / "b.tif", "geolocation")], ["orb"], timing=False).rows
    assert row["grid_rmse"] < 0.5
    write_geotiff(tmp_path / "c.tif", pair.secondary)
    with pytest.raises(InputError, match=r"pair 1: .*c\.tif.*nothing says where the image lies"):
        featreg.compare([(tmp_path / "a.tif", tmp_path / "c.tif", "geolocation")], ["orb"])
    same = featreg.study.image_pairs.resolve([(tmp_path / "a.tif", tmp_path / "c.tif", "identity")])[0].truth
    assert same is not None
    assert str(same) == "identity"


def test_a_report_reads_plain_files_itself(experiment: Make, folder: Path) -> None:
    """A path is handed on, so that of a large scene only an overview is read."""
    (plain,) = report_of(experiment(folder, pairs=pairs_in(folder)[:1], methods=["orb"]).run(isolate=False)).pairs
    assert plain.reference == folder / "city_before.tif"
    told = {"timing": False, "nodata": 0.0, "scale": "intensity"}
    made = experiment(folder, pairs=pairs_in(folder)[:1], methods=["orb"], protocol=told).run(isolate=False)
    read: Any = report_of(made).pairs[0].reference
    image = read()
    assert image.amplitude.max() == pytest.approx(np.sqrt(as_image(folder / "city_before.tif").amplitude.max()))


def test_protocol_survives_replacing() -> None:
    assert dataclasses.replace(Protocol(filters=("gms",)), threshold=3).to_dict() == {
        "threshold": 3,
        "filters": ["gms"],
    }
