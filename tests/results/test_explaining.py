"""A result in plain words: every gate has a text, every text belongs to a gate, and causes are named."""

from __future__ import annotations

import ast
import inspect
import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import featreg
from featreg.cli.explain import explain_file
from featreg.cli.main import main
from featreg.errors import InputError
from featreg.interfaces import FailedFit
from featreg.pipeline.trust import CONDITIONS
from featreg.results.gate_texts import FOCUS, REGISTRATION
from featreg.results.losses import block_words, percent, why_no_fit
from featreg.results.registration import Registration
from featreg.simulate import SimulatedPair, sar_pair
from featreg.types import Gate

ROOT = Path(featreg.__file__).parent
ALL_TEXTS = [*REGISTRATION.items(), *FOCUS.items()]


def gate_names(*rooms: str) -> set[str]:
    """The names under which the modules of some rooms make gates: keys of dicts and subscripts, and conditions."""
    found: set[str] = set()
    for room in rooms:
        for path in (ROOT / room).glob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                found.update(_names(node))
    return found


def _names(node: ast.AST) -> Iterator[str]:
    def text(key: ast.AST | None) -> Iterator[str]:
        if isinstance(key, ast.Constant) and isinstance(key.value, str):
            yield key.value

    def makes(value: ast.AST | None, name: str) -> bool:
        return isinstance(value, ast.Call) and isinstance(value.func, ast.Name) and value.func.id == name

    if isinstance(node, ast.Dict):
        for key, value in zip(node.keys, node.values, strict=True):
            if makes(value, "Gate"):
                yield from text(key)
    elif isinstance(node, ast.Assign) and makes(node.value, "Gate"):
        for target in node.targets:
            if isinstance(target, ast.Subscript):
                yield from text(target.slice)
    elif makes(node, "Condition"):
        assert isinstance(node, ast.Call)
        yield from text(node.args[0] if node.args else next((k.value for k in node.keywords if k.arg == "name"), None))


def test_every_gate_of_a_registration_has_a_text() -> None:
    made = gate_names("pipeline", "scene") | {condition.name for condition in CONDITIONS}
    assert {"inliers", "prior", "search", "block_error"} <= made
    assert made <= set(REGISTRATION)


def test_every_gate_of_focusing_has_a_text_and_every_text_a_gate() -> None:
    assert gate_names("focusing") == set(FOCUS)


@pytest.mark.parametrize(("name", "text"), ALL_TEXTS)
def test_texts_are_lines_that_end_without_a_stop(name: str, text: Any) -> None:
    for line in (text.measures, text.limit, text.cause, *text.cures):
        assert 10 < len(line) < 230, name
        assert "\n" not in line
        assert not line.endswith(".")
    assert text.cures


def test_the_options_that_are_offered_exist(capsys: pytest.CaptureFixture[str]) -> None:
    import featreg.results.explaining as explaining

    lines = [cure for _, text in REGISTRATION.items() for cure in text.cures]
    lines += [cure for cures in explaining.STAGE_CURES.values() for cure in cures]
    lines += re.findall(r'"(?:[^"\\]|\\.)*--[^"]*"', inspect.getsource(explaining))
    for command, texts in (("match", lines), ("focus", [cure for _, text in FOCUS.items() for cure in text.cures])):
        assert main([command, "--help"]) == 0
        known = set(re.findall(r"--[a-z][a-z-]*", capsys.readouterr().out))
        offered = {option for text in texts for option in re.findall(r"--[a-z][a-z-]+", text)}
        # The second role of a mask is put in where it is said.
        assert offered - {"--mask-"} <= known | {"--json"}
    names = re.findall(r"--method ([a-z-]+)|--model ([a-z0-9-]+)", " ".join(lines))
    known = {*featreg.available("method"), *featreg.available("model"), "rpc-bias"}
    assert {name for pair in names for name in pair if name} <= known


# What a result says


@pytest.fixture(scope="module")
def good(pair: SimulatedPair) -> Registration:
    return featreg.match(pair.reference, pair.secondary)


def test_a_good_result_is_explained_gate_by_gate(good: Registration) -> None:
    text = good.explain()
    lines = text.splitlines()
    assert lines[0] == "ok"
    assert max(map(len, lines)) <= 110
    for name, gate in good.gates.items():
        (line,) = [at for at in lines if at.startswith(f"  ok     {name}: ")]
        assert f"{gate.value:.4g}" in line
    assert "FAILED" not in text
    assert "what to try" not in text


