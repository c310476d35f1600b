"""Points and parameters that determine no model, with the reason."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from featreg.errors import InputError
from featreg.geometry import (
    Affine,
    Homography,
    Polynomial2,
    Polynomial3,
    Rigid,
    Similarity,
    Translation,
)
from featreg.interfaces import FailedFit, Model
from featreg.types import FloatArray
from made.models import scattered


def why(result: Model | FailedFit) -> str:
    assert isinstance(result, FailedFit)
    assert not result
    return result.reason


@pytest.mark.parametrize(
    "make",
    [
        lambda: Translation(math.nan, 0),
        lambda: Rigid(math.inf),
        lambda: Similarity(1.0, 0.0),
        lambda: Affine(np.eye(3)),
        lambda: Polynomial2(np.zeros((2, 10))),
        lambda: Polynomial3(np.zeros((2, 10)), (0.0, 0.0), -1.0),
    ],
)
def test_impossible_parameters_are_refused(make: Callable[[], Model]) -> None:
    with pytest.raises(InputError):
        make()


def _line(count: int) -> FloatArray:
    t = np.linspace(0, 1000, count)
    return np.column_stack([100 + 0.3 * t, 7 + 0.8 * t])


def _circle(count: int) -> FloatArray:
    a = np.linspace(0, 6, count)
    return 500 + 300 * np.column_stack([np.cos(a), np.sin(a)])


def test_degenerate_points_fail_with_a_reason(cls: type[Model]) -> None:
    xy = scattered(40)
    need = cls.minimum
    assert "too few" in why(cls.from_estimate(np.zeros((0, 2)), np.zeros((0, 2))))
    few = f"got {need - 1}" if need > 1 else "none given"
    assert f"{need} needed, {few}" in why(cls.from_estimate(xy[: need - 1], xy[: need - 1]))
    holed = xy.copy()
    holed[3, 1] = np.nan
    assert "1 of 40" in why(cls.from_estimate(holed, xy))
    assert "1 of 40" in why(cls.from_estimate(xy, holed))
    assert "finite" in why(cls.from_estimate(xy, xy, np.full(40, np.inf)))
    assert "negative" in why(cls.from_estimate(xy, xy, np.full(40, -1.0)))
    assert "none of 40 of positive weight" in why(cls.from_estimate(xy, xy, np.zeros(40)))
    with pytest.raises(InputError, match="shape"):
        cls.from_estimate(xy, xy[:3])
    with pytest.raises(InputError, match="weights"):
        cls.from_estimate(xy, xy, np.ones(3))
    if cls is not Translation:
        assert "coincide" in why(cls.from_estimate(np.full((40, 2), 29_999.5), xy))
        assert "coincide" in why(cls.from_estimate(xy, np.full((40, 2), 29_999.5)))


@pytest.mark.parametrize("cls", [Affine, Homography, Polynomial2, Polynomial3])
def test_points_on_a_line_fail(cls: type[Model]) -> None:
    assert why(cls.from_estimate(_line(40), _line(40)))
    assert why(cls.from_estimate(_line(40) + 29_000, _line(40)))
    assert why(cls.from_estimate(scattered(40), _line(40)))


def test_three_of_four_points_on_a_line_fail() -> None:
    xy = np.array([[0, 0], [500, 500], [1000, 1000], [900, 0]], float)
    assert "on a line" in why(Homography.from_estimate(xy, xy))


def test_points_on_a_circle_leave_a_quadratic_open() -> None:
    assert "curve" in why(Polynomial2.from_estimate(_circle(40), _circle(40)))
    assert Affine.from_estimate(_circle(40), _circle(40))


def test_rotation_that_no_point_decides() -> None:
    square = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]], float)
    mirrored = square * (1, -1)
    assert "no rotation" in why(Rigid.from_estimate(square, mirrored))
    assert "no rotation" in why(Similarity.from_estimate(square, mirrored))


def test_a_crossing_horizon_fails() -> None:
    xy = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    assert why(Homography.from_estimate(xy, xy[[0, 2, 1, 3]]))
