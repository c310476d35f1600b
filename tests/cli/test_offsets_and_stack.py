"""`featreg offsets` and `featreg stack`: files, words, exit codes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import rasterio

import featreg
from featreg.cli.main import main
from featreg.displacement.mintpy import dates_of
from featreg.simulate import displaced_pair, sar_series


def test_offsets_writes_the_bands_and_a_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pair = displaced_pair("subsidence", (260, 260), size=3.0, seed=1)
    names = [str(tmp_path / name) for name in ("a.npy", "b.npy")]
    for name, image in zip(names, (pair.reference, pair.secondary), strict=True):
        np.save(name, image)
    made, picture = tmp_path / "offsets.tif", tmp_path / "offsets.png"
    assert main(["offsets", *names, "-o", str(made), "--plot", str(picture), "--workers", "1"]) == 0
    out = capsys.readouterr().out
    assert "16 x 16 cells of 16 px" in out
    assert "standard error" in out
    with rasterio.open(made) as raster:
        assert raster.descriptions[:3] == ("dx", "dy", "cov_xx")
        assert raster.shape == (16, 16)
    assert picture.stat().st_size > 20_000


def test_offsets_for_mintpy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    h5py = pytest.importorskip("h5py")
    pair = displaced_pair("fault", (200, 200), size=4.0, seed=2)
    names = [str(tmp_path / name) for name in ("S1_20210401T052622.npy", "later.npy")]
    for name, image in zip(names, (pair.reference, pair.secondary), strict=True):
        np.save(name, image)
    made = str(tmp_path / "offsets.h5")
    assert main(["offsets", *names, "-o", made, "--workers", "1"]) == 2
    assert "YYYYMMDD,YYYYMMDD" in capsys.readouterr().err
    assert main(["offsets", *names, "-o", made, "--dates", "20210401,20211301", "--workers", "1"]) == 2
    assert "two days" in capsys.readouterr().err
    assert main(["offsets", *names, "-o", f"{made}.tif", "--dates", "20210401,20210413", "--workers", "1"]) == 2
    assert "leave them out" in capsys.readouterr().err
    assert main(["offsets", *names, "-o", made, "--dates", "20210401,20210413", "--workers", "1"]) == 0
    field = featreg.offsets(*names)
    # What mintpy.objects.stack.ifgramStack asks of a file.
    with h5py.File(made) as file:
        assert file["date"][:].tolist() == [[b"20210401", b"20210413"]]
        assert file["bperp"].shape == file["dropIfgram"].shape == (1,)
        assert file["dropIfgram"][0]
        assert file.attrs["FILE_TYPE"] == "ifgramStack"
        rows, cols = field.grid.cells
        assert (file.attrs["LENGTH"], file.attrs["WIDTH"]) == (str(rows), str(cols))
        for name, values in (("rangeOffset", field.dx), ("azimuthOffset", field.dy)):
            assert np.allclose(file[name][0], np.where(field.good, values, np.nan), atol=1e-6, equal_nan=True)
            assert np.array_equal(np.isnan(file[f"{name}Std"][0]), ~field.good)
        written = file["rangeOffset"][0]
    field.to_file(tmp_path / "offsets.tif")
    with rasterio.open(tmp_path / "offsets.tif") as raster:
        assert np.array_equal(raster.read(1), written, equal_nan=True)
    named = str(tmp_path / "S1_20210413T052622.npy")
    np.save(named, pair.secondary)
    assert dates_of(names[0], named) == ("20210401", "20210413")


def test_offsets_that_find_nothing_say_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(0)
    for name in ("a.npy", "b.npy"):
        np.save(tmp_path / name, rng.gamma(1, 1, (160, 160)))
    names = [str(tmp_path / name) for name in ("a.npy", "b.npy")]
    assert main(["offsets", *names, "-o", str(tmp_path / "o.tif"), "--workers", "1"]) == 3
    assert "no peak" in capsys.readouterr().out
    assert main(["offsets", *names, "-o", str(tmp_path / "o.jpg")]) == 2
    assert "must end in .tif" in capsys.readouterr().err


def test_a_stack_and_one_more_date(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    series = sar_series(4, (220, 220), looks=8, seed=5)
    names = [str(tmp_path / f"date_{i}.npy") for i in range(4)]
    for name, image in zip(names, series.images, strict=True):
        np.save(name, image)
    folder = tmp_path / "stack"
    common = ["-o", str(folder), "--workers", "1"]
    assert main(["stack", *names[:3], *common, "--model", "rigid", "--warp"]) == 0
    assert "3 of 3 images" in capsys.readouterr().out
    assert (folder / "stack.png").stat().st_size > 10_000
    assert len(list((folder / "aligned").glob("*.tif"))) == 3
    kept = len(list((folder / "pairs").iterdir()))
    assert main(["stack", names[3], *common, "--add"]) == 0
    assert "4 of 4 images" in capsys.readouterr().out
    # With the two before it, and with the reference.
    assert len(list((folder / "pairs").iterdir())) == kept + 3
    whole = json.loads((folder / "stack.json").read_text())
    assert [model["type"] for model in whole["models"][1:]] == ["rigid"] * 3
    assert (folder / "stack.csv").read_text().count("\n") == 5


def test_errors_of_a_stack(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.save(tmp_path / "a.npy", np.ones((64, 64)))
    image = str(tmp_path / "a.npy")
    assert main(["stack", image, image, "-o", str(tmp_path), "--reference", "b.npy"]) == 2
    assert "none of the images" in capsys.readouterr().err
    assert main(["stack", image, image, "-o", str(tmp_path), "--pairs", "rings"]) == 2
    assert "all, chain or a whole number" in capsys.readouterr().err
    assert main(["stack", image, "-o", str(tmp_path), "--add", "--pairs", "2"]) == 2
    assert "--add keeps the reference" in capsys.readouterr().err
    for option in (["--model", "rigid"], ["--method", "orb"], ["--seed", "3"], ["--set", "threshold=2"]):
        assert main(["stack", image, "-o", str(tmp_path), "--add", *option]) == 2
        assert "--add keeps the options" in capsys.readouterr().err
    assert main(["stack", image, image, "-o", str(tmp_path), "--cube", str(tmp_path / "cube.tif")]) == 2
    assert "must end in .nc" in capsys.readouterr().err
