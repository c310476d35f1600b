"""Marked points: their fit, history, file and tiles."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from featreg.errors import InputError, ParameterError
from featreg.exports.formats import read_tie_points
from featreg.geometry import Translation
from featreg.marking.points import MarkedPoints, left_out_errors
from featreg.marking.tiles import TiledScene
from featreg.study.truth import read_truth
from made.marked_points import PLACES, TRUTH, marked


def predicted(points: MarkedPoints, role: str, xy: list[float]) -> list[float]:
    found = points.predict(role, xy)
    assert found is not None
    return found


def test_a_similarity_predicts_from_two_points_and_an_affine_from_four(tmp_path: Path) -> None:
    points = marked(tmp_path / "p.csv", 1)
    assert points.predict("reference", [50, 40]) is None
    kinds = []
    for count in (2, 3, 4):
        points = marked(tmp_path / f"{count}.csv", count)
        kinds.append(points.state()["model"]["kind"])
        assert np.allclose(predicted(points, "reference", [50, 40]), TRUTH(np.array([[50.0, 40.0]]))[0], atol=5)
    assert kinds == ["similarity", "similarity", "affine"]
    np.testing.assert_allclose(predicted(points, "reference", [50, 40]), TRUTH(np.array([[50.0, 40.0]]))[0], atol=1e-9)
    np.testing.assert_allclose(predicted(points, "secondary", TRUTH(PLACES)[4].tolist()), PLACES[4], atol=1e-9)


def test_a_given_model_predicts_until_points_do(tmp_path: Path) -> None:
    points = marked(tmp_path / "p.csv", initial=Translation(3.0, 4.0))
    assert points.predict("reference", [1, 1]) == [4.0, 5.0]
    assert points.state()["model"] == {"kind": "translation", "given": True}
    points = marked(tmp_path / "q.csv", 4, initial=Translation(3.0, 4.0))
    assert points.state()["model"] == {"kind": "affine", "given": False}


def test_a_wrong_point_stands_out_when_it_is_left_out(tmp_path: Path) -> None:
    points = marked(tmp_path / "p.csv", 5)
    assert max(row["left_out"] for row in points.state()["points"]) < 1e-6
    wrong = TRUTH(PLACES)[4] + (6.0, 8.0)
    points.move(4, "secondary", wrong.tolist())
    rows = points.state()["points"]
    assert rows[4]["left_out"] == pytest.approx(10.0)
    assert rows[4]["residual"] < 9.0


def test_left_out_errors_need_enough_others() -> None:
    four = np.hstack([PLACES[:2], TRUTH(PLACES[:2])])
    assert np.isnan(left_out_errors(four)).all()
    assert left_out_errors(np.zeros((0, 4))).shape == (0,)


def test_every_step_can_be_undone_and_made_again(tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    points = marked(path, 3)
    before = points.points.copy()
    points.delete(1)
    np.testing.assert_array_equal(points.points, before[[0, 2]])
    points.undo()
    np.testing.assert_array_equal(points.points, before)
    points.redo()
    assert len(points.points) == len(read_tie_points(path)) == 2
    points.undo()
    points.add([1, 1], [2, 2])
    assert not points.state()["redo"]
    for _ in range(9):
        points.undo()
    assert len(points.points) == len(read_tie_points(path)) == 0


@pytest.mark.parametrize("suffix", [".csv", ".points", ".pts"])
def test_the_file_is_whole_after_every_step_and_taken_up_again(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"p{suffix}"
    points = marked(path)
    for k, (reference, secondary) in enumerate(zip(PLACES.tolist(), TRUTH(PLACES).tolist(), strict=True), start=1):
        points.add(reference, secondary)
        found = read_tie_points(path)
        np.testing.assert_allclose(found.reference_xy, PLACES[:k], atol=1e-6)
        np.testing.assert_allclose(found.secondary_xy, TRUTH(PLACES[:k]), atol=1e-6)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    np.testing.assert_allclose(marked(path).points, points.points, atol=1e-6)
    np.testing.assert_allclose(read_truth(path)(PLACES), TRUTH(PLACES), atol=1e-5)


def test_what_cannot_be_is_refused_and_changes_nothing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"kept as \.csv, \.points, \.pts"):
        marked(tmp_path / "p.txt")
    with pytest.raises(InputError, match="does not exist"):
        marked(tmp_path / "missing" / "p.csv")
    points = marked(tmp_path / "p.csv", 2)
    for wrong in ([1], "ab", [1, None], [True, 2], [float("nan"), 1], None):
        with pytest.raises(ParameterError, match="a point is two"):
            points.add(wrong, [1, 1])
    with pytest.raises(InputError, match="outside the secondary of 150 x 140"):
        points.add([1, 1], [150, 1])
    for index in (2, -1, True, "0", 0.0):
        with pytest.raises(ParameterError, match="there is no point"):
            points.delete(index)  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match="role must be"):
        points.move(0, "third", [1, 1])
    assert len(points.points) == 2


def test_a_step_that_cannot_be_saved_is_not_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    points = marked(tmp_path / "p.csv", 2)

    def full(source: Any, target: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(InputError, match="No space left"):
        points.add([1, 1], [2, 2])
    assert len(points.points) == len(read_tie_points(tmp_path / "p.csv")) == 2
    assert len(list(tmp_path.iterdir())) == 1


def test_tiles_show_the_scene_where_it_is(tmp_path: Path) -> None:
    """A bright square keeps its place at every level, and all tiles are toned alike."""
    pixels = np.random.default_rng(0).gamma(4, 0.25, (700, 900)).astype(np.float32)
    pixels[512:640, 256:384] = 40
    np.save(tmp_path / "a.npy", pixels)
    scene = TiledScene(str(tmp_path / "a.npy"))

    def shown(level: int, column: int, row: int) -> Any:
        return cv2.imdecode(np.frombuffer(scene.tile(level, column, row), np.uint8), cv2.IMREAD_GRAYSCALE)

    assert shown(0, 1, 2).shape == (256, 256)
    assert shown(0, 1, 2)[4:124, 4:124].min() > 240
    assert shown(0, 1, 2)[140:, 140:].mean() < 200
    assert shown(1, 0, 1)[4:60, 132:188].min() > 240
    assert shown(2, 0, 0)[130:158, 66:94].min() > 230
    for wrong in ((0, 4, 0), (0, 0, -1), (-1, 0, 0), (50, 0, 0)):
        with pytest.raises(ParameterError, match="there is no tile"):
            scene.tile(*wrong)


def test_coarse_tiles_of_a_large_scene_come_from_its_overview(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("featreg.marking.tiles.OVERVIEW", 200)
    pixels = np.random.default_rng(0).gamma(4, 0.25, (700, 900)).astype(np.float32)
    pixels[:350] = 30
    scene = TiledScene(pixels)
    assert scene.factor == 8
    made: Any = cv2.imdecode(np.frombuffer(scene.tile(3, 0, 0), np.uint8), cv2.IMREAD_GRAYSCALE)
    assert made[2:40, 2:110].min() > 240
    assert made[48:85, 2:110].mean() < 200
