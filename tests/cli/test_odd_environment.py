"""Names that are no UTF-8, narrow pipes, closed streams, full disks, broken data of PROJ: one line, no loss."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import featreg
from featreg.geometry import Affine
from featreg.io import write_geotiff
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.types import Geolocation, Matches

pytestmark = [
    pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning"),
    pytest.mark.skipif(sys.platform != "linux", reason="file names of bytes, /dev/full and limits are Linux's"),
]

SHAPE = (130, 140)
PLACE = Geolocation((10.0, 0.0, 5e5, 0.0, -10.0, 6e6), "EPSG:32632")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    for name in ("ref", "sec"):
        write_geotiff(tmp_path / f"{name}.tif", rng.random(SHAPE).astype(np.float32), PLACE)
    xy = rng.uniform(5, 120, (40, 2))
    images = {role: InputImage(str(tmp_path / f"{role[:3]}.tif"), SHAPE) for role in ("reference", "secondary")}
    Registration(
        Matches(xy, xy, np.ones(40)), {}, np.ones(40, bool), Affine(np.eye(3)[:2]), "ok",
        provenance={"method": "m", "seed": 0}, **images,  # type: ignore[arg-type]
    ).to_json(tmp_path / "r.json")  # fmt: skip
    return tmp_path


def run(folder: Path, command: str, **environment: str) -> subprocess.CompletedProcess[bytes]:
    """Run `featreg COMMAND` in a shell, with its redirections and limits."""
    line = command.replace("featreg", f"'{sys.executable}' -m featreg")
    variables = {**os.environ, **environment}
    return subprocess.run(["bash", "-c", line], cwd=folder, env=variables, capture_output=True, timeout=120)


def one_line(done: subprocess.CompletedProcess[bytes]) -> str:
    lines = done.stderr.decode(errors="replace").splitlines()
    assert len(lines) == 1, lines
    return lines[0]


def test_a_name_that_is_no_utf8_is_written_and_read_back(tmp_path: Path, sar_texture: object) -> None:
    image = sar_texture(120, 130)  # type: ignore[operator]
    name = os.fsdecode(b"s\xe9c.npy")
    try:
        np.save(tmp_path / "a.npy", image)
        shutil.copy(tmp_path / "a.npy", tmp_path / name)
    except OSError:
        pytest.skip("this file system takes UTF-8 names only")
    result = featreg.match(tmp_path / "a.npy", tmp_path / name)
    result.to_json(tmp_path / "r.json")
    assert b"s\\udce9c.npy" in (tmp_path / "r.json").read_bytes()
    again = Registration.from_json(tmp_path / "r.json")
    assert again.secondary is not None
    assert Path(again.secondary.path).is_file()
    for to, target in (("envi", "p.pts"), ("colmap", "p.db"), ("csv", "p.csv"), ("qgis", "p.points")):
        from featreg.exports.formats import export

        assert export(tmp_path / "r.json", tmp_path / target, to=to) == len(result.matches.take(result.inliers))


def test_gdal_files_of_such_names_are_refused_before_the_work(folder: Path) -> None:
    name = os.fsdecode(b"s\xe9c.tif")
    try:
        shutil.copy(folder / "sec.tif", folder / name)
    except OSError:
        pytest.skip("this file system takes UTF-8 names only")
    done = run(folder, "featreg match ref.tif $'s\\xe9c.tif'")
    assert done.returncode == 2
    assert "is no UTF-8 text, which GDAL needs" in one_line(done)


@pytest.mark.parametrize("encoding", ["cp1252", "latin-1"])
def test_a_narrow_pipe_gets_what_it_can_hold(folder: Path, encoding: str) -> None:
    done = run(folder, "featreg export r.json --to csv -o 表ā.csv", PYTHONIOENCODING=encoding)
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"\\u8868\\u0101.csv, 40 tie points" in done.stdout
    assert (folder / "表ā.csv").is_file()


@pytest.mark.parametrize(
    ("command", "code"),
    [
        ("featreg match nosuch.tif sec.tif 2>&-", 2),
        ("featreg match nosuch.tif sec.tif 2>/dev/full", 2),
        ("featreg match nosuch.tif sec.tif >&-", 2),
        ("featreg export r.json --to csv -o a.csv >&-", 0),
    ],
)
def test_closed_and_full_streams_keep_the_exit_code(folder: Path, command: str, code: int) -> None:
    assert run(folder, command).returncode == code


def test_a_full_standard_output_is_said(folder: Path) -> None:
    done = run(folder, "featreg export r.json --to csv -o a.csv >/dev/full")
    assert done.returncode == 2
    assert one_line(done) == "error: the standard output cannot be written (No space left on device)"
    assert (folder / "a.csv").is_file()


@pytest.mark.parametrize("command", ["warp r.json sec.tif", "export r.json --to gdal"])
def test_a_full_disk_is_one_line_with_its_reason(folder: Path, command: str) -> None:
    done = run(folder, f"ulimit -f 2; featreg {command} -o o.tif")
    assert done.returncode == 2
    assert "o.tif: cannot be written (File too large)" in one_line(done)
    assert not (folder / "o.tif").exists()


def test_broken_data_of_proj_are_named(folder: Path) -> None:
    (folder / "empty").mkdir()
    broken = str(folder / "empty")
    done = run(folder, "featreg match ref.tif sec.tif --block 100", PROJ_DATA=broken, PROJ_LIB=broken)
    assert done.returncode == 2
    assert "error: PROJ cannot use its data" in one_line(done)


def test_too_little_memory_is_one_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    from featreg.cli.main import main

    def fail(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr("featreg.results.registration.Registration.from_json", fail)
    assert main(["export", "r.json", "--to", "csv", "-o", "a.csv"]) == 2
    assert capsys.readouterr().err.startswith("error: there is too little memory for this")
