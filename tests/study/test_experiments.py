"""Experiments: one schema in three forms, predictions made once, tables that do not depend on who matched."""

from __future__ import annotations

import dataclasses
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import featreg
from featreg import Experiment
from featreg.cli.main import main
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


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two small pairs, named in pairs, with their truth."""
    home = tmp_path_factory.mktemp("pairs")
    for name, ends, seed in (("port", "_1 _2", 1), ("city", "_before _after", 2)):
        pair = sar_pair((128, 128), rotation_deg=3.0, scale=1.0, shift=(3.0, -2.0), seed=seed)
        for end, image in zip(ends.split(), (pair.reference, pair.secondary), strict=True):
            write_geotiff(home / f"{name}{end}.tif", image)
        (home / f"{name}_truth.json").write_text(json.dumps({"matrix": pair.truth.tolist()}))
    return home


def experiment(folder: Path, **changes: Any) -> Experiment:
    given: dict[str, Any] = {
        "pairs": pairs_in(folder),
        "methods": ["orb", {"method": "orb", "label": "few", "n_features": 500}],
        "protocol": {"timing": False, "threshold": 2.0},
    }
    return Experiment(**{**given, **changes})


def table_of(study: Study) -> list[Any]:
    return [dict(row) for row in study.table().rows]


# The schema


def test_files_round_trip(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    whole = Experiment(
        pairs=[
            {"name": 'a "port"', "reference": str(tmp_path / "a.tif"), "secondary": "b.tif", "truth": "identity"},
            ["c.tif", "d.tif", [[1.0, 0.0, 2.5], [0.0, 1.0, -3.0]]],
            ["e.tif", "f.tif"],
        ],
        methods=["sar-orb", {"method": "orb", "label": "strict", "fsc.threshold": 1.5, "filters": ["gms", "fsc"]}],
        parameters={"refine": False, "n_features": 2000},
        grid={"trust.least_inliers": [8, 12]},
        seeds=[0, 7],
        protocol=Protocol(threshold=2.0, time_limit=60.0, filters=("gms", "fsc"), refine=True, nodata=0.0),
        metrics=["ncm", "auc@3", "act.detect"],
        title="Ports at night: 50 % clouds",
    )
    for name in ("e.yaml", "sub/e.toml"):
        whole.to_file(tmp_path / name)
        back = Experiment.from_file(tmp_path / name)
        assert back.methods == whole.methods
        assert (back.protocol, back.seeds, back.metrics) == (whole.protocol, whole.seeds, whole.metrics)
        assert (back.grid, back.parameters, back.title) == (whole.grid, whole.parameters, whole.title)
        assert back.pairs[0] == whole.pairs[0] | {"secondary": back.pairs[0]["secondary"]}
        assert Path(back.pairs[0]["secondary"]).resolve() == Path("b.tif").resolve()
        assert back.pairs[1][2] == whole.pairs[1][2]
        back.to_file(tmp_path / "again.yaml")
        assert Path(Experiment.from_file(tmp_path / "again.yaml").pairs[2][0]).resolve() == Path("e.tif").resolve()


@pytest.mark.parametrize("suffix", [".yaml", ".toml"])
def test_an_equal_experiment_comes_back(suffix: str, tmp_path: Path, folder: Path) -> None:
    made = experiment(folder, seeds=[1, 2])
    made.to_file(tmp_path / f"e{suffix}")
    assert Experiment.from_file(tmp_path / f"e{suffix}") == made


def test_an_array_cannot_stand_in_a_file(tmp_path: Path) -> None:
    image = np.zeros((20, 20), np.float32)
    with pytest.raises(InputError, match=r"pairs\[1\]\[1\] is a ndarray"):
        Experiment([(image, image)], ["orb"]).to_file(tmp_path / "e.yaml")
    assert list(tmp_path.iterdir()) == []


GOOD = "pairs: [[a.tif, b.tif]]\nmethods: [orb]\n"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("pairs: [[a.tif, b.tif]]\nmethod: [orb]\n", "unknown key 'method', did you mean 'methods'"),
        ("methods: [orb]\n", "it has no pairs"),
        ("pairs: [[a.tif]]\nmethods: [orb]\n", r"pair 1 must be \(reference, secondary\)"),
        ("pairs: [{refrence: a, secondary: b}]\nmethods: [orb]\n", "pair 1: unknown key 'refrence', did you mean"),
        ("pairs: [{reference: a}]\nmethods: [orb]\n", "pair 1 has no secondary"),
        ("pairs: [{folder: nowhere}]\nmethods: [orb]\n", "nowhere' is not a folder"),
        ("pairs: [[a, b]]\nmethods: [3]\n", "method 1 must be a name or a mapping"),
        ("pairs: [[a, b]]\nmethods: orb\n", "methods must be a list"),
        (GOOD + "protocol: {treshold: 2}\n", "protocol: unknown key 'treshold', did you mean 'threshold'"),
        (GOOD + "protocol: {threshold: two}\n", "threshold must be a number of pixels > 0, got 'two'"),
        (GOOD + "protocol: {timing: 1}\n", "timing must be true or false"),
        (GOOD + "metrics: [ncmm]\n", "unknown metric 'ncmm', did you mean 'ncm'"),
        (GOOD + "grid: [1, 2]\n", "grid must be a mapping"),
        ("- 1\n- 2\n", "it must hold the keys"),
        ("pairs: [\n", "cannot be read"),
    ],
)
def test_a_mistake_in_a_file_is_one_line_that_names_the_place(text: str, why: str, tmp_path: Path) -> None:
    (tmp_path / "e.yaml").write_text(text)
    with pytest.raises(InputError, match=why) as caught:
        Experiment.from_file(tmp_path / "e.yaml")
    assert "e.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)


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


def test_what_cannot_run_is_refused_before_anything_is_matched(folder: Path) -> None:
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


def test_isolated_threads_processes_and_serial_give_one_table(folder: Path) -> None:
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
def test_any_executor_gives_the_same_table(folder: Path) -> None:
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
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
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
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = count_matching(monkeypatch)
    for protocol in ({}, {"filters": ["fsc"]}, {"n_features": 900}, {"model": "rigid"}, {"refine": False}):
        made = experiment(folder, methods=["orb"], protocol={"timing": False, **protocol})
        made.run(resume=tmp_path, isolate=False)
        made.run(resume=tmp_path, isolate=False)
    assert len(calls) == 10
    assert len(list(tmp_path.glob("*.json"))) == 10


def test_a_plugin_that_changed_is_matched_again(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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
def test_times_by_stage_come_from_a_serial_pass_and_are_kept(folder: Path, tmp_path: Path) -> None:
    metrics = ["ncm", "time_s", "act.detect", "act.gms"]
    made = experiment(folder, pairs=pairs_in(folder)[:1], methods=["orb"], protocol={}, metrics=metrics)
    first = made.run(workers=2, resume=tmp_path)
    rows = table_of(first)
    assert all(0 < row["act.gms"] < row["time_s"] and 0 < row["act.detect"] < row["time_s"] for row in rows)
    assert table_of(made.run(resume=tmp_path)) == rows
    assert "first call of each method discarded" in str(first.table())


def test_seeds_are_rows_and_intervals_are_over_pairs(folder: Path) -> None:
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


def test_the_protocol_says_when_methods_are_not_treated_alike(folder: Path) -> None:
    text = "\n".join(experiment(folder).run(isolate=False).table().protocol)
    assert "the methods differ in their budget" in text
    assert "machine: " in text
    same = experiment(folder, protocol={"timing": False, "filters": ["gms", "fsc"], "n_features": 700}, methods=["orb"])
    assert "differ" not in "\n".join(same.run(isolate=False).table().protocol)


def test_layouts_of_the_paper(folder: Path) -> None:
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


def test_parquet_holds_rows_and_protocol(folder: Path, tmp_path: Path) -> None:
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


# Command line

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    monkeypatch.chdir(folder)

    def run(*arguments: str) -> tuple[int, str, str]:
        capsys.readouterr()
        code = main(arguments)
        return code, *capsys.readouterr()

    return run


def test_a_folder_an_experiment_file_and_objects_are_one(run: Run, folder: Path, tmp_path: Path) -> None:
    save = str(tmp_path / "e.toml")
    base = ("--format", "csv", "--no-isolate", "--no-times")
    code, table, err = run("compare", ".", "--methods", "orb", "--metrics", "ncm,auc@3", "--save", save, *base)
    assert (code, err) == (0, "")
    assert run("compare", "--experiment", save, *base)[1] == table
    assert Experiment.from_file(save).run(isolate=False).table().to_csv() == table
    assert "recall" in run("compare", "--experiment", save, "--metrics", "+recall", *base)[1].splitlines()[0]


def test_outputs(run: Run, tmp_path: Path) -> None:
    for suffix in (".md", ".csv", ".tex", ".json", ".parquet"):
        out = tmp_path / f"t{suffix}"
        code, _, err = run("compare", ".", "--methods", "orb", "--no-isolate", "--no-times", "-o", str(out))
        assert (code, err) == (0, "")
        assert out.stat().st_size > 100


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["compare"], ["missing option '--methods'"]),
        (["compare", "--methods", "orb"], ["images come in pairs", "got 0"]),
        (["compare", ".", "port_1.tif", "--methods", "orb"], ["'.' is a directory"]),
        (["compare", ".", "--methods", "orb", "--metrics", "ncm,auk@3"], ["'auk@3'", "auc@3"]),
        (["compare", ".", "--methods", "orb", "--layout", "table5"], ["'table5'", "table"]),
        (["compare", ".", "--methods", "orb", "--time-limit", "0"], ["seconds > 0"]),
        (["compare", ".", "--methods", "orb", "--threshold", "-1"], ["threshold", "-1"]),
        (["compare", ".", "--methods", "orb", "-o", "t.doc"], ["--out", ".parquet"]),
        (["compare", ".", "--methods", "orb", "--report", "t.pdf"], ["--report", ".html"]),
        (["compare", ".", "--methods", "all", "--set", "no.such=1"], ["no method takes these parameters"]),
        (["compare", "--experiment", "no.yaml"], ["no.yaml", "cannot be read"]),
        (["compare", ".", "--experiment", "no.yaml"], ["images", "--experiment"]),
        (["compare", "--experiment", "no.yaml", "--seed", "3"], ["--seed", "write it into the file"]),
    ],
    ids=lambda value: " ".join(value)[:40] if isinstance(value, list) else None,
)
def test_misuse_is_one_line(arguments: list[str], words: list[str], run: Run) -> None:
    code, out, err = run(*arguments)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    for word in words:
        assert word in err


@pytest.mark.slow
def test_killed_and_resumed_it_ends_identical(folder: Path, tmp_path: Path) -> None:
    """SIGKILL at several moments; the table, times included where they had been kept, is that of the kept results."""
    command = [sys.executable, "-m", "featreg", "compare", str(folder), "--methods", "orb,sar-orb"]
    command += ["--no-times", "--format", "csv", "--metrics", "+recall,auc@3"]
    whole = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    kept = tmp_path / "kept"
    for least in (1, 3):
        running = subprocess.Popen([*command, "--resume", str(kept)], stdout=subprocess.DEVNULL)
        deadline = time.monotonic() + 120
        while len(list(kept.glob("*.json"))) < least and running.poll() is None and time.monotonic() < deadline:
            time.sleep(0.01)
        running.send_signal(signal.SIGKILL)
        running.wait()
        assert len(list(kept.glob("*.json"))) >= least
    # A file that was cut off is computed afresh.
    cut = next(iter(kept.glob("*.json")))
    cut.write_bytes(cut.read_bytes()[:500])
    for _ in range(2):
        done = subprocess.run([*command, "--resume", str(kept)], capture_output=True, text=True, check=True)
        assert done.stdout == whole
    assert not list(kept.glob(".*"))


def test_a_report_reads_plain_files_itself(folder: Path) -> None:
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


BOMB = "".join(f"  x{i}: &x{i} [{', '.join([f'*x{i - 1}'] * 10)}]\n" for i in range(1, 12))


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ("parameters: &a {n_features: *a}", "an alias .* that holds itself"),
        ("grid:\n  n_features: [" + "[" * 3000, "nested more than 30 deep"),
        ("grid:\n  x0: &x0 [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]\n" + BOMB, "aliases .* unfold to more than"),
        ("grid: {" + ", ".join(f"p{i}: [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]" for i in range(9)) + "}", "1000000000 points"),
    ],
    ids=["recursive", "deep", "bomb", "grid"],
)  # fmt: skip
def test_a_file_that_would_never_end_is_refused_at_once(more: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "e.yaml"
    path.write_text(f"pairs: [[a.tif, b.tif]]\nmethods: [orb]\n{more}\n")
    start = time.perf_counter()
    with pytest.raises(featreg.FeatregError, match=words):
        Experiment.from_file(path).labelled()
    assert time.perf_counter() - start < 5


def test_shared_parameters_may_be_written_once(tmp_path: Path) -> None:
    path = tmp_path / "e.yaml"
    path.write_text(
        "pairs: [[a.tif, b.tif]]\nmethods:\n- {method: orb, n_features: &n 700}\n- {method: sift, n_features: *n}\n"
    )
    assert [m.keywords["n_features"] for m in Experiment.from_file(path).labelled().values()] == [700, 700]
