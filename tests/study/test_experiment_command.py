"""Experiments by the command line: sweeps, their outputs, a run that was killed."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from featreg import Experiment
from featreg.cli.main import main

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    monkeypatch.chdir(folder)

    def run(*arguments: str) -> tuple[int, str, str]:
        capsys.readouterr()
        code = main(arguments)
        return code, *capsys.readouterr()

    return run


def test_a_folder_an_experiment_file_and_objects_are_one(run: Run, folder: Path, tmp_path: Path) -> None:
    save = str(tmp_path / "e.toml")
    base = ("--format", "csv", "--no-isolate", "--no-times")
    code, table, err = run("compare", ".", "--methods", "orb", "--metrics", "ncm,auc@3", "--save", save, *base)
    assert (code, err) == (0, "")
    assert run("compare", "--experiment", save, *base)[1] == table
    assert Experiment.from_file(save).run(isolate=False).table().to_csv() == table
    assert "recall" in run("compare", "--experiment", save, "--metrics", "+recall", *base)[1].splitlines()[0]


def test_outputs(run: Run, tmp_path: Path) -> None:
    for suffix in (".md", ".csv", ".tex", ".json", ".parquet"):
        out = tmp_path / f"t{suffix}"
        code, _, err = run("compare", ".", "--methods", "orb", "--no-isolate", "--no-times", "-o", str(out))
        assert (code, err) == (0, "")
        assert out.stat().st_size > 100


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["compare"], ["missing option '--methods'"]),
        (["compare", "--methods", "orb"], ["images come in pairs", "got 0"]),
        (["compare", ".", "port_1.tif", "--methods", "orb"], ["'.' is a directory"]),
        (["compare", ".", "--methods", "orb", "--metrics", "ncm,auk@3"], ["'auk@3'", "auc@3"]),
        (["compare", ".", "--methods", "orb", "--layout", "table5"], ["'table5'", "table"]),
        (["compare", ".", "--methods", "orb", "--time-limit", "0"], ["seconds > 0"]),
        (["compare", ".", "--methods", "orb", "--threshold", "-1"], ["threshold", "-1"]),
        (["compare", ".", "--methods", "orb", "-o", "t.doc"], ["--out", ".parquet"]),
        (["compare", ".", "--methods", "orb", "--report", "t.pdf"], ["--report", ".html"]),
        (["compare", ".", "--methods", "all", "--set", "no.such=1"], ["no method takes these parameters"]),
        (["compare", "--experiment", "no.yaml"], ["no.yaml", "cannot be read"]),
        (["compare", ".", "--experiment", "no.yaml"], ["images", "--experiment"]),
        (["compare", "--experiment", "no.yaml", "--seed", "3"], ["--seed", "write it into the file"]),
    ],
    ids=lambda value: " ".join(value)[:40] if isinstance(value, list) else None,
)
def test_misuse_is_one_line(arguments: list[str], words: list[str], run: Run) -> None:
    code, out, err = run(*arguments)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    for word in words:
        assert word in err


@pytest.mark.slow
def test_killed_and_resumed_it_ends_identical(folder: Path, tmp_path: Path) -> None:
    """SIGKILL at several moments; the table, times included where they had been kept, is that of the kept results."""
    command = [sys.executable, "-m", "featreg", "compare", str(folder), "--methods", "orb,sar-orb"]
    command += ["--no-times", "--format", "csv", "--metrics", "+recall,auc@3"]
    whole = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    kept = tmp_path / "kept"
    for least in (1, 3):
        running = subprocess.Popen([*command, "--resume", str(kept)], stdout=subprocess.DEVNULL)
        deadline = time.monotonic() + 120
        while len(list(kept.glob("*.json"))) < least and running.poll() is None and time.monotonic() < deadline:
            time.sleep(0.01)
        running.send_signal(signal.SIGKILL)
        running.wait()
        assert len(list(kept.glob("*.json"))) >= least
    # A file that was cut off is computed afresh.
    cut = next(iter(kept.glob("*.json")))
    cut.write_bytes(cut.read_bytes()[:500])
    for _ in range(2):
        done = subprocess.run([*command, "--resume", str(kept)], capture_output=True, text=True, check=True)
        assert done.stdout == whole
    assert not list(kept.glob(".*"))
