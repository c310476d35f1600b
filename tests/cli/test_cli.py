"""The command line: what each command prints and writes, its exit codes, and one line for whatever is wrong."""

from __future__ import annotations

import csv
import gc
import io
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg._version import __version__
from featreg.cli import main as cli
from featreg.cli import match as cli_match
from featreg.cli.options import parse_settings
from featreg.errors import ParameterError
from featreg.io import as_image, write_geotiff
from featreg.types import Geolocation

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
SIDE = 256
PLACE = Geolocation((10.0, 0.0, 5e5, 0.0, -10.0, 6e6), "EPSG:32632")
Run = Callable[..., tuple[int, str, str]]
Refused = Callable[..., None]


# bad input


def _broken_files(home: Path) -> dict[str, str]:
    """Name -> a word of the message, of every bad image that a user may give."""
    import rasterio

    whole = (home / "ref.tif").read_bytes()
    (home / "empty.tif").touch()
    (home / "cut.tif").write_bytes(whole[: len(whole) // 2])
    (home / "text.tif").write_text("range azimuth power\n" * 50)
    write_geotiff(home / "tiny.tif", np.arange(9, dtype=np.float32).reshape(3, 3))
    write_geotiff(home / "flat.tif", np.full((40, 40), 7, np.float32))
    write_geotiff(home / "nan.tif", np.full((256, 256), np.nan, np.float32))
    np.save(home / "long.npy", np.ones((2, 70000), np.float32))
    with rasterio.open(home / "bands.tif", "w", driver="GTiff", height=40, width=40, count=2, dtype="uint8") as file:
        file.write(np.arange(3200, dtype=np.uint8).reshape(2, 40, 40))
    return {
        "missing.tif": "no such file",
        "empty.tif": "empty (0 bytes)",
        "cut.tif": "broken",
        "text.tif": "is not TIFF in spite of its name",
        "tiny.tif": "at least 16 x 16",
        "flat.tif": "same value",
        "nan.tif": "no valid pixel",
        "long.npy": "at least 16 x 16",
        "bands.tif": "2 bands",
        ".": "is a directory",
    }


BAD_IMAGES = ("missing.tif", "empty.tif", "cut.tif", "text.tif", "tiny.tif", "flat.tif", "nan.tif", "long.npy",
              "bands.tif", ".")  # fmt: skip


@pytest.mark.parametrize("name", BAD_IMAGES)
def test_a_bad_image_is_one_line(run: Run, folder: Path, name: str, tmp_path: Path, refused: Refused) -> None:
    word = _broken_files(folder)[name]
    outputs = ["--json", str(tmp_path / "out.json"), "--plot", str(tmp_path / "out.png")]
    refused(run("match", name, "sec.tif", *outputs), name, word)
    refused(run("match", "ref.tif", name, *outputs), name, word)
    if name in ("flat.tif", "nan.tif"):  # what only the samples tell costs a row, not the comparison
        code, out, _ = run("compare", "ref.tif", name, "--methods", "orb", "--no-isolate", "--no-times")
        assert (code, word in out) == (4, True)
    else:
        refused(run("compare", "ref.tif", name, "--methods", "orb", "--resume", str(tmp_path / "kept")), name, word)
    if name not in ("flat.tif", "bands.tif"):  # a mask and several bands may be resampled, if not matched
        refused(run("warp", "result.json", name, "-o", str(tmp_path / "out.tif")), name, word)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="the administrator may read everything")
def test_an_unreadable_image_is_one_line(run: Run, tmp_path: Path, refused: Refused) -> None:
    locked = tmp_path / "locked.tif"
    locked.write_bytes(b"x")
    locked.chmod(0)
    refused(run("match", str(locked), "sec.tif"), "locked.tif", "permission")


MISUSE: dict[str, tuple[list[str], list[str]]] = {
    "command": (["mach"], ["unknown command 'mach'", "'match'"]),
    "option": (["match", "ref.tif", "sec.tif", "--sed", "3"], ["'--sed'", "'--seed'"]),
    "root option": (["--versio"], ["'--versio'", "'--version'"]),
    "no images": (["match"], ["missing argument 'REF'"]),
    "one image": (["match", "ref.tif"], ["missing argument 'SEC'"]),
    "three images": (["match", "ref.tif", "sec.tif", "other.tif"], ["unexpected", "other.tif"]),
    "no value": (["match", "ref.tif", "sec.tif", "--seed"], ["--seed", "argument"]),
    "no number": (["match", "ref.tif", "sec.tif", "--seed", "abc"], ["--seed", "whole number >= 0", "'abc'"]),
    "negative seed": (["match", "ref.tif", "sec.tif", "--seed", "-1"], ["whole number >= 0", "'-1'"]),
    "no worker": (["match", "ref.tif", "sec.tif", "--workers", "0"], ["whole number >= 1", "'0'"]),
    "nodata": (["match", "ref.tif", "sec.tif", "--nodata", "zero"], ["--nodata", "'zero'"]),
    "method": (["match", "ref.tif", "sec.tif", "--method", "sarorb"], ["unknown method 'sarorb'", "'sar-orb'"]),
    "model": (["match", "ref.tif", "sec.tif", "--model", "afine"], ["'afine'", "'affine'"]),
    "scale": (["match", "ref.tif", "sec.tif", "--scale", "decibel"], ["unknown scale 'decibel'", "db"]),
    "parameter": (["match", "ref.tif", "sec.tif", "--set", "fsc.treshold=2"], ["'fsc.treshold'", "'fsc.threshold'"]),
    "ambiguous": (["match", "ref.tif", "sec.tif", "--set", "threshold=2"], ["ambiguous", "'fsc.threshold'"]),
    "own option": (["match", "ref.tif", "sec.tif", "--set", "seed=2"], ["--seed", "option of its own"]),
    "no equals sign": (["match", "ref.tif", "sec.tif", "--set", "levels"], ["KEY=VALUE", "'levels'"]),
    "twice": (["match", "ref.tif", "sec.tif", "--set", "alpha=2", "--set", "alpha=3"], ["alpha", "twice"]),
    "word for number": (["match", "ref.tif", "sec.tif", "--set", "fsc.threshold=wide"], ["a number above 0", "'wide'"]),
    "fraction": (["match", "ref.tif", "sec.tif", "--set", "gms.grid=2.5"], ["a whole number from 3 to 60", "got 2.5"]),
    "bool": (["match", "ref.tif", "sec.tif", "--set", "gms.rotation=maybe"], ["true or false", "'maybe'"]),
    "trust": (["match", "ref.tif", "sec.tif", "--set", "trust.scale=x"], ["a number", "'x'"]),
    "refine": (["match", "ref.tif", "sec.tif", "--set", "half=x"], ["a whole number", "'x'"]),
    "no refine": (["match", "ref.tif", "sec.tif", "--no-refine", "--set", "half=9"], ["nothing without refinement"]),
    "impossible": (["match", "ref.tif", "sec.tif", "--set", "fsc.threshold=-1"], ["threshold", "-1"]),
    "filter": (["match", "ref.tif", "sec.tif", "--set", "filters=gms,fcs"], ["unknown filter 'fcs'", "'fsc'"]),
    "detector": (["match", "ref.tif", "sec.tif", "--set", "detector=fats"], ["unknown detector 'fats'", "'fast'"]),
    "json folder": (["match", "ref.tif", "sec.tif", "--json", "no/out.json"], ["--json", "'no'", "does not exist"]),
    "json is folder": (["match", "ref.tif", "sec.tif", "--json", "."], ["is a directory"]),
    "json over input": (["match", "ref.tif", "sec.tif", "--json", "sec.tif"], ["would replace an input"]),
    "file as folder": (["match", "ref.tif", "sec.tif", "--json", "ref.tif/a.json"], ["is a file"]),
    "stdout": (["match", "ref.tif", "sec.tif", "--plot", "-"], ["--plot", "name of a file"]),
    "plot suffix": (["match", "ref.tif", "sec.tif", "--plot", "out.jpg"], ["--plot", ".png"]),
    "radius alone": (["match", "ref.tif", "sec.tif", "--search-radius", "3"], ["--initial"]),
    "radius": (["match", "ref.tif", "sec.tif", "--initial", "result.json", "--search-radius", "0"], ["> 0", "'0'"]),
    "initial": (["match", "ref.tif", "sec.tif", "--initial", "truth.json"], ["truth.json", "not a"]),
    "mask": (["match", "ref.tif", "sec.tif", "--mask-reference", "none.png"], ["none.png", "no such file"]),
    "odd images": (["compare", "ref.tif", "--methods", "orb"], ["pairs", "'ref.tif' has no partner"]),
    "no methods": (["compare", "ref.tif", "sec.tif"], ["missing option '--methods'"]),
    "empty methods": (["compare", "ref.tif", "sec.tif", "--methods", ","], ["--methods", "sar-orb,orb"]),
    "compared method": (["compare", "ref.tif", "sec.tif", "--methods", "orb,akase"], ["'akase'", "'akaze'"]),
    "compared parameter": (["compare", "ref.tif", "sec.tif", "--methods", "orb", "--set", "levels=2"], ["'levels'"]),
    "format": (["compare", "ref.tif", "sec.tif", "--methods", "orb", "--format", "jsn"], ["'jsn'", "'json'"]),
    "truth": (["compare", "ref.tif", "sec.tif", "--methods", "orb", "--truth", "no.json"], ["no.json"]),
    "truths": (
        ["compare", "ref.tif", "sec.tif", "--methods", "orb", "--truth", "truth.json", "--truth", "truth.json"],
        ["2 for 1"],
    ),
    "resume": (["compare", "ref.tif", "sec.tif", "--methods", "orb", "--resume", "no/dir"], ["--resume", "not exist"]),
    "resume is file": (["compare", "ref.tif", "sec.tif", "--methods", "orb", "--resume", "ref.tif"], ["is a file"]),
    "no output": (["warp", "result.json", "sec.tif"], ["missing option '--output'"]),
    "output suffix": (["warp", "result.json", "sec.tif", "-o", "out.png"], [".tif"]),
    "no result": (["warp", "none.json", "sec.tif", "-o", "out.tif"], ["none.json"]),
    "resampling": (["warp", "result.json", "sec.tif", "-o", "o.tif", "--resampling", "cubi"], ["'cubi'", "'cubic'"]),
    "other secondary": (["warp", "result.json", "small.tif", "-o", "o.tif"], ["small.tif", "40 x 30", "256 x 256"]),
    "other reference": (["warp", "result.json", "sec.tif", "-o", "o.tif", "--like", "small.tif"], ["40 x 30"]),
    "other kind": (["match", "ref.tif", "sec.tif", "--method", "sar-ofast"], ["that is a detector, not a method"]),
    "kind": (["list", "detectors"], ["unknown kind or name 'detectors'", "did you mean 'detector'"]),
    "out": (["demo", "--out", "no/dir"], ["--out", "does not exist"]),
    "out is file": (["demo", "--out", "ref.tif"], ["is a file"]),
}


@pytest.mark.parametrize("case", MISUSE)
def test_misuse_is_one_line(run: Run, folder: Path, case: str, refused: Refused) -> None:
    if not (folder / "small.tif").exists():
        write_geotiff(folder / "small.tif", np.random.default_rng(0).random((30, 40), dtype=np.float32))
    _broken_files(folder)
    before = sorted(folder.iterdir())
    arguments, words = MISUSE[case]
    refused(run(*arguments), *words)
    assert sorted(folder.iterdir()) == before


def test_an_unexpected_error_is_one_line_too(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any) -> str:
        raise RuntimeError("two\nlines")

    monkeypatch.setattr(cli_match, "summary", fail)
    monkeypatch.delenv("FEATREG_TRACEBACK", raising=False)
    code, _, err = run("match", "ref.tif", "sec.tif")
    assert (code, err) == (
        1,
        "error: internal error: RuntimeError: two lines, set FEATREG_TRACEBACK=1 to see where\n",
    )
    monkeypatch.setenv("FEATREG_TRACEBACK", "1")
    code, _, err = run("match", "ref.tif", "sec.tif")
    assert code == 1
    assert "Traceback" in err


def test_interruption_is_one_line(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: Any) -> str:
        raise KeyboardInterrupt

    monkeypatch.setattr(cli_match, "summary", interrupt)
    assert run("match", "ref.tif", "sec.tif") == (130, "", "interrupted\n")


# --set


@pytest.mark.parametrize(
    ("text", "value"),
    [("3", 3), ("-2.5", -2.5), (".5", 0.5), ("1e-3", 1e-3), ("true", True), ("False", False), ("none", None),
     ("null", None), ("inf", float("inf")), ("oast-9-16", "oast-9-16"), ('"3"', "3"), ("[1, 2]", [1, 2]), ("", "")],
)  # fmt: skip
def test_values_of_settings(text: str, value: Any) -> None:
    found = parse_settings([f"detector.key={text}"], ())["detector.key"]
    assert (found, type(found)) == (value, type(value))


def test_filters_are_names_with_commas() -> None:
    assert parse_settings(["filters=gms, fsc"], ()) == {"filters": ["gms", "fsc"]}
    assert parse_settings(["filters="], ()) == {"filters": []}
    assert parse_settings(["a=b=c"], ()) == {"a": "b=c"}
    with pytest.raises(ParameterError, match="option of its own"):
        parse_settings(["n_features=3"], ("n_features",))


# compare


def test_compare_prints_the_table(run: Run) -> None:
    code, out, err = run("compare", "ref.tif", "sec.tif", "--methods", "sar-orb,orb", "--truth", "truth.json")
    assert (code, err) == (0, "")
    rows = [line for line in out.splitlines() if line.startswith("| ref / sec")]
    assert [row.split(" | ")[1:3] for row in rows] == [["sar-orb", "ok"], ["orb", "ok"]]
    assert "truth: matrix" in out


def test_compare_in_other_formats(run: Run, tmp_path: Path) -> None:
    command = ["compare", "ref.tif", "sec.tif", "--methods", "orb", "--no-times", "--resume", str(tmp_path / "kept")]
    made = {layout: run(*command, "--format", layout)[1] for layout in ("csv", "json", "latex")}
    assert [row["method"] for row in csv.DictReader(io.StringIO(made["csv"]))] == ["orb"]
    assert json.loads(made["json"])["rows"][0]["time_s"] is None
    assert r"\begin{tabular}" in made["latex"]
    assert len(list((tmp_path / "kept").iterdir())) == 1


def test_a_failed_row_gives_code_4(run: Run, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import featreg.matching

    def fail(*_: Any, **__: Any) -> Any:
        raise RuntimeError("out of luck")

    monkeypatch.setattr(featreg.matching, "match", fail)
    code, out, err = run("compare", "ref.tif", "sec.tif", "--methods", "orb", "--no-isolate")
    assert (code, err) == (4, "")
    assert "| failed |" in out
    assert "RuntimeError: out of luck" in out


@pytest.mark.slow
def test_workers_give_the_same_table(run: Run) -> None:
    command = ["compare", "ref.tif", "sec.tif", "sec.tif", "ref.tif", "--methods", "orb,sar-orb", "--no-times"]
    alone, shared = run(*command, "--format", "csv"), run(*command, "--format", "csv", "--workers", "2")
    assert alone == shared
    assert alone[0] == 0


# warp


def test_warp_gives_the_reference_grid_and_its_place(run: Run, folder: Path, tmp_path: Path) -> None:
    target = tmp_path / "aligned.tif"
    code, out, err = run("warp", "result.json", "sec.tif", "-o", str(target))
    assert (code, err) == (0, "")
    assert "256 x 256 pixels, float32, georeferenced as the reference" in out
    aligned, reference = as_image(target), as_image(folder / "ref.tif")
    assert aligned.geolocation is not None
    assert reference.geolocation is not None
    assert aligned.geolocation.transform == PLACE.transform
    assert aligned.geolocation.crs == reference.geolocation.crs
    inside = aligned.mask.copy()
    inside[:20] = inside[-20:] = inside[:, :20] = inside[:, -20:] = False
    before = np.corrcoef(as_image(folder / "sec.tif").pixels[inside], reference.pixels[inside])[0, 1]
    assert np.corrcoef(aligned.pixels[inside], reference.pixels[inside])[0, 1] > before + 0.3


def test_warp_with_an_explicit_reference(run: Run, folder: Path, tmp_path: Path) -> None:
    target = tmp_path / "aligned.tif"
    assert run("warp", "result.json", "sec.tif", "-o", str(target), "--like", "other.tif")[0] == 0
    assert as_image(target).geolocation is None
    assert (
        run("warp", "result.json", "sec.tif", "-o", str(target), "--like", "ref.tif", "--resampling", "nearest")[0] == 0
    )
    assert as_image(target).geolocation is not None


def test_warp_with_an_untrusted_result_says_so(run: Run, tmp_path: Path, folder: Path) -> None:
    data = json.loads((folder / "result.json").read_text())
    data |= {"status": "unreliable", "reason": "made up"}
    (tmp_path / "bad.json").write_text(json.dumps(data))
    code, _, err = run("warp", str(tmp_path / "bad.json"), "sec.tif", "-o", str(tmp_path / "aligned.tif"))
    assert code == 3
    assert err.startswith("warning: ")
    assert "made up" in err
    assert (tmp_path / "aligned.tif").exists()


# list, doctor, help


def test_doctor(run: Run) -> None:
    code, out, err = run("doctor")
    assert (code, err) == (0, "")
    for word in ("versions", "numpy", "usable cores", "modules compiled", "cv2", "AKAZE", "extras"):
        assert word in out
    found = json.loads(run("doctor", "--json")[1])
    assert found["versions"]["featreg"] == __version__
    assert all(found["kernels"]["cached"].values()) or found["kernels"]["folder"]


def test_version_and_help(run: Run) -> None:
    assert run("--version") == (0, f"featreg {__version__}\n", "")
    for arguments in ([], ["--help"], ["-h"]):
        code, out, err = run(*arguments)
        assert (code, err) == (0, "")
        assert all(f"\n  {name} " in out for name in cli.COMMANDS)
    for name in cli.COMMANDS:
        code, out, _ = run(name, "--help")
        assert code == 0
        assert out.startswith(f"Usage: featreg {name}")
        assert cli.COMMANDS[name][2] in " ".join(out.split())
    summaries = run("--help")[1].partition("Commands:")[2]
    assert "..." not in summaries, "a summary that does not fit"


# the real thing


def _process(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-W", "always", "-m", "featreg", *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=folder, check=False)


def test_exit_codes_of_the_process(folder: Path, tmp_path: Path) -> None:
    good = _process("match", "ref.tif", "sec.tif", "--workers", "1", "--json", str(tmp_path / "a.json"), folder=folder)
    assert (good.returncode, good.stderr) == (0, "")
    bad = _process("match", "ref.tif", "none.tif", folder=folder)
    assert (bad.returncode, bad.stdout) == (2, "")
    assert bad.stderr == "error: none.tif: no such file; give the path of an existing image file\n"
    misspelt = _process("match", "ref.tif", "sec.tif", "--metod", "orb", folder=folder)
    assert misspelt.returncode == 2
    assert misspelt.stderr.count("\n") == 1
    assert _process("match", "ref.tif", "other.tif", folder=folder).returncode == 3


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys, featreg.cli.main\n"
        "heavy = {'numpy', 'cv2', 'numba', 'scipy', 'rasterio', 'matplotlib', 'pandas'} & set(sys.modules)\n"
        "sys.exit(f'imports {heavy}' if heavy else featreg.cli.main.main(['--help']))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(("asked", "used"), [(None, "1"), ("3", "3")])
def test_linear_algebra_has_one_thread_unless_the_environment_says_otherwise(asked: str | None, used: str) -> None:
    code = (
        "import os, sys\nfrom featreg.cli.main import main\nassert 'numpy' not in sys.modules\n"
        "main(['--version'])\nprint(os.environ['OPENBLAS_NUM_THREADS'])"
    )
    plain = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    given = plain if asked is None else {**plain, "OPENBLAS_NUM_THREADS": asked}
    done = subprocess.run([sys.executable, "-c", code], env=given, capture_output=True, text=True, check=True)
    assert done.stdout.split()[-1] == used


def test_a_program_that_calls_the_command_line_keeps_its_garbage_collection() -> None:
    before = gc.get_threshold(), gc.get_freeze_count()
    assert cli.main(["--version"]) == 0
    assert (gc.get_threshold(), gc.get_freeze_count()) == before
