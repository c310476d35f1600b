"""Declared parameters: what an annotation allows, how it is said, and that nobody gets past it."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import pytest
from annotated_types import Ge, Gt, Interval, MultipleOf, Predicate

from featreg.errors import ParameterError
from featreg.runtime.parameters import Count, Parameter, Positive, check, checked, declared, described

if TYPE_CHECKING:
    from decimal import Decimal

NAN, INF = math.nan, math.inf


def odd(number: int) -> bool:
    return number % 2 == 1


LEVELS = Annotated[int, Interval(ge=1, le=16)]
FACTOR = Annotated[float, Gt(1)]
EDGE = Literal["log", "eq5"]
CASES: list[tuple[Any, str, list[Any], list[Any]]] = [
    (int, "a whole number", [0, -3, np.int16(2)], [1.0, True, "1", None, np.bool_(True), np.float64(2)]),
    (float, "a number", [0, 1.5, INF, np.float32(2), np.uint8(3)], [True, "1", None, 1j, NAN]),
    (bool, "true or false", [True, np.bool_(False)], [0, 1, "true", None]),
    (str, "a word", ["", "a"], [1, None, b"a"]),
    (LEVELS, "a whole number from 1 to 16", [1, 16, np.int64(8)], [0, 17, 1.5, True, NAN]),
    (FACTOR, "a number above 1", [1.1, 2, INF], [1, 0.5, NAN]),
    (Positive, "a number above 0 and finite", [1e-9, 3], [0, -1, INF, NAN]),
    (Annotated[float, Interval(ge=0, lt=0.25)], "a number of at least 0 and below 0.25", [0, 0.2], [0.25, -1e-9]),
    (Annotated[float, Interval(gt=-INF, lt=INF)], "a number that is finite", [-5, 0.0], [INF, -INF, NAN]),
    (Annotated[int, Ge(256), MultipleOf(256)], "a whole number of at least 256 and a multiple of 256", [512], [0, 300]),
    (Annotated[int, Ge(1), Predicate(odd)], "a whole number of at least 1 and odd", [1, 7], [2, -1]),
    (EDGE, "'log' or 'eq5'", ["log"], ["Log", 1, None, ["log"]]),
    (Literal[1, 2], "1 or 2", [1, np.int64(2)], [True, 3, "1"]),
    (LEVELS | None, "a whole number from 1 to 16, or None", [None, 4], [0, 1.0]),
    (Annotated[float | None, Gt(0)], "a number above 0, or None", [None, 4], [0]),
    (int | str, "anything", [1, "a", None, 2.5], []),
    (Any, "anything", [1, None, []], []),
]


@pytest.mark.parametrize(("annotation", "wanted", "right", "wrong"), CASES, ids=[case[1] for case in CASES])
def test_what_an_annotation_allows(annotation: Any, wanted: str, right: list[Any], wrong: list[Any]) -> None:
    parameter = Parameter.of(annotation)
    assert parameter.wanted == wanted
    for value in right:
        parameter.check("x", value)
    for value in wrong:
        with pytest.raises(ParameterError) as caught:
            check("x", value, annotation)
        given = value.item() if isinstance(value, np.generic) else value
        assert str(caught.value) == f"'x' must be {wanted}, got {given!r}"


def test_without_an_annotation_the_default_has_the_type() -> None:
    def loose(count=3, factor=1.5, on=True, word="a", anything=None):  # type: ignore[no-untyped-def]
        """Nothing is declared."""

    assert [p.kind for p in declared(loose).values()] == [int, float, bool, str, None]


@checked("corners")
@dataclass(frozen=True)
class Corners:
    """Corners.

    Parameters
    ----------
    levels, factor : pyramid levels, and the ratio
        of neighbours: 1 is refused
    edge : "log" or "eq5"

    Notes
    -----
    elsewhere : not a parameter
    """

    levels: LEVELS = 8
    factor: FACTOR = 1.2
    edge: EDGE = "log"
    spare: int | None = None

    def __post_init__(self) -> None:
        if self.levels * self.factor > 30:
            raise ParameterError("together too large")


class Plain:
    """No dataclass."""

    def __init__(self, count: Count = 3, ratio: Decimal | None = None) -> None:
        self.count, self.ratio = count, ratio


@checked("")
def smoothed(image: np.ndarray, *, sigma: Positive = 1.0, **more: Any) -> float:
    return sigma


def test_a_class_tells_its_parameters() -> None:
    found = declared(Corners)
    assert list(found) == ["levels", "factor", "edge", "spare"]
    assert (found["levels"].default, found["levels"].bounds) == (8, {"ge": 1, "le": 16})
    assert found["levels"].meaning == found["factor"].meaning
    assert found["factor"].meaning == "pyramid levels, and the ratio of neighbours: 1 is refused"
    assert (found["edge"].choices, found["edge"].meaning) == (("log", "eq5"), '"log" or "eq5"')
    assert (found["spare"].optional, found["spare"].meaning) == (True, "")


def test_a_name_that_is_there_for_type_checkers_only_leaves_the_others_declared() -> None:
    found = declared(Plain)
    assert (found["count"].bounds, found["ratio"].kind) == ({"ge": 1}, None)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Corners(levels=0), "'corners.levels' must be a whole number from 1 to 16, got 0"),
        (lambda: Corners(17), "'corners.levels' must be a whole number from 1 to 16, got 17"),
        (lambda: replace(Corners(), factor=NAN), "'corners.factor' must be a number above 1, got nan"),
        (lambda: Corners(edge="eq6"), "'corners.edge' must be 'log' or 'eq5', got 'eq6'"),  # type: ignore[arg-type]
        (lambda: Corners(16, 2.0), "together too large"),
        (lambda: checked("plain")(Plain)(count=True), "'plain.count' must be a whole number of at least 1, got True"),
        (lambda: smoothed(np.ones(3), sigma=-1), "'sigma' must be a number above 0 and finite, got -1"),
    ],
)
def test_nobody_gets_past_a_declaration(call: Callable[[], Any], message: str) -> None:
    with pytest.raises(ParameterError) as caught:
        call()
    assert str(caught.value) == message


def test_what_is_checked_stays_what_it_was() -> None:
    made = Corners(levels=np.int64(2), factor=3)  # type: ignore[arg-type]
    assert (made.levels, made.factor) == (2, 3)
    assert pickle.loads(pickle.dumps(made)) == made
    assert smoothed(np.ones(3), sigma=2.0, other="x") == 2.0
    assert smoothed.__name__ == "smoothed"
    with pytest.raises(TypeError, match="unexpected keyword"):
        Corners(level=3)  # type: ignore[call-arg]


def test_meanings_are_read_where_they_stand() -> None:
    assert described("Nothing here.") == {}
    assert described("Short.\n\nParameters\n----------\na : one\nb_2, c : two\n    more") == {
        "a": "one",
        "b_2": "two more",
        "c": "two more",
    }


def test_choices_of_several_types_and_none() -> None:
    mixed = Parameter.of(Literal["auto", 3], "auto")
    assert [mixed.allows(value) for value in ("auto", 3, np.int64(3), 3.0, True, None)] == [True] * 3 + [False] * 3
    optional = Parameter.of(Literal["a", None], "a")
    assert [optional.allows(value) for value in ("a", None, "b")] == [True, True, False]
    assert optional.wanted == "'a', or None"


def test_an_annotation_that_cannot_be_read_allows_everything() -> None:
    class Odd:
        def __init__(self, table: np.no.such.thing | None = None) -> None: ...  # type: ignore[name-defined]

    assert declared(Odd)["table"].allows(object())


def test_what_was_allowed_once_allows_nothing_else() -> None:
    @checked("plain")
    def plain(*, count: Count = 1, size: Positive = 1.0) -> tuple[int, float]:
        return count, size

    for _ in range(2):
        assert plain(count=1, size=2) == (1, 2)
        # Equal to what was allowed, of another kind.
        with pytest.raises(ParameterError, match=r"'plain.count' must be a whole number"):
            plain(count=1.0)  # type: ignore[arg-type]  # on purpose
        with pytest.raises(ParameterError, match=r"'plain.count' must be a whole number"):
            plain(count=True)
        with pytest.raises(ParameterError, match=r"'plain.size' must be a number above 0"):
            plain(size=float("nan"))
        assert plain(size=1) == (1, 1)