@pytest.mark.parametrize("name", REGISTRATION)
def test_a_gate_that_fails_says_cause_and_cure(good: Registration, name: str) -> None:
    gates = {**good.gates, name: Gate(3.5, high=2.0, meaning="of a test, px")}
    text = replace(good, gates=gates, status="unreliable", reason=f"{name} {gates[name].failure}").explain()
    flat = " ".join(text.split())
    assert flat.startswith(f"unreliable: {name} 3.5 is above 2 (of a test, px)")
    assert f"FAILED {name}: 3.5, at most 2" in flat
    for said in (REGISTRATION[name].measures, REGISTRATION[name].limit, REGISTRATION[name].cause):
        assert said in flat
    assert f"1. {REGISTRATION[name].cures[0]}" in flat


def test_a_gate_that_nobody_knows_is_told_by_its_own_meaning(good: Registration) -> None:
    gates = {"ships": Gate(None, low=2.0, meaning="ships on both images", unknown="the sea is masked")}
    text = replace(good, gates=gates, status="unreliable", reason=f"ships {gates['ships'].failure}").explain()
    assert "ships cannot be told: the sea is masked (ships on both images)" in text
    assert "FAILED ships: unknown (the sea is masked), at least 2\n         ships on both images" in text
    assert "what to try first\n  1. look at both images" in text


# Causes of refusal


def refused(**given: Any) -> Registration:
    one = sar_pair((256, 256), seed=10)
    result = featreg.match(given.pop("reference", one.reference), given.pop("secondary", one.secondary), **given)
    assert result.status == "unreliable"
    for text in (result.reason, result.model.reason if isinstance(result.model, FailedFit) else ""):
        assert not re.search(r"undefined|got 0|nan", text)
    return result


def test_a_mask_that_leaves_nothing_is_the_cause() -> None:
    mask = np.zeros((256, 256), np.bool_)
    mask[:16, :16] = True
    found = refused(secondary_mask=mask)
    assert "there is no putative tie point" in found.reason
    assert "mask, nodata and samples that are no number leave 0.391 % of the secondary's 256 x 256" in found.reason
    assert "check the mask (--mask-secondary) and --nodata" in found.explain()


def test_nodata_that_leaves_little_is_the_cause() -> None:
    hole = sar_pair((256, 256), seed=10).secondary.copy()
    hole[:, 20:] = 0
    assert "leave 7.81 % of the secondary's" in refused(secondary=hole, nodata=0).reason


def test_an_initial_model_that_is_wrong_is_the_cause() -> None:
    found = refused(initial=[[1, 0, 150.0], [0, 1, 0]], search_radius=3.0)
    assert "no tie point is left after initial (none lies within 3 px of the initial model)" in found.reason
    assert "larger --search-radius" in found.explain()


def test_gms_that_keeps_nothing_of_unrelated_images_is_named() -> None:
    found = refused(secondary=sar_pair((256, 256), seed=20).secondary)
    putative = int(found.putative.sum())
    assert f"no tie point is left after gms (none moves as its neighbours do): {putative} putative" in found.reason
    assert f"gms kept none of {putative} tie points" in found.explain()


def test_an_image_too_small_is_the_cause() -> None:
    small = sar_pair((256, 256), seed=10)
    found = refused(reference=small.reference[:40, :50])
    assert "the reference has 50 x 40 pixels, all of them data" in found.reason
    assert "a larger cut-out" in found.explain()


def test_blocks_without_data_are_the_cause() -> None:
    mask = np.zeros((256, 256), np.bool_)
    mask[:16, :16] = True
    found = refused(reference_mask=mask, block=128, initial=np.eye(3)[:2], search_radius=10.0)
    assert "4 of 4 blocks were skipped (4 x no data in the reference)" in found.reason
    assert "4 of 4 blocks were skipped" in found.explain()


def test_a_prior_that_is_off_is_the_cause_in_blocks() -> None:
    found = refused(block=128, initial=[[1, 0, 100.0], [0, 1, 0]], search_radius=8.0)
    # One of hundreds may lie there by chance.
    assert re.search(r"prior .*lies within 8 px of where the prior \(initial model\) says\)", found.reason)
    assert "a larger --search-radius" in found.explain()


def test_overviews_that_do_not_match_say_why() -> None:
    found = refused(secondary=sar_pair((256, 256), seed=20).secondary, block=128)
    assert found.reason.startswith("without geolocation the prior is a match of the overviews, which failed: no model")
    assert "is left after" in found.reason


def test_own_tie_points_that_are_none() -> None:
    found = featreg.fit(np.zeros((0, 4)))
    assert found.reason == "no model could be fitted: there is no putative tie point"
    assert "no putative tie points" in found.explain()


