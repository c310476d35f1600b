"""CFAR: thresholds against closed forms, decisions against a direct computation, false-alarm rates by Monte Carlo."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.errors import ParameterError
from featreg.sar.obcls import cfar

METHODS: tuple[cfar.Method, ...] = get_args(cfar.Method)
every = pytest.mark.parametrize("method", METHODS)
SIDES = ("goca", "soca")


def clutter(shape: tuple[int, int], looks: float = 1.0, seed: int = 0) -> NDArray[np.float32]:
    return np.random.default_rng(seed).gamma(looks, 1 / looks, shape).astype(np.float32)


def factor(method: cfar.Method, pfa: float, n: int, looks: float = 1.0, sides: int = 4) -> float:
    return float(cfar.threshold_factors(method, pfa, n, looks, sides=sides)[n - 1])


@pytest.mark.parametrize("n", [1, 16, 800])
def test_the_cell_average_of_one_look_has_the_textbook_factor(n: int) -> None:
    for pfa in (1e-1, 1e-3, 1e-6):
        assert factor("ca", pfa, n) == pytest.approx(n * (pfa ** (-1 / n) - 1), rel=1e-9)


def test_order_statistics_of_one_look_have_the_textbook_false_alarm_rate() -> None:
    n, k, pfa = 24, 18, 1e-3
    a = factor("os", pfa, n)
    i = np.arange(k)
    assert np.prod((n - i) / (n - i + a)) == pytest.approx(pfa, rel=1e-6)


@pytest.mark.parametrize(("method", "tolerance"), [("os", 1e-3), ("tm", 0.02), ("cs", 0.02)])
def test_numeric_factors_meet_the_exact_ones_of_one_look(method: cfar.Method, tolerance: float) -> None:
    """As the number of looks nears one: two ways to the same factor."""
    for n in (8, 40, 200):
        assert factor(method, 1e-2, n, 1 + 1e-9) == pytest.approx(factor(method, 1e-2, n), rel=tolerance)


@pytest.mark.parametrize("method", SIDES)
@pytest.mark.parametrize("looks", [1.0, 3.0])
def test_one_side_alone_is_a_cell_average(method: cfar.Method, looks: float) -> None:
    for n in (2, 30, 200):
        assert factor(method, 1e-3, n, looks, sides=1) == pytest.approx(factor("ca", 1e-3, n, looks), rel=1e-3)


def test_the_greatest_needs_a_lower_factor_than_the_smallest() -> None:
    assert factor("goca", 1e-2, 50) < factor("ca", 1e-2, 50) < factor("soca", 1e-2, 50)


@every
def test_more_looks_and_more_alarms_lower_the_factor(method: cfar.Method) -> None:
    assert factor(method, 1e-2, 60, 4.0) < factor(method, 1e-2, 60, 1.0)
    assert factor(method, 1e-1, 60) < factor(method, 1e-2, 60) < factor(method, 1e-3, 60)


@every
@pytest.mark.parametrize("looks", [1.0, 4.0])
@pytest.mark.parametrize("pfa", [1e-1, 1e-2])
def test_homogeneous_clutter_gives_the_set_false_alarms(method: cfar.Method, looks: float, pfa: float) -> None:
    power = clutter((600, 600), looks)
    found = cfar.detect(power, np.ones(power.shape, np.bool_), method=method, pfa=pfa, guard=2, train=3, looks=looks)
    assert found.mean() == pytest.approx(pfa, rel=0.1)


@pytest.mark.slow
@every
@pytest.mark.parametrize("looks", [1.0, 2.5])
@pytest.mark.parametrize("window", [(2, 3), (8, 8)])
def test_rare_false_alarms_are_as_rare_as_set(method: cfar.Method, looks: float, window: tuple[int, int]) -> None:
    power = clutter((1800, 1800), looks, seed=1)
    found = cfar.detect(
        power, np.ones(power.shape, np.bool_), method=method, pfa=1e-3, guard=window[0], train=window[1], looks=looks
    )
    assert found.mean() == pytest.approx(1e-3, rel=0.1)


@every
def test_false_alarms_are_as_set_at_borders_and_masks(method: cfar.Method) -> None:
    """Only rows within reach of a border, in clutter that ends at a mask of very bright values."""
    total, count = 0, 0
    for seed in range(12):
        power = clutter((14, 1500), seed=seed)
        valid = np.ones(power.shape, np.bool_)
        valid[:, 700:760] = False
        power[~valid] = 1e6
        found = cfar.detect(power, valid, method=method, pfa=3e-2, guard=2, train=4)
        assert not found[~valid].any()
        total, count = total + int(found.sum()), count + int(valid.sum())
    assert total / count == pytest.approx(3e-2, rel=0.1)


def direct(
    power: NDArray[np.float32],
    valid: NDArray[np.bool_],
    method: cfar.Method,
    pfa: float,
    guard: int,
    train: int,
    looks: float,
) -> NDArray[np.bool_]:
    """The definition, cell by cell."""
    height, width = power.shape
    r = guard + train
    whole = (2 * r + 1) ** 2 - (2 * guard + 1) ** 2
    found = np.zeros(power.shape, np.bool_)
    dy, dx = np.mgrid[-r : r + 1, -r : r + 1]
    ring = np.maximum(np.abs(dy), np.abs(dx)) > guard
    turns = [
        (dy < -guard) & (dx <= guard), (dx > guard) & (dy <= guard),
        (dy > guard) & (dx >= -guard), (dx < -guard) & (dy >= -guard),
    ]  # fmt: skip
    for y in range(height):
        for x in range(width):
            rows, cols = y + dy, x + dx
            exists = ring & (rows >= 0) & (rows < height) & (cols >= 0) & (cols < width)
            exists[exists] = valid[rows[exists], cols[exists]]
            if not valid[y, x]:
                continue
            if method in SIDES:
                kept = [exists & t for t in turns]
                kept = [k for k in kept if k.sum() >= whole / 8]
                if not kept:
                    continue
                means = [power[rows[k], cols[k]].mean(dtype=float) for k in kept]
                n = int(sum(k.sum() for k in kept) / len(kept) + 0.5)
                a = cfar.threshold_factors(method, pfa, whole // 4, looks, sides=len(kept))[n - 1]
                found[y, x] = power[y, x] > a * (max(means) if method == "goca" else min(means))
                continue
            cells = np.sort(power[rows[exists], cols[exists]].astype(np.float64))
            n = len(cells)
            if n < max(1, round(cfar.LEAST_SHARE * whole)):
                continue
            low, high = (int(k) for k in cfar.kept_cells(method, np.array(n), 0.25))
            if method == "ca":
                z = cells.mean()
            elif method == "os":
                z = cells[int(cfar.os_rank(np.array(n), 0.75)) - 1]
            else:
                z = cells[low : n - high].mean()
            found[y, x] = power[y, x] > cfar.threshold_factors(method, pfa, whole, looks)[n - 1] * z
    return found


@every
def test_decisions_are_those_of_the_definition(method: cfar.Method) -> None:
    power = clutter((150, 23), 2.0, seed=3)  # more rows than are worked on at once
    power[10:14, 5:9] *= 30
    valid = np.random.default_rng(4).random(power.shape) > 0.2
    valid[60:80, :15] = False
    expected = direct(power, valid, method, 0.05, 1, 3, 2.0)
    found = cfar.detect(power, valid, method=method, pfa=0.05, guard=1, train=3, looks=2.0)
    assert expected.sum() > 20
    np.testing.assert_array_equal(found, expected)


@every
def test_gain_does_not_matter_and_a_target_is_found(method: cfar.Method) -> None:
    power = clutter((60, 60))
    power[28:32, 28:32] = 100
    valid = np.ones(power.shape, np.bool_)
    found = cfar.detect(power, valid, method=method, pfa=1e-3, guard=6, train=4)
    assert found[28:32, 28:32].all()
    np.testing.assert_array_equal(
        found, cfar.detect(power * np.float32(2**10), valid, method=method, pfa=1e-3, guard=6, train=4)
    )


def test_a_cell_without_neighbours_is_not_tested() -> None:
    power = np.ones((40, 40), np.float32)
    power[20, 20] = 1e6
    valid = np.zeros(power.shape, np.bool_)
    valid[20, 20] = True
    for method in METHODS:
        assert not cfar.detect(power, valid, method=method).any()


@pytest.mark.parametrize(
    "wrong", [{"method": "xx"}, {"pfa": 0.0}, {"pfa": 1.0}, {"guard": -1}, {"train": 0}, {"looks": 0.0}, {"trim": 0.5}]
)
def test_impossible_parameters_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ParameterError):
        cfar.detect(np.ones((20, 20), np.float32), np.ones((20, 20), np.bool_), **wrong)  # type: ignore[arg-type]
