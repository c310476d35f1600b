"""What `featreg.match` takes, declared once: the signature, the command line, experiments, digests, suggestions."""

from __future__ import annotations

import inspect
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import featreg
from featreg.cli.main import main
from featreg.errors import CancelledError, ParameterError, UnknownNameError
from featreg.matching import check_keywords
from featreg.pipeline.assembly import assemble
from featreg.pipeline.keywords import BY_NAME, KEYWORDS, deciding, names, of_keypoints, of_pipeline
from featreg.simulate import SimulatedPair


def test_match_takes_what_is_declared_and_parts_take_the_rest() -> None:
    parameters = inspect.signature(featreg.match).parameters
    taken = [name for name, p in parameters.items() if p.kind is p.KEYWORD_ONLY]
    assembled = [name for name, p in inspect.signature(assemble).parameters.items() if p.kind is p.KEYWORD_ONLY]
    assert {*taken, *names("part")} == set(BY_NAME)
    assert {"method", *assembled, *names("part")} - {"blocks"} == set(names("method", "part"))
    assert len(BY_NAME) == len(KEYWORDS)


def test_every_option_that_is_declared_is_one_of_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["match", "--help"]) == 0
    said = capsys.readouterr().out
    for keyword in KEYWORDS:
        for option in keyword.option.split(" or "):
            assert option in said


@pytest.mark.parametrize(
    ("given", "near"),
    [("resum", "resume"), ("methd", "method"), ("cancl", "cancel"), ("blok", "block"), ("thread", "threads")],
)
def test_a_misspelt_keyword_is_told_the_nearest(given: str, near: str, pair: SimulatedPair) -> None:
    keyword: dict[str, Any] = {given: 1}
    with pytest.raises(ParameterError, match=f"'{near}'"):
        featreg.match(pair.reference, pair.secondary, **keyword)


def test_kinds_of_keywords() -> None:
    given = {"method": "rift", "seed": 1, "workers": 2, "nodata": 0, "fsc.threshold": 2.0, "block": 300, "progress": 1}
    assert of_pipeline(given) == {"method": "rift", "fsc.threshold": 2.0}
    assert deciding(given) == {k: v for k, v in given.items() if k not in ("workers", "progress")}
    assert of_keypoints(given) == {"method": "rift", "nodata": 0, "fsc.threshold": 2.0, "block": 300}
    assert of_keypoints({"dem": "a.tif"}) == of_keypoints({"split": "prior"}) == {"block": True}
    assert of_keypoints({"split": "proportional"}) == {"split": "proportional", "block": True}
    assert of_keypoints({"model": "rpc-bias"}) == {"model": "rpc-bias", "block": True}
    assert of_keypoints({"dem": "a.tif", "block": 240}) == {"block": 240}


@pytest.mark.parametrize(
    "keywords",
    [{"focus": "auto"}, {"block": 300}, {"workers": 2}, {"threads": 1}, {"height": 20.0}, {"block": False},
     {"executor": "serial"}, {"reference_mask": np.ones((300, 300), np.bool_)}],
)  # fmt: skip
def test_an_experiment_takes_what_match_takes(keywords: dict[str, Any], pair: SimulatedPair) -> None:
    experiment = featreg.Experiment([(pair.reference, pair.secondary)], ["sar-orb"], keywords)
    experiment.check()
    assert experiment.labelled()["sar-orb"].keywords.items() >= keywords.items()


@pytest.mark.parametrize(
    ("keywords", "text"),
    [
        ({"block": False, "height": 3.0}, "is for blocks"),
        ({"focus": "best"}, "unknown autofocus method"),
        ({"workers": 0}, "workers must be"),
        ({"threads": True}, "threads must be"),
        ({"search_radius": 3.0}, "needs initial"),
        ({"blok": 3}, "'block'"),
    ],
)
def test_an_experiment_refuses_what_match_refuses(keywords: dict[str, Any], text: str, pair: SimulatedPair) -> None:
    with pytest.raises(ParameterError, match=text):
        featreg.Experiment([(pair.reference, pair.secondary)], ["sar-orb"], keywords).check()
    with pytest.raises(ParameterError, match=text):
        check_keywords(keywords)


# What does nothing is refused


@pytest.mark.parametrize(
    ("keywords", "text"),
    [
        ({"method": "rc-obcls", "detector": "fast"}, "detector does nothing here: 'rc-obcls' makes tie points by"),
        ({"method": "cls", "descriptor": "brief"}, "matcher 'patch-grid'"),
        ({"matcher": "patch-grid", "nearest": "brute-force"}, "nearest does nothing"),
        ({"method": "rc-obcls", "common_rotation": True}, "common_rotation is for methods that describe"),
        ({"method": "rc-obcls", "pixels_per_feature": 60.0}, "pixels_per_feature is for methods that describe"),
        ({"pixels_per_feature": -1.0}, "'pixels_per_feature' must be"),
        ({"refine": False, "refine.half": 20}, "does nothing without refinement"),
        ({"locate": False, "half_width": 12}, "does nothing without locating"),
        ({"method": "orb", "least_peak": 0.5}, "does nothing without locating"),
        ({"method": "orb", "refine": False, "half": 20}, "does nothing without refinement"),
        ({"trust.block_share": 0.5}, "limit of scenes in blocks"),
        ({"height": 10.0}, "height does nothing here: array does not say where it lies"),
        ({"height": 10.0, "initial": np.eye(3), "search_radius": 9.0}, "the prior is the initial model"),
        ({"block": False, "dem": "dem.tif"}, "is for blocks"),
        ({"focus": "auto"}, "both images are real"),
    ],
)
def test_a_keyword_that_does_nothing_is_refused(keywords: dict[str, Any], text: str, pair: SimulatedPair) -> None:
    with pytest.raises((ParameterError, featreg.FeatregError), match=text):
        featreg.match(pair.reference, pair.secondary, **keywords)


