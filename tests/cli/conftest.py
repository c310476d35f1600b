"""What the tests of several commands share: a pair of images with its result, and running a command in its folder."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from featreg.cli.main import main
from featreg.io import write_geotiff
from featreg.simulate import sar_pair
from featreg.types import Geolocation

SIDE = 256
PLACE = Geolocation((10.0, 0.0, 5e5, 0.0, -10.0, 6e6), "EPSG:32632")
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated pair with its truth, an image of another place, and the result of the pair."""
    home = tmp_path_factory.mktemp("pair")
    pair = sar_pair((SIDE, SIDE), rotation_deg=4.0, scale=1.01, shift=(5.0, -3.0), seed=3)
    write_geotiff(home / "ref.tif", pair.reference, PLACE)
    write_geotiff(home / "sec.tif", pair.secondary)
    write_geotiff(home / "other.tif", sar_pair((SIDE, SIDE), seed=77).reference)
    (home / "truth.json").write_text(json.dumps({"matrix": pair.truth.tolist()}))
    mask = np.full((SIDE, SIDE), 255, np.uint8)
    mask[:, :60] = 0
    write_geotiff(home / "mask.tif", mask)
    assert main(["match", str(home / "ref.tif"), str(home / "sec.tif"), "--json", str(home / "result.json")]) == 0
    return home


@pytest.fixture
def run(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a command in the folder of the pair; return exit code, stdout, stderr."""
    monkeypatch.chdir(folder)
    capsys.readouterr()

    def call(*arguments: str) -> tuple[int, str, str]:
        code = main(arguments)
        out, err = capsys.readouterr()
        return code, out, err

    return call


@pytest.fixture
def refused() -> Callable[..., None]:
    """Check that a command was refused by one line with these words."""

    def check(answer: tuple[int, str, str], *words: str) -> None:
        code, out, err = answer
        assert (code, out) == (2, "")
        assert err.count("\n") == 1
        assert err.startswith("error: ")
        assert "Traceback" not in err
        for word in words:
            assert word in err

    return check
