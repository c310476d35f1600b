"""Scenes in a comparison: blocks, heights of the ground for all and of a pair, the time of a block and around it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import featreg
from featreg import Experiment
from featreg.cli.main import main
from featreg.errors import InputError, ParameterError
from featreg.simulate.scene import ScenePair, simulate_scene
from featreg.study.case import Case
from featreg.study.experiment_results import Study
from featreg.study.image_pairs import resolve
from featreg.study.jobs import times_of
from featreg.study.metrics import metric_of
from featreg.study.protocol import Protocol

METRICS = ["blocks", "nm", "ncm", "precision", "rmse", "grid_rmse", "act", "around_s", "time_s", "act.blocks.detect"]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> ScenePair:
    return simulate_scene(tmp_path_factory.mktemp("scene"), (400, 520), relief=60.0, seed=2)


@pytest.fixture(scope="module")
def study(scene: ScenePair) -> Study:
    pair = {
        "reference": scene.reference, "secondary": scene.secondary, "truth": scene.truth_file, "dem": scene.dem,
    }  # fmt: skip
    protocol = Protocol(block=260, model="rpc-bias", filters=("gms", "fsc"), refine=False, warm_up=False)
    return Experiment([pair], ["sar-orb", "orb"], protocol=protocol, metrics=METRICS).run(isolate=False)


def test_a_scene_is_matched_in_blocks_over_its_own_heights(study: Study) -> None:
    for row in study.table().rows:
        assert row["status"] == "ok", row["reason"]
        assert row["blocks"] == 2
        assert row["grid_rmse"] < 0.5
    for made in study.outcomes.values():
        assert not isinstance(made.result, str)
        assert made.result.provenance["heights"]["source"] == "elevation model"
        # The same local filter is counted for both.
        assert list(made.result.stages)[:3] == ["prior", "gms", "fsc"]


def test_the_time_of_a_block_and_what_is_around_it_are_the_whole(study: Study) -> None:
    for row in study.table().rows:
        assert 0 < row["act"] < row["time_s"]
        assert row["around_s"] + row["blocks"] * row["act"] == pytest.approx(row["time_s"])
        assert row["act.blocks.detect"] < row["blocks"] * row["act"]
    text = study.table().to_markdown(layout="table3")
    assert text.splitlines()[0].endswith("| Precision | RMSE | ACT (s) | Around (s) |")


def test_act_leaves_out_reading_and_blocks_that_were_not_matched(study: Study) -> None:
    made = next(iter(study.outcomes.values())).result
    assert not isinstance(made, str)
    times = times_of(made)
    assert sum(times.values()) == pytest.approx(sum(made.timings.values()))
    act = {"prior": 1.0, "blocks": 0.25, "blocks.read": 8.0, "blocks.detect": 3.0, "blocks.gms": 1.0, "fsc": 0.5}
    case = Case(made, act=act)
    assert metric_of("act").function(case) == pytest.approx(4.0 / 2)
    assert metric_of("around_s").function(case) == pytest.approx(9.75)
    assert metric_of("time_s").function(case) == pytest.approx(13.75)


def test_a_whole_pair_costs_what_its_stages_cost(study: Study, pair: Any) -> None:
    whole = Experiment([(pair.reference, pair.secondary)], ["orb"], metrics=["act", "around_s", "time_s"])
    (row,) = whole.run(isolate=False).table().rows
    assert (row["act"], row["around_s"]) == (row["time_s"], 0.0)


def test_a_file_holds_blocks_and_heights_and_its_paths_follow_it(scene: ScenePair, tmp_path: Path) -> None:
    folder = tmp_path / "study"
    folder.mkdir()
    pair = {"reference": str(scene.reference), "secondary": str(scene.secondary), "height": 180.0}
    given = Experiment([pair], ["orb"], protocol=Protocol(block=260, dem="dem.tif", split="proportional"))
    given.to_file(folder / "scenes.toml")
    read = Experiment.from_file(folder / "scenes.toml")
    assert (read.protocol.block, read.protocol.split) == (260, "proportional")
    assert Path(str(read.protocol.dem)).resolve() == Path("dem.tif").resolve()
    (found,) = read.resolved()
    # The heights of a pair stand in place of what is said for all.
    assert found.keywords({"method": "orb", "dem": "dem.tif", "block": 260}) == {
        "method": "orb", "block": 260, "height": 180.0,
    }  # fmt: skip


def test_heights_that_cannot_be_are_named(scene: ScenePair) -> None:
    pair = {"reference": str(scene.reference), "secondary": str(scene.secondary)}
    for wrong, text in (
        ({"dem": "none.tif"}, "no elevation model 'none.tif'"),
        ({"dem": str(scene.dem), "height": 3.0}, "not from both"),
        ({"dem": 7}, "no elevation model '7'"),
        ({"height": "high"}, "height must be a number of metres"),
        ({"height": float("nan")}, "height must be a number of metres"),
    ):
        with pytest.raises(InputError, match=f"pair 1: .*{text}"):
            resolve([{**pair, **wrong}])
    with pytest.raises(ParameterError, match="block must be"):
        Protocol(block=0)
    with pytest.raises(ParameterError, match="height must be a number of metres, got nan"):
        Protocol(height=float("nan"))
    # What all pairs share is looked at once, before anything is computed.
    images = [(np.eye(64), np.eye(64))]
    asked = Experiment(images, ["orb"], protocol=Protocol(dem="none.tif"))
    for refused in (asked.check, asked.run, lambda: featreg.compare(images, ["orb"], dem="none.tif")):
        with pytest.raises(InputError, match=r"no elevation model 'none\.tif'"):
            refused()
    with pytest.raises(ParameterError, match="heights come from 'dem' or from 'height', not from both"):
        Protocol(dem="dem.tif", height=3.0)
    with pytest.raises(ParameterError, match="split must be 'prior' or 'proportional'"):
        Experiment([pair], ["orb"], protocol=Protocol(split="even")).check()


def test_the_command_compares_scenes(scene: ScenePair, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["compare", str(scene.reference), str(scene.secondary), "--methods", "orb"]
    command += ["--truth", str(scene.truth_file)]
    command += ["--block", "260", "--dem", str(scene.dem), "--model", "rpc-bias", "--no-refine", "--no-isolate"]
    assert main([*command, "--layout", "table3", "--format", "csv", "--times"]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[0].endswith("Blocks,NM,NCM,Precision,RMSE,ACT (s),Around (s)")
    assert printed[1].split(",")[2] == "2"
    assert main([*command, "--whole"]) == 2
    assert "--whole works on the whole images, --block is for blocks" in capsys.readouterr().err