def test_a_parameter_that_is_called_like_a_part_belongs_to_the_matcher() -> None:
    pipeline = assemble("optical-sar", detector="sar-harris", descriptor="ratio-gloh")
    assert pipeline.parameters["matcher"]["detector"] == "sar-harris"
    with pytest.raises(ParameterError, match="optical-sar"):
        assemble("optical-sar", matcher="patch-grid", detector="fast")


def test_a_detector_is_no_method() -> None:
    with pytest.raises(UnknownNameError, match="detector"):
        assemble("sar-ofast")


# How the work is run


@pytest.mark.parametrize(
    "how",
    [{"workers": 1}, {"threads": 1}, {"executor": "serial"}, {"executor": "threads", "workers": 2},
     {"progress": lambda done, total: None}, {"cancel": threading.Event()}],
)  # fmt: skip
def test_how_the_work_is_run_changes_nothing(how: dict[str, Any], pair: SimulatedPair) -> None:
    plain = featreg.match(pair.reference, pair.secondary, n_features=500)
    made = featreg.match(pair.reference, pair.secondary, n_features=500, **how)
    np.testing.assert_array_equal(made.matches.secondary_xy, plain.matches.secondary_xy)
    assert "blocks" not in made.provenance


def test_resume_of_whole_images_keeps_nothing_and_says_so(
    pair: SimulatedPair, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    made = featreg.match(pair.reference, pair.secondary, n_features=500, resume=tmp_path / "kept")
    assert made.status == "ok"
    assert not (tmp_path / "kept").exists()
    assert "matched whole" in caplog.text


@pytest.mark.parametrize("name", ["workers", "threads"])
@pytest.mark.parametrize("value", [0, -1, 1.5, True, "2"])
def test_impossible_numbers_of_workers_are_refused_on_whole_images(name: str, value: Any, pair: SimulatedPair) -> None:
    with pytest.raises(ParameterError, match=f"{name} must be"):
        featreg.match(pair.reference, pair.secondary, **{name: value})


def test_progress_of_whole_images_counts_to_the_end(pair: SimulatedPair) -> None:
    seen: list[tuple[int, int]] = []
    featreg.match(pair.reference, pair.secondary, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(i, 6) for i in range(1, 7)]


@pytest.mark.parametrize("after", [0, 1, 3])
def test_whole_images_are_cancelled_between_stages(after: int, pair: SimulatedPair) -> None:
    event = threading.Event()
    steps: list[int] = []

    def progress(done: int, total: int) -> None:
        steps.append(done)
        if done == after:
            event.set()

    if after == 0:
        event.set()
    with pytest.raises(CancelledError):
        featreg.match(pair.reference, pair.secondary, progress=progress, cancel=event)
    assert steps == list(range(1, after + 1))
    # Nothing of it stays: the next call runs to its end.
    assert featreg.match(pair.reference, pair.secondary).status == "ok"


def test_a_small_file_is_opened_once(located_pair: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from featreg.io import opening

    opened: list[str] = []
    real = opening.open_reader

    def counted(source: Any) -> Any:
        opened.append(Path(source).name)
        return real(source)

    monkeypatch.setattr(opening, "open_reader", counted)
    monkeypatch.setattr("featreg.io.raster_files.open_reader", counted)
    featreg.match(located_pair.reference, located_pair.secondary, n_features=300)
    assert sorted(opened) == ["reference.tif", "secondary.tif"]


def test_a_part_is_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    from featreg import registry

    made: list[str] = []
    real = registry.create

    def counted(kind: Any, name: str, **parameters: Any) -> Any:
        made.append(name)
        return real(kind, name, **parameters)

    monkeypatch.setattr(registry, "create", counted)
    assemble("rc-obcls")
    assemble("sar-orb")
    assert sorted(made) == ["brief", "brute-force", "fsc", "gms", "mad", "sar-ofast", "target-centroids"]


@pytest.mark.parametrize("how", [{"executor": "cluster"}, {"executor": 7}, {"progress": 1}, {"cancel": 1}], ids=str)
@pytest.mark.parametrize("block", [False, 150])
def test_impossible_ways_of_running_are_refused(how: dict[str, Any], block: Any, pair: SimulatedPair) -> None:
    with pytest.raises(ParameterError, match=next(iter(how))):
        featreg.match(pair.reference, pair.secondary, block=block, **how)
    with pytest.raises(ParameterError, match=next(iter(how))):
        featreg.Experiment([(pair.reference, pair.secondary)], ["orb"], how).check()


def test_a_scheduler_is_not_asked_for_whole_images(pair: SimulatedPair) -> None:
    made = featreg.match(pair.reference, pair.secondary, n_features=500, scheduler="tcp://127.0.0.1:9")
    assert made.status == "ok"


@pytest.mark.parametrize(
    ("keywords", "text"),
    [({"detector": "orb"}, "is for featreg.match"), ({"n_features": 5}, "is for featreg.match"),
     ({"half": 20}, "are not refined"), ({"filters": None}, "filters must be")],
)  # fmt: skip
def test_a_fit_says_what_is_for_match(keywords: dict[str, Any], text: str) -> None:
    points = np.random.default_rng(0).uniform(0, 200, (40, 2))
    with pytest.raises(ParameterError, match=text):
        featreg.fit(np.column_stack([points, points + 3]), **keywords)
