"""The command line as a whole: settings, help, version, doctor, and a process of its own."""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from featreg._version import __version__
from featreg.cli import main as cli
from featreg.cli.settings import parse_settings
from featreg.errors import ParameterError

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
Run = Callable[..., tuple[int, str, str]]


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
