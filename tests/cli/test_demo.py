"""The demonstration, and the compiling that it announces."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from featreg.cli.demo import METHODS, demonstrate
from featreg.cli.main import main
from featreg.errors import InputError
from featreg.results.registration import Registration
from featreg.warming import DEFAULT, kernels_cached, ready, warm_up

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
FILES = {
    "reference.tif", "reference.png", "secondary.tif", "secondary.png", "truth.json", "result.json",
    "registration.png", "comparison.md",
}  # fmt: skip


def test_demonstration_writes_what_it_says_and_is_right(tmp_path: Path) -> None:
    steps: list[str] = []
    made = demonstrate(tmp_path / "out", shape=(256, 256), progress=steps.append)
    assert {path.name for path, _ in made.files} == FILES == {path.name for path in (tmp_path / "out").iterdir()}
    assert len(steps) == 3
    assert [row["method"] for row in made.table.rows] == list(METHODS)
    best = made.table.rows[0]
    assert best["status"] == "ok"
    assert best["grid_rmse"] < 0.5
    assert Registration.from_json(tmp_path / "out" / "result.json").status == "ok"


def test_the_folder_must_be_one(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot make the folder"):
        demonstrate(tmp_path / "file")


@pytest.mark.slow
def test_demo_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    warm_up()
    monkeypatch.chdir(tmp_path)
    assert main(["demo"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert all(f"featreg-demo/{name}" in out for name in FILES)
    assert "| reference / secondary | sar-orb | ok |" in out
    for line in out.splitlines()[-2:]:
        assert main([word.replace("mine.png", str(tmp_path / "mine.png")) for word in line.split()[1:]]) == 0
    assert (tmp_path / "mine.png").exists()


def test_warming_up_leaves_the_kernels_on_disk() -> None:
    warm_up()
    assert ready(), kernels_cached()
    assert set(DEFAULT) <= set(kernels_cached())


def test_kernels_that_are_not_on_disk_are_noticed(tmp_path: Path) -> None:
    code = "from featreg.warming import kernels_cached\nprint(any(kernels_cached().values()))"
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "FEATREG_KERNELS": "numba"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout == "False\n"


def test_every_compiled_function_is_in_a_module_of_kernels() -> None:
    import featreg

    root = Path(featreg.__file__).parent
    taken = re.compile(r"jit import .*(compact|compiled|disjoint|inlined)")
    using = {path for path in root.rglob("*.py") if taken.search(path.read_text())}
    assert using
    assert all(path.stem.endswith("_kernels") for path in using)
