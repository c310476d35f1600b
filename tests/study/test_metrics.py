"""Metrics of constructed matches whose values are known by hand, and intervals whose coverage is counted."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError, ParameterError, UnknownNameError
from featreg.geometry import Affine, Translation
from featreg.interfaces import FailedFit
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.study.case import Case
from featreg.study.intervals import Interval, interval
from featreg.study.measures import area_under_curve, repeatable
from featreg.study.metrics import FAMILIES, METRICS, check_metrics, measured, metric_of, of_failure
from featreg.study.truth import read_truth
from featreg.types import Matches

SHIFT = Translation(dx=10.0, dy=0.0)
SHAPE = (100, 200)
#: px of error of eight matches: five within 1.5 px, six within 3, seven within 10.
ERRORS = np.array([0.0, 0.5, 1.0, 1.2, 1.5, 2.5, 6.0, 50.0])


def case(model: Any = SHIFT, status: str = "ok", **changes: Any) -> Case:
    xy = np.stack([np.linspace(5, 180, len(ERRORS)), np.linspace(5, 95, len(ERRORS))], axis=1)
    image = InputImage("a", SHAPE)
    made = Registration(
        Matches(xy, SHIFT(xy) + np.stack([0 * ERRORS, ERRORS], axis=1), np.ones(len(xy))),
        {"gms": np.ones(len(xy), bool), "fsc": ERRORS < 2},
        ERRORS < 2,
        model,
        status,
        "" if status == "ok" else "too few",
        provenance={"blocks": {"total": 6}},
        reference=image,
        secondary=image,
    )
    return replace(Case(made, read_truth(SHIFT), act={"detect": 0.25, "match": 0.5}), **changes)


def test_known_answers_of_constructed_matches() -> None:
    names = ["nm", "ncm", "precision", "rmse", "grid_rmse", "inliers", "time_s", "act.detect", "blocks", "failed"]
    found = measured([*names, "refused", "mma@1", "mma@3", "mma@10", "mma"], case())
    assert [found[name] for name in ("nm", "ncm", "precision", "inliers", "blocks")] == [8, 5, 5 / 8, 5, 6]
    assert found["rmse"] == pytest.approx(math.sqrt((0.25 + 1 + 1.44 + 2.25) / 5))
    assert found["grid_rmse"] == 0.0
    assert (found["time_s"], found["act.detect"], found["failed"], found["refused"]) == (0.75, 0.25, 0, 0)
    assert (found["mma@1"], found["mma@3"], found["mma@10"]) == (3 / 8, 6 / 8, 7 / 8)
    # Within 1, 2, ... 10 px: 3, 5, 6, 6, 6, 7, 7, 7, 7, 7 of 8.
    assert found["mma"] == pytest.approx(61 / 80)


def test_success_and_area_of_models_with_a_known_error() -> None:
    off = case(Translation(dx=12.0, dy=0.0))
    assert measured(["success@1", "success@2", "success@5"], off) == {"success@1": 0, "success@2": 1, "success@5": 1}
    assert measured(["auc@1", "auc@4", "auc@5"], off) == {"auc@1": 0, "auc@4": 0.5, "auc@5": pytest.approx(0.6)}
    assert measured(["wrong@1", "wrong@3"], off) == {"wrong@1": 1, "wrong@3": 0}
    names = ["success@5", "auc@5", "wrong@1"]
    for lost in (case(status="unreliable"), case(FailedFit("no points"), status="unreliable")):
        assert measured(names, lost) == dict.fromkeys(names, 0)
        assert measured(["refused"], lost) == {"refused": 1}
    assert area_under_curve([0.0, 2.5, math.inf, math.nan], 5) == pytest.approx((1 + 0.5) / 4)
    assert area_under_curve([], 5) == 0.0
    with pytest.raises(ParameterError, match="limit"):
        area_under_curve([1.0], 0)


def test_the_area_is_that_under_the_curve() -> None:
    errors = np.random.default_rng(1).gamma(2, 1.5, 40)
    t = np.linspace(0, 5, 200_001)
    curve = np.searchsorted(np.sort(errors), t, side="right") / len(errors)
    assert area_under_curve(errors, 5) == pytest.approx(np.trapezoid(curve, t) / 5, abs=1e-4)


def test_keypoints_that_both_images_show() -> None:
    reference = np.array([[10.0, 10], [20, 20], [30, 30], [195, 50]])
    secondary = np.array([[20.5, 10], [30, 25], [40, 30.2], [41, 30], [2, 50]])
    # (195, 50) leaves the secondary; (2, 50) the reference does not show; of the two near (40, 30) one counts.
    assert repeatable(reference, secondary, SHIFT, (SHAPE, SHAPE)) == (2, 3, 4)
    assert repeatable(reference, secondary, SHIFT, (SHAPE, SHAPE), threshold=6) == (3, 3, 4)
    assert repeatable(np.zeros((0, 2)), secondary, SHIFT, (SHAPE, SHAPE)) == (0, 0, 4)
    flow = np.zeros((*SHAPE, 2))
    flow[..., 0] = 10
    assert repeatable(reference, secondary, flow, (SHAPE, SHAPE)) == (2, 3, 4)
    both = case(keypoints=(reference, secondary))
    found = measured(["repeatability", "recall", "matching_score"], both)
    assert found == {"repeatability": 2 / 3, "recall": 1.0, "matching_score": 1.0}  # NCM 5 is more than there can be
    many = np.random.default_rng(0).uniform((0, 0), (180, 99), (50, 2))
    found = measured(["repeatability", "recall", "matching_score"], case(keypoints=(many, SHIFT(many))))
    assert found == {"repeatability": 1.0, "recall": 5 / 50, "matching_score": 5 / 50}
    assert measured(["recall"], case()) == {"recall": None}


def test_without_truth_only_what_needs_none() -> None:
    found = measured([*METRICS, *(f"{name}@3" for name in FAMILIES)], case(truth=None))
    there = {name for name, value in found.items() if value is not None}
    times = {"time_s", "act", "around_s"}
    assert there == {"nm", "inliers", "blocks", "spread", "failed", "refused", "rotation_deg", *times}
    assert measured(["rotation_deg"], case(Affine(np.eye(3)[:2]), truth=None)) == {"rotation_deg": 0.0}


def test_a_failure_is_counted_and_not_left_out() -> None:
    names = ["ncm", "precision", "rmse", "auc@3", "success@1", "failed", "refused", "recall"]
    assert of_failure(names, truth=True) == dict(zip(names, [0, 0.0, None, 0.0, 0.0, 1, 0, 0.0], strict=True))
    assert of_failure(names, truth=False) == dict(zip(names, [None] * 5 + [1, 0, None], strict=True))


def test_names_of_metrics() -> None:
    assert check_metrics(["ncm", "auc@3", "ncm"]) == ("ncm", "auc@3")
    assert check_metrics("ncm") == ("ncm",)
    for wrong, why in (("ncmm", "did you mean 'ncm'"), ("auk@3", "auc@3"), ("", "known"), ("act.", "unknown")):
        with pytest.raises(UnknownNameError, match=why):
            metric_of(wrong)
    for wrong in ("auc", "auc@", "auc@x", "auc@0", "mma@-1", "success@inf"):
        if wrong not in METRICS:
            with pytest.raises(ParameterError, match="number of pixels"):
                metric_of(wrong)
    with pytest.raises(ParameterError, match="a metric is a name"):
        check_metrics([3])  # type: ignore[list-item]
    with pytest.raises(InputError, match="no stage 'lmeds'"):
        measured(["ncm"], case(stage="lmeds"))


def draw(rng: np.random.Generator, kind: str, shape: tuple[int, ...]) -> Any:
    """Values of mean 0 and variance 1."""
    return rng.normal(size=shape) if kind == "normal" else (rng.gamma(2, 1, shape) - 2) / math.sqrt(2)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["normal", "skewed"])
@pytest.mark.parametrize(("pairs", "seeds", "between"), [(8, 1, 1.0), (10, 5, 1.0), (10, 5, 0.3), (40, 1, 1.0)])
def test_the_interval_holds_the_truth_as_often_as_it_says(kind: str, pairs: int, seeds: int, between: float) -> None:
    """93 to 97 % of simulated comparisons, for few and many pairs, whether pairs or seeds scatter more."""
    rng = np.random.default_rng(3)
    runs, held = 1500, 0
    values = between * draw(rng, kind, (runs, pairs, 1)) + (
        draw(rng, "normal", (runs, pairs, seeds)) if seeds > 1 else 0
    )
    for i, run in enumerate(values.tolist()):
        found = interval(run, resamples=999, seed=i)
        held += found.low is not None and found.high is not None and found.low <= 0 <= found.high
    assert 0.93 <= held / runs <= 0.97


def test_intervals_of_little_data() -> None:
    assert interval([]).mean is None
    one = interval([[2.0]])
    assert (one.mean, one.low, one.high, one.count) == (2.0, None, None, 1)
    assert interval([[1.0], [1.0], [1.0]]).low is None
    seeds = interval([[1.0, 2.0, 3.0, 4.0]])
    assert (seeds.mean, seeds.over, seeds.count) == (2.5, "seeds", 4)
    # Two values: Student's t of one degree of freedom, 12.706 standard errors.
    two = interval([[1.0], [3.0]])
    assert (two.low, two.high) == pytest.approx((2 - 12.7062, 2 + 12.7062), rel=1e-5)
    shares = interval([[1.0]] * 9 + [[0.0]], bounds=(0, 1))
    assert shares.low is not None
    assert 0.6 < shares.low < 0.75
    assert shares.high == 1.0
    assert interval([[math.nan, 1.0], [math.inf], [2.0]]).count == 2
    assert interval([[1.0], [2.0], [4.0], [3.0]]) == interval([[1.0], [2.0], [4.0], [3.0]])
    assert interval([[1.0], [2.0], [1.5], [1.2], [1.7]]).excludes_zero
    with pytest.raises(ParameterError, match="confidence"):
        interval([[1.0]], 95)


def test_an_interval_is_short_but_not_rounded_to_tens() -> None:
    assert str(Interval(1152.67, 538.2, 1555.4, 9)) == "1153 [538, 1555]"
    assert str(Interval(0.82951, 0.1, 2e6, 9, missing=2)) == "0.83 [0.1, 2e+06] without 2"
    assert str(Interval(None, None, None, 0)) == ""
    assert str(Interval(-0.5, None, None, 1)) == "-0.5"


def test_a_mean_says_how_many_pairs_it_leaves_out() -> None:
    from featreg.study.table import Table

    rows = [
        {"pair": pair, "method": method, "status": "ok", "grid_rmse": value, "reason": ""}
        for method, values in (("all", [0.5, 0.7, 0.6]), ("some", [0.1, None, 0.2]))
        for pair, value in zip("abc", values, strict=True)
    ]
    table = Table(rows)
    assert table.intervals()["all"]["grid_rmse"].missing == 0
    assert table.intervals()["some"]["grid_rmse"].missing == 1
    assert "without 1" in str(table)
    assert "flatters" in str(table)
