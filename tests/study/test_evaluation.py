"""Scores with known answers, and every form in which a truth may be given."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError, ParameterError
from featreg.geometry import Affine, Translation
from featreg.interfaces import FailedFit
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.study.evaluation import evaluate, stage_mask
from featreg.study.measures import grid_points, grid_rmse, match_errors, matching_accuracy_curve, score_errors
from featreg.study.truth import Truth, read_truth
from featreg.types import Matches

MATRIX = np.array([[1.02, 0.1, 5.0], [-0.08, 0.97, -3.0]])
TRUTH = Affine(MATRIX)
SHAPE = (200, 300)


def registration(errors: Any, model: Any = TRUTH, **changes: Any) -> Registration:
    """Matches that lie exactly `errors` px from the truth; "gms" drops the last, "fsc" the last two."""
    distance = np.asarray(errors, dtype=np.float64)
    m = len(distance)
    angle = np.arange(m) * 0.7
    xy = np.random.default_rng(5).uniform(20, 180, (m, 2))
    off = np.stack([np.cos(angle), np.sin(angle)], axis=1) * distance[:, None]
    gms, fsc = np.arange(m) < m - 1, np.arange(m) < m - 2
    made = Registration(
        Matches(xy, TRUTH(xy) + off, np.ones(m)),
        {"ratio": np.ones(m, dtype=bool), "gms": gms, "fsc": fsc},
        fsc,
        model,
        "ok",
        timings={"detect": 0.25, "match": 0.5},
        reference=InputImage("a", SHAPE),
    )
    return replace(made, **changes)


def test_scores_of_constructed_matches() -> None:
    shifted = Affine(MATRIX + np.array([[0, 0, 0.3], [0, 0, -0.4]]))
    scores = evaluate(registration([0.3, 0.4, 1.2, 1.4, 3.0, 100.0, 1.0], shifted), MATRIX)
    assert (scores.stage, scores.nm, scores.ncm) == ("gms", 6, 4)
    assert scores.precision == 4 / 6
    assert scores.rmse == pytest.approx(np.sqrt((0.09 + 0.16 + 1.44 + 1.96) / 4), abs=1e-12)
    assert scores.grid_rmse == pytest.approx(0.5, abs=1e-12)
    assert (scores.inliers, scores.time_s, scores.status, scores.model_failed) == (5, 0.75, "ok", False)
    assert scores.as_dict()["ncm"] == 4


@pytest.mark.parametrize(("stage", "nm"), [("putative", 7), ("ratio", 7), ("gms", 6), ("fsc", 5), ("inliers", 5)])
def test_every_stage_can_be_scored(stage: str, nm: int) -> None:
    assert evaluate(registration([0.1] * 7), TRUTH, stage=stage).nm == nm


def test_a_stage_that_is_missing_names_those_there_are() -> None:
    with pytest.raises(InputError, match=r"'lmeds'.*putative, ratio, gms, fsc, inliers"):
        evaluate(registration([0.1] * 5), TRUTH, stage="lmeds")


def test_default_stage_is_the_last_before_the_global_ones() -> None:
    made = registration([0.1] * 6)
    stages = dict(made.stages)
    assert evaluate(replace(made, stages={"ratio": stages["gms"], "ransac": stages["fsc"]}), TRUTH).stage == "ratio"
    assert evaluate(replace(made, stages={"mad": stages["fsc"]}), TRUTH).stage == "putative"


def test_refined_points_are_not_putative() -> None:
    made = registration([0.1] * 6)
    matches = replace(made.matches, origin=np.array([-1, -1, -1, -1, 0, 1]))
    made = replace(made, matches=matches, stages={"refine": matches.origin >= 0})
    assert stage_mask(made).sum() == 4


def test_nothing_found() -> None:
    made = registration([], FailedFit("no points"), status="unreliable", reason="no points", stages={})
    scores = evaluate(made, TRUTH)
    assert (scores.nm, scores.ncm, scores.precision, scores.inliers, scores.spread) == (0, 0, 0.0, 0, 0.0)
    assert np.isnan(scores.rmse)
    assert np.isnan(scores.grid_rmse)
    assert scores.model_failed
    assert scores.status == "unreliable"


def test_the_threshold_itself_is_correct_and_must_be_positive() -> None:
    assert score_errors([1.5, np.nextafter(1.5, 2)]) == (2, 1, 0.5, 1.5)
    assert score_errors([np.nan, np.inf, 1.0])[:2] == (2, 1)
    for wrong in (0.0, -1.0, np.nan):
        with pytest.raises(ParameterError, match="threshold"):
            evaluate(registration([0.1] * 3), TRUTH, threshold=wrong)


def test_image_size_comes_from_the_result_or_the_caller() -> None:
    made = registration([0.1] * 9, Affine(MATRIX * [[1.01], [1.01]]), reference=None)
    assert np.isnan(evaluate(made, TRUTH).grid_rmse)
    assert np.isnan(evaluate(made, TRUTH).spread)
    grid = grid_points(SHAPE)
    assert (len(grid), grid.min(axis=0).tolist()) == (81, [0.05 * 299, 0.05 * 199])
    expected = np.sqrt(np.mean(np.sum((0.01 * TRUTH(grid)) ** 2, axis=1)))
    assert evaluate(made, TRUTH, image_shape=SHAPE).grid_rmse == pytest.approx(expected)


def flow_of(model: Any, shape: tuple[int, int] = SHAPE) -> Any:
    y, x = np.mgrid[: shape[0], : shape[1]]
    grid = np.stack([x.ravel(), y.ravel()], axis=1).astype(np.float64)
    return (model(grid) - grid).reshape(*shape, 2)


def test_flow_of_an_affine_is_the_affine() -> None:
    made = registration([0.3, 0.4, 1.2, 1.4, 3.0, 100.0, 1.0])
    by_flow, by_matrix = evaluate(made, flow_of(TRUTH)), evaluate(made, TRUTH)
    assert (by_flow.nm, by_flow.ncm, by_flow.unscored) == (by_matrix.nm, by_matrix.ncm, 0)
    assert by_flow.rmse == pytest.approx(by_matrix.rmse, abs=1e-9)
    assert by_flow.grid_rmse == pytest.approx(0.0, abs=1e-9)


def test_points_whose_flow_is_not_known_are_not_scored() -> None:
    flow = flow_of(Translation(dx=2.0, dy=-1.0), (20, 30))
    flow[10:, :, 0] = np.nan
    flow[0, 0] = np.inf
    truth = read_truth(flow)
    xy = np.array([(5.5, 4.25), (29, 9), (5, 9.5), (5, 12), (-0.1, 3), (29.1, 3), (0.5, 0.5), (29, 0)])
    with np.errstate(all="raise"):
        mapped = truth(xy)
    np.testing.assert_allclose(mapped[[0, 1, 7]], [(7.5, 3.25), (31, 8), (31, -1)])
    assert np.isnan(mapped[2:7]).all()
    made = Registration(Matches(xy, np.add(xy, (2.0, -1.0)), np.ones(8)), {}, np.ones(8, bool), TRUTH, "ok")
    scores = evaluate(made, flow)
    assert (scores.nm, scores.ncm, scores.unscored, scores.rmse) == (3, 3, 5, 0.0)
    assert np.isfinite(scores.grid_rmse)
    with pytest.raises(InputError, match=r"flow is \(20, 30\).*\(200, 300\)"):
        evaluate(registration([0.1] * 3), flow)
    with pytest.raises(InputError, match="known nowhere"):
        read_truth(np.full((4, 5, 2), np.nan))


def marked(count: int = 100, noise: float = 0.0) -> Any:
    rng = np.random.default_rng(1)
    xy = rng.uniform(0, 1000, (count, 2))
    return np.hstack([xy, TRUTH(xy) + rng.normal(0, noise, (count, 2))])


def check(truth: Truth) -> None:
    xy = np.array([[0.0, 0.0], [100.0, 30.0], [7.5, 900.0]])
    np.testing.assert_allclose(truth(xy), TRUTH(xy), atol=1e-6)


def test_truth_in_every_form(tmp_path: Path) -> None:
    square = np.vstack([MATRIX, [0, 0, 1]])
    np.save(tmp_path / "matrix.npy", MATRIX)
    np.save(tmp_path / "marked.npy", marked())
    np.savetxt(tmp_path / "matrix.txt", square)
    np.savetxt(tmp_path / "plain.csv", marked(), delimiter=",")
    rows = "\n".join(f"{i};{e!r};{d!r};{a!r};{b!r}" for i, (a, b, d, e) in enumerate(marked(5).tolist()))
    (tmp_path / "named.csv").write_text(f"# by hand\nid;secondary_y;secondary_x;reference_x;reference_y\n{rows}\n")
    (tmp_path / "matrix.json").write_text(json.dumps({"matrix": MATRIX.tolist()}))
    made = registration([0.1] * 5)
    made.to_json(tmp_path / "result.json")
    (tmp_path / "model.json").write_text(json.dumps(json.loads((tmp_path / "result.json").read_text())["model"]))
    for truth in (TRUTH, MATRIX, MATRIX.tolist(), square, marked(), made, read_truth(TRUTH), *tmp_path.iterdir()):
        check(read_truth(truth))
    check(read_truth(str(tmp_path / "named.csv")))
    np.save(tmp_path / "flow.npy", flow_of(TRUTH))
    assert read_truth(tmp_path / "flow.npy").shape == SHAPE


def test_points_marked_in_other_programs(tmp_path: Path) -> None:
    inside = marked(40)
    inside = inside[(inside >= 0).all(axis=1)][:5]
    assert len(inside) == 5
    rows = [f"{a + 0.5!r},{-(b + 0.5)!r},{d + 0.5!r},{-(e + 0.5)!r},1" for a, b, d, e in inside.tolist()]
    (tmp_path / "q.points").write_text("\n".join(["mapX,mapY,sourceX,sourceY,enable", *rows]) + "\n")
    rows = [" ".join(repr(value + 1.5) for value in row) for row in inside.tolist()]
    text = "; ENVI Image to Image GCP File\n; base file: a\n; warp file: b\n; Base Image (x,y), Warp Image (x,y)\n;\n"
    (tmp_path / "e.pts").write_text(text + "\n".join(rows) + "\n")
    for name in ("q.points", "e.pts"):
        truth = read_truth(tmp_path / name)
        check(truth)
        assert (truth.kind, truth.marked) == ("marked points", 5)


def test_marked_points_report_how_well_they_agree() -> None:
    truth = read_truth(marked(100, 0.5))
    assert truth.residual_px == pytest.approx(0.5 * np.sqrt(2), rel=0.15)
    assert (truth.kind, truth.marked) == ("marked points", 100)
    assert str(truth).startswith("affine of 100 marked points, RMS 0.")
    assert evaluate(registration([0.1] * 4), marked(100, 0.5)).truth_residual_px == truth.residual_px
    # Four points in exact agreement, and a wrong one that must show.
    wrong = marked(5)
    wrong[0, 2] += 10
    assert read_truth(wrong).residual_px > 1  # type: ignore[operator]


@pytest.mark.parametrize(
    ("name", "content", "why"),
    [
        ("few.csv", "1,2,3,4\n2,3,4,5\n3,3,3,3\n", "at least 4 marked points, got 3"),
        ("line.csv", "".join(f"{i},{i},{i},{2 * i}\n" for i in range(6)), "no affine fits"),
        ("header.csv", "reference_x,reference_y,x,y\n1,2,3,4\n", "secondary_x, secondary_y not found"),
        ("ragged.csv", "1,2,3,4\n1,2,3\n", "row 2 has 3 columns, the first has 4"),
        ("short.csv", "reference_x,reference_y,secondary_x,secondary_y\n1,2,3,4\n1,2\n", "cannot be read"),
        ("words.txt", "1 2 3\n4 five 6\n", "cannot be read"),
        ("empty.txt", "", "is empty"),
        ("singular.txt", "1 2 3\n2 4 6\n", "invertible"),
        ("keys.json", '{"A": 1}', 'hold "matrix", got keys A'),
        ("cut.json", '{"matrix": [[1,', "cannot be read"),
        ("failed.json", '{"schema_version": 1, "model": null, "model_failure": "too few"}', "holds no model.*too few"),
        ("kind.json", '{"type": "banana", "parameters": {}}', "banana"),
        ("cut.npy", "\x93NUMPY", "cannot be read"),
        ("truth.tif", "", "must be a .npy, .json"),
    ],
)
def test_a_truth_that_cannot_be_used_says_why_in_one_line(name: str, content: str, why: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(content, encoding="latin-1")
    with pytest.raises(InputError, match=why) as caught:
        read_truth(tmp_path / name)
    assert "\n" not in str(caught.value)
    assert name in str(caught.value)


@pytest.mark.parametrize(
    "wrong", [None, {"a": 1}, np.zeros((4, 3)), np.zeros((0, 4)), np.zeros((2, 5, 6)), [[1, 2], [3]]]
)
def test_other_objects_are_no_truth(wrong: Any) -> None:
    with pytest.raises(InputError):
        read_truth(wrong)
    with pytest.raises(InputError, match="cannot be read"):
        read_truth("missing.csv")


def test_registration_without_a_model_is_no_truth() -> None:
    with pytest.raises(InputError, match="too few"):
        read_truth(registration([], FailedFit("too few")))


def test_match_errors_and_grid_rmse_of_a_shift() -> None:
    shift = Translation(dx=3.0, dy=4.0)
    np.testing.assert_allclose(match_errors([[1, 1], [5, 5]], [[1, 1], [8, 9]], shift), [5.0, 0.0])
    assert grid_rmse(Translation(dx=0.0, dy=0.0), shift, (50, 60)) == pytest.approx(5.0)


def test_matching_accuracy_curve() -> None:
    curve = matching_accuracy_curve([0.5, 2.0, 9.0, np.nan, 50.0])
    np.testing.assert_array_equal(curve, [0.25, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.75, 0.75])
    np.testing.assert_array_equal(matching_accuracy_curve([], [1, 2]), [0, 0])
