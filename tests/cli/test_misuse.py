"""Whatever is wrong with a command or an image is one line, and an exit code."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.cli import match as cli_match
from featreg.io import write_geotiff

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
Run = Callable[..., tuple[int, str, str]]
Refused = Callable[..., None]


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
