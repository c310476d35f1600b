"""The files of translated kernels: written from the list, without anything else of the package."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from featreg.runtime import precompiled
from featreg.runtime.machine import Machine
from featreg.runtime.preparing import LIST

PACKAGE = Path(precompiled.__file__).parents[1]
MODULE = "featreg.sar.keypoints.motion_kernels"

pytest.importorskip("numba")


def test_the_list_names_kernels_that_exist() -> None:
    listed = json.loads(LIST.read_text(encoding="utf-8"))
    assert MODULE in listed
    for module, kernels in listed.items():
        source = (PACKAGE.parent / Path(*module.split("."))).with_suffix(".py").read_text(encoding="utf-8")
        for name, keys in kernels.items():
            assert f"def {name}(" in source, f"{module}.{name}: make kernels"
            assert all(keys), name


def test_listed_kernels_are_translated_in_a_copy_of_the_package(tmp_path: Path) -> None:
    shutil.copytree(PACKAGE, tmp_path / "featreg", ignore=shutil.ignore_patterns("__pycache__", "*.bc"))
    (tmp_path / "featreg" / "__init__.py").write_text("raise RuntimeError('not to be run')\n")
    listed = json.loads(LIST.read_text(encoding="utf-8"))
    good = listed[MODULE]["matches_of_turns"]
    some = {MODULE: {"matches_of_turns": [["int"] * len(good[0]), *good], "gone": [["int"]]}}
    (tmp_path / "featreg" / "runtime" / LIST.name).write_text(json.dumps(some))
    script = tmp_path / "featreg" / "runtime" / "preparing.py"
    # What a developer asks of numba is not for what is handed out.
    (tmp_path / ".numba_config.yaml").write_text("boundscheck: 1\ndisable_jit: 1\n")
    done = subprocess.run(
        [sys.executable, str(script), ".", "1"], capture_output=True, text=True, check=True, cwd=tmp_path,
        env={**os.environ, "NUMBA_DISABLE_JIT": "1", "NUMBA_BOUNDSCHECK": "1", "NUMBA_DEBUGINFO": "1"},
    )  # fmt: skip
    assert f"{MODULE}.gone: there is no such kernel any more\n" in done.stdout
    # What numba cannot make of numbers where arrays belong stops nothing else.
    assert f"{MODULE}.matches_of_turns(int, " in done.stdout
    (made,) = tmp_path.rglob("*.bc")
    header, _, body = made.read_bytes().partition(b"\n")
    (entry,) = json.loads(header)["kernels"]
    assert (entry["kernel"], entry["key"]) == ("matches_of_turns", good[0])
    start, size = entry["at"]
    machine = Machine()
    key = tuple(entry["key"])
    told = entry["symbol"], body[start : start + size], key, entry["result"], tuple(entry["outputs"])
    assert machine.addresses(*told)
    # Machine code of this processor lies beside it, in which nothing is wrong.
    assert json.loads(header)["machine"] == machine.identity
    start, size = entry["made"]
    assert Machine().addresses(entry["symbol"], b"", *told[2:], body[start : start + size])
