"""`featreg warp` and what its options refuse, each in one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from featreg.cli.main import main
from featreg.geometry import Affine
from featreg.interfaces import FailedFit, Model
from featreg.io import as_image, write_geotiff
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.types import Geolocation, Matches

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

SIDE = 120
PLACE = Geolocation((10.0, 0.0, 5e5, 0.0, -10.0, 6e6), "EPSG:32632")
MOVE = Affine(np.array([[1.0, 0, 3], [0, 1, -2]]))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    rng = np.random.default_rng(0)
    samples = rng.normal(size=(2, SIDE, SIDE, 2)).astype(np.float32).view(np.complex64)[..., 0]
    for name, image in zip(("ref", "sec"), samples, strict=True):
        write_geotiff(tmp_path / f"{name}.tif", np.abs(image), PLACE)
        write_geotiff(tmp_path / f"{name}_slc.tif", image, PLACE)
    write_geotiff(tmp_path / "small.tif", np.abs(samples[0][:30, :50]))
    result(tmp_path / "r.json")
    result(tmp_path / "slc.json", suffix="_slc")
    result(tmp_path / "bad.json", status="unreliable")
    result(tmp_path / "failed.json", FailedFit("2 points"), "unreliable")
    (tmp_path / "cut.json").write_text((tmp_path / "r.json").read_text()[:300])
    monkeypatch.chdir(tmp_path)
    return tmp_path


def result(path: Path, model: Model | FailedFit = MOVE, status: str = "ok", suffix: str = "") -> None:
    scale = "complex" if suffix else "amplitude"
    reference, secondary = (InputImage(f"{name}{suffix}.tif", (SIDE, SIDE), scale) for name in ("ref", "sec"))
    reason = "" if status == "ok" else "made up"
    Registration(
        Matches.empty(), {}, np.zeros(0, bool), model, status, reason,
        provenance={"method": "m", "seed": 0}, reference=reference, secondary=secondary,
    ).to_json(path)  # fmt: skip


def test_warp_and_coherence_of_a_complex_pair(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["warp", "slc.json", "sec_slc.tif", "-o", "o.tif", "--coherence", "c.tif", "--coherence-window", "7"]
    assert main([*command, "--deramp", "--workers", "1"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "120 x 120 pixels, complex64, georeferenced as the reference" in out
    assert "mean coherence 0.1" in out  # two independent images and 49 looks
    assert as_image("o.tif").is_complex
    found = as_image("c.tif")
    assert found.geolocation is not None
    assert found.geolocation.transform == PLACE.transform


def test_a_result_that_is_not_trusted(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["warp", "bad.json", "sec.tif", "-o", "o.tif"]) == 3
    assert "made up" in capsys.readouterr().err
    assert (folder / "o.tif").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["none.json", "sec.tif", "-o", "o.tif"], ["none.json"]),
        (["cut.json", "sec.tif", "-o", "o.tif"], ["cut.json", "not a whole featreg result"]),
        (["failed.json", "sec.tif", "-o", "o.tif"], ["no model (2 points)"]),
        (["r.json", "none.tif", "-o", "o.tif"], ["none.tif", "no such file"]),
        (["r.json", "small.tif", "-o", "o.tif"], ["50 x 30", "120 x 120", "secondary's scale"]),
        (["r.json", "sec.tif", "-o", "o.tif", "--like", "small.tif"], ["50 x 30", "120 x 120"]),
        (["r.json", "sec.tif", "-o", "none/o.tif"], ["folder 'none' does not exist"]),
        (["r.json", "sec.tif", "-o", "sec.tif"], ["would replace an input"]),
        (["r.json", "sec.tif", "-o", "ref.tif"], ["would replace an input"]),
        (["r.json", "sec.tif", "-o", "r.json"], [".tif"]),
        (["r.json", "sec.tif", "-o", "o.tif", "--band", "2"], ["has one band", "band 2"]),
        (["r.json", "sec.tif", "-o", "o.tif", "--band", "0"], ["has one band", "band 0"]),
        (["r.json", "sec.tif", "-o", "o.tif", "--secondary-scale", "x"], ["SX,SY", "'x'"]),
        (["r.json", "sec.tif", "-o", "o.tif", "--secondary-scale", "-2"], ["> 0"]),
        (["r.json", "sec.tif", "-o", "o.tif", "--resampling", "linear"], ["'bilinear'"]),
        (["r.json", "sec.tif", "-o", "o.tif", "--scale", "dB"], ["'db'"]),
        (["r.json", "sec.tif", "-o", "o.tif", "--deramp"], ["need complex"]),
        (["r.json", "sec.tif", "-o", "o.tif", "--coherence", "c.tif"], ["need complex"]),
        (["slc.json", "sec_slc.tif", "-o", "o.tif", "--coherence", "c.png"], [".tif"]),
        (["slc.json", "sec_slc.tif", "-o", "o.tif", "--coherence", "o.tif"], ["file of its own"]),
        (["slc.json", "sec_slc.tif", "-o", "o.tif", "--coherence", "c.tif", "--coherence-window", "4"], ["odd"]),
        (["r.json", "sec.tif", "-o", "o.tif", "--resample", "cubic"], ["--resampl"]),
    ],
)
def test_what_is_wrong_is_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: list[str]
) -> None:
    before = (folder / "sec.tif").read_bytes()
    assert main(["warp", *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    lines = [line for line in err.splitlines() if not line.startswith("warning: ")]
    assert len(lines) == 1
    for word in words:
        assert word in lines[0]
    assert (folder / "sec.tif").read_bytes() == before
    assert not list(folder.glob(".*"))
    assert not (folder / "o.tif").exists()
