"""The command on a scene: in blocks, with a picture, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.results.registration import Registration
from made.scene_results import undisturbed_text


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--whole", "--block", "300"], "--whole"),
        (["--block", "60"], "block must be"),
        (["--block", "many"], "whole number"),
        (["--dem", "nowhere.tif"], "no such file"),
        (["--height", "5", "--dem", "{reference}"], "--dem and --height"),
        (["--block", "300", "--scheduler", "tcp://127.0.0.1:9"], "no dask scheduler answers"),
        (["--scheduler", "tcp://127.0.0.1:9", "--workers", "2"], "leave --workers out"),
        (["--resume", "{reference}"], "is a file"),
        (["--resume", "/nowhere/at/all"], "does not exist"),
        (["--blok", "300"], "--block"),
    ],
)
def test_the_command_refuses_what_cannot_be(
    options: list[str], text: str, located_pair: Any, capsys: pytest.CaptureFixture[str], monkeypatch: Any
) -> None:
    from featreg.cli.main import main

    monkeypatch.setattr("featreg.runtime.cluster.PATIENCE", 1)
    given = [option.format(reference=located_pair.reference) for option in options]
    code = main(["match", str(located_pair.reference), str(located_pair.secondary), *given])
    said = capsys.readouterr()
    assert code == 2
    assert said.out == ""
    assert said.err.startswith("error: ")
    assert said.err.count("\n") == 1
    assert text in said.err


def test_the_command_works_in_blocks(
    located_pair: Any, undisturbed: tuple[Path, Registration], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from featreg.cli.main import main

    images = [str(located_pair.reference), str(located_pair.secondary)]
    options = ["--method", "sar-orb", "--block", "200", "--workers", "1", "--json", str(tmp_path / "r.json")]
    code = main(["match", *images, *options])
    assert code == 0
    assert "blocks      12" in capsys.readouterr().out
    written = json.loads((tmp_path / "r.json").read_text())
    assert written["blocks"]["total"] == 12
    assert undisturbed_text(Registration.from_json(tmp_path / "r.json")) == undisturbed_text(undisturbed[1])


def test_the_picture_of_a_large_scene_is_made_from_overviews(
    located_pair: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import cv2

    from featreg.cli.main import main

    command = ["match", str(located_pair.reference), str(located_pair.secondary), "--block", "200", "--workers", "1"]
    assert main([*command, "--plot", str(tmp_path / "whole.png")]) == 0
    monkeypatch.setattr("featreg.matching.MOST_PIXELS", 100_000)
    monkeypatch.setattr("featreg.cli.block_options.DRAWN", 400)
    for place in ("featreg.io", "featreg.io.images"):
        monkeypatch.setattr(f"{place}.as_image", None)
    assert main([*command, "--plot", str(tmp_path / "reduced.png")]) == 0
    whole, reduced = (cv2.imread(str(tmp_path / name), cv2.IMREAD_GRAYSCALE) for name in ("whole.png", "reduced.png"))
    assert whole is not None
    assert reduced is not None
    # The panels hold the same ground at the same places, and the tie points lie on it.
    size = (400, 400)
    a, b = (cv2.resize(picture, size, interpolation=cv2.INTER_AREA).astype(float) for picture in (whole, reduced))
    assert np.corrcoef(a[40:].ravel(), b[40:].ravel())[0, 1] > 0.9
