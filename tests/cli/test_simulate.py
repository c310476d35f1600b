"""`featreg simulate`: files, a truth that `compare` reads, options for another kind refused."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import numpy as np
import pytest

from featreg.cli.main import main
from featreg.io import as_image
from featreg.simulate import sar_pair, sar_series
from featreg.study.truth import read_truth

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
Capture = pytest.CaptureFixture[str]


def run(capsys: Capture, *arguments: str) -> tuple[int, str, str]:
    code = main(["simulate", *arguments])
    return code, *capsys.readouterr()


def test_a_pair(tmp_path: Path, capsys: Capture) -> None:
    options = ["--size", "90x80", "--rotation", "-3", "--zoom", "1", "--shift", "2,-1.5", "--looks", "1", "--seed", "4"]
    code, out, err = run(capsys, "pair", "-o", str(tmp_path / "made"), *options)
    assert (code, err) == (0, "")
    assert f"try next: featreg match {tmp_path}/made/reference.tif" in out
    wanted = sar_pair((80, 90), looks=1, rotation_deg=-3.0, scale=1.0, shift=(2.0, -1.5), seed=4)
    np.testing.assert_array_equal(as_image(tmp_path / "made" / "secondary.tif").pixels, wanted.secondary)
    truth = read_truth(tmp_path / "made" / "truth.json")
    centre = np.array([[44.5, 39.5]])
    np.testing.assert_allclose(truth(centre), centre + np.array([2.0, -1.5]))


def test_a_stack(tmp_path: Path, capsys: Capture) -> None:
    code, out, _ = run(capsys, "stack", "-o", str(tmp_path), "--size", "70", "--count", "3", "--drift", "2")
    assert (code, "date_000.tif to date_002.tif" in out) == (0, True)
    series = sar_series(3, (70, 70), drift=2.0)
    matrices = json.loads((tmp_path / "truth.json").read_text())["matrices"]
    assert list(matrices) == ["date_000.tif", "date_001.tif", "date_002.tif"]
    np.testing.assert_allclose(matrices["date_002.tif"], series.truths[2])
    np.testing.assert_array_equal(as_image(tmp_path / "date_001.tif").pixels, series.images[1])


def test_what_to_type_next_is_quoted(tmp_path: Path, capsys: Capture) -> None:
    folder = tmp_path / "my port"
    _, out, _ = run(capsys, "pair", "-o", str(folder), "--size", "64")
    words = shlex.split(out.splitlines()[-1].removeprefix("try next: "))
    assert words == ["featreg", "match", f"{folder}/reference.tif", f"{folder}/secondary.tif"]


def test_a_scene(tmp_path: Path, capsys: Capture) -> None:
    code, out, _ = run(capsys, "scene", "-o", str(tmp_path), "--size", "256", "--relief", "80")
    assert (code, out.strip().endswith("dem.tif --model rpc-bias")) == (0, True)
    assert {p.name for p in tmp_path.iterdir()} == {"reference.tif", "secondary.tif", "dem.tif", "truth.json"}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["pare", "-o", "x"], ["unknown kind 'pare'", "'pair'"]),
        (["pair"], ["missing option '--output'"]),
        (["pair", "-o", "x", "--relief", "9"], ["--relief is for scene"]),
        (["scene", "-o", "x", "--rotation", "2"], ["--rotation is for pair and stack"]),
        (["pair", "-o", "x", "--size", "big"], ["800x600", "'big'"]),
        (["pair", "-o", "x", "--shift", "3"], ["X,Y", "'3'"]),
        (["pair", "-o", "x", "--size", "20"], ["64 x 64"]),
        (["pair", "-o", "x", "--looks", "0.5"], ["looks", "0.5"]),
        (["pair", "-o", "x", "--looks", "nan"], ["looks", "nan"]),
        (["pair", "-o", "x", "--looks", "-inf"], ["looks", "-inf"]),
        (["stack", "-o", "x", "--count", "1"], ["whole number >= 2"]),
    ],
)
def test_misuse_is_one_line(
    arguments: list[str], words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, err = run(capsys, *arguments)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert all(word in err for word in words)
    assert list(tmp_path.iterdir()) == []