def test_gates_without_a_value_say_what_is_missing() -> None:
    rng = np.random.default_rng(0)
    found = featreg.fit(rng.uniform(0, 300, (4, 4)), filters=())
    unknown = {name: gate for name, gate in found.gates.items() if gate.value is None}
    assert "held_out" in unknown
    assert all("4 final tie points" in gate.unknown for gate in unknown.values())
    assert "held_out cannot be told: only 4 final tie points" in found.reason


@pytest.mark.parametrize(
    ("kept", "words"),
    [
        ({}, "the fit's own reason (9 putative)"),
        ({"gms": 0}, "no tie point is left after gms (none moves as its neighbours do): 9 putative, 0 after gms"),
        ({"mine": 0}, "no tie point is left after mine: 9 putative, 0 after mine"),
        ({"a": 5, "b": 2}, "only 2 tie points are left after b, the model needs 3: 9 putative, 5 after a, 2 after b"),
        ({"fsc": 1}, "only one tie point is left after fsc, the model needs 3: 9 putative, 1 after fsc"),
        ({"gms": 5}, "the fit's own reason (9 putative, 5 after gms)"),
    ],
)  # fmt: skip
def test_what_left_too_few_is_named(kept: dict[str, int], words: str) -> None:
    assert why_no_fit(9, kept, 3, "the fit's own reason") == words


def test_few_given_and_shares() -> None:
    assert why_no_fit(2, {}, 3, "x") == "only 2 tie points are given, the model needs 3: 2 putative"
    assert why_no_fit(90, {"fsc": 5, "gms": 0}, 3, "x").endswith(
        "0 after gms; fsc kept 5 of 90 (each agrees with others on a model)"
    )
    assert [percent(share) for share in (0, 1e-5, 0.25, 0.99999, 1)] == [
        "0 %", "less than 0.1 %", "25 %", "all but less than 0.1 %", "100 %",
    ]  # fmt: skip
    reasons = [
        "no data in the reference: 0 % of the window",
        "no data in the reference: 3 % of the window",
        "",
        "OSError: x",
    ]
    assert block_words(["skipped", "skipped", "done", "failed"], reasons) == (
        "2 of 4 blocks were skipped (2 x no data in the reference); 1 of 4 blocks failed (1 x OSError: x)"
    )


# Files and the command line


def test_the_command_explains_and_exits_as_the_result_is(
    good: Registration, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good.to_json(tmp_path / "good.json")
    assert main(["explain", str(tmp_path / "good.json")]) == 0
    assert capsys.readouterr().out == good.explain() + "\n"
    bad = featreg.fit(np.random.default_rng(0).uniform(0, 300, (6, 4)))
    bad.to_json(tmp_path / "bad.json")
    assert main(["explain", str(tmp_path / "bad.json")]) == 3
    assert capsys.readouterr().out.startswith("unreliable: ")
    (tmp_path / "none.json").write_text("{}")
    for name in ("none.json", "missing.json"):
        assert main(["explain", str(tmp_path / name)]) == 2
        assert capsys.readouterr().err.startswith("error: ")


def test_a_focused_result_is_explained(tmp_path: Path) -> None:
    gates = {"pulses": Gate(4, 8, None, "pulses").to_dict(), "entropy": Gate(-1.0, None, 0.01, "rise").to_dict()}
    record = {"status": "unreliable", "reason": "too few pulses", "gates": gates, "image_entropy": [9.0, 8.0]}
    path = tmp_path / "focus.json"
    path.write_text(json.dumps({"schema_version": 1, "method": "auto", **record}))
    status, text = explain_file(path)
    assert status == "unreliable"
    assert "FAILED pulses: 4, at least 8" in text
    assert FOCUS["pulses"].cause in text
    for key, value in (("gates", 3), ("status", "maybe"), ("image_entropy", [1]), ("gates", {"a": 1})):
        path.write_text(json.dumps({"method": "auto", **record, key: value}))
        with pytest.raises(InputError, match="not a whole result"):
            explain_file(path)


def test_a_result_whose_provenance_is_nonsense_is_refused(tmp_path: Path) -> None:
    bad = featreg.fit(np.random.default_rng(0).uniform(0, 300, (6, 4)))
    replace(bad, provenance={**bad.provenance, "block_table": {"status": 3}}).to_json(tmp_path / "r.json")
    with pytest.raises(InputError, match="not a whole featreg result"):
        explain_file(tmp_path / "r.json")
