"""A gate judges itself, and all of them together say what a result is."""

from __future__ import annotations

import dataclasses
import json
import math

import pytest

from featreg.errors import InputError
from featreg.results.json_file import plain
from featreg.types import Gate, verdict


@pytest.mark.parametrize(
    ("gate", "failure"),
    [
        (Gate(5.0, low=5, meaning="points"), ""),
        (Gate(4.0, low=5, meaning="points"), "4 is below 5 (points)"),
        (Gate(0.25, high=0.25, meaning="px"), ""),
        (Gate(0.251, high=0.25, meaning="px"), "0.251 is above 0.25 (px)"),
        (Gate(2.0, 0.4, 2.5, "scale"), ""),
        (Gate(0.3, 0.4, 2.5, "scale"), "0.3 is below 0.4 (scale)"),
        (Gate(2.6, 0.4, 2.5, "scale"), "2.6 is above 2.5 (scale)"),
        (Gate(None, 0.4, 2.5, "scale"), "cannot be told (scale)"),
        (Gate(None, None, 2.5, "scale", "no tie point"), "cannot be told: no tie point (scale)"),
        (Gate(2.6, 0.4, 2.5, "scale", "no tie point"), "2.6 is above 2.5 (scale)"),
        (Gate(-3.0, meaning="of no limit"), ""),
        (Gate(None, meaning="of no limit"), "cannot be told (of no limit)"),
        (Gate(1e300, high=math.inf, meaning="px"), ""),
    ],
)
def test_a_gate_passes_within_its_limits_and_says_why_not(gate: Gate, failure: str) -> None:
    assert gate.passed is (failure == "")
    assert gate.failure == failure


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, None])
def test_what_is_not_finite_is_not_known_and_fails(value: float | None) -> None:
    gate = Gate(value, high=math.inf)
    assert gate.value is None
    assert not gate.passed


def test_passed_cannot_be_filled_in() -> None:
    with pytest.raises(TypeError):
        Gate(1.0, passed=True)  # type: ignore[call-arg]
    with pytest.raises(TypeError):
        dataclasses.replace(Gate(1.0, low=2.0), passed=True)  # type: ignore[call-arg]


def test_the_dict_has_the_keys_of_the_file_in_their_order_and_makes_the_gate_again() -> None:
    for gate in (Gate(4, 5, None, "points"), Gate(None, 0.4, 2.5), Gate(0.1 + 0.2, None, 0.3, "px")):
        found = plain({"g": gate})["g"]
        assert list(found) == ["value", "passed", "low", "high", "meaning"]
        assert found["passed"] is gate.passed
        assert Gate.from_dict(json.loads(json.dumps(found))) == gate
    why = Gate(None, high=2.0, meaning="px", unknown="there is no tie point")
    assert list(why.to_dict()) == ["value", "passed", "low", "high", "meaning", "unknown"]
    assert Gate.from_dict(json.loads(json.dumps(plain(why)))) == why


@pytest.mark.parametrize("change", [{"passed": True}, {"value": 6.0}, {"low": 3.0}, {"passed": None}])
def test_a_dict_that_contradicts_itself_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(InputError, match="passed"):
        Gate.from_dict({**Gate(4.0, 5.0).to_dict(), **change})


def test_the_verdict_names_every_gate_that_failed_in_order() -> None:
    good, few, far = Gate(1.0), Gate(3.0, low=5, meaning="points"), Gate(2.0, high=1, meaning="px")
    assert verdict({}) == verdict({"a": good}) == ("ok", "")
    assert verdict({"b": few, "a": good, "c": far}) == (
        "unreliable",
        "b 3 is below 5 (points); c 2 is above 1 (px)",
    )
    assert verdict({"b": few, "a": good}, lambda failed: "/".join(failed)) == ("unreliable", "b")
