"""Where compiled code is kept, and what happens where it cannot be."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from featreg.runtime import jit
from featreg.warming import _folders

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def unwritable(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the package in which no folder of compiled code can be made; permissions do not bind the superuser."""
    root = tmp_path_factory.mktemp("copy")
    for name in ("", "detectors", "descriptors", "matchers"):
        source = ROOT / (name or "featreg")
        shutil.copytree(
            source, root / "featreg" / name, ignore=shutil.ignore_patterns("__pycache__", "*.bc"), dirs_exist_ok=True
        )
    for folder in {path.parent for path in root.rglob("*.py")}:
        (folder / "__pycache__").touch()
    return root


def run(root: Path, *arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run with the copy, for a user whose home and caches would lie below a file."""
    nowhere = str(root / "featreg" / "__init__.py" / "below")
    kept = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    places = {"HOME": nowhere, "XDG_CACHE_HOME": nowhere, "PYTHONPATH": str(root), "PYTHONDONTWRITEBYTECODE": "1"}
    env = kept | places | variables
    return subprocess.run([sys.executable, *arguments], env=env, cwd=root, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("named", [False, True])
def test_without_a_folder_everything_works_and_says_so_once(unwritable: Path, named: bool) -> None:
    variables = {"NUMBA_CACHE_DIR": str(unwritable / "featreg" / "__init__.py" / "below")} if named else {}
    done = run(unwritable, "-m", "featreg", "doctor", **variables)
    assert done.returncode == 0, done.stderr
    assert "kept in no folder" in " ".join(done.stdout.split())
    said = [line for line in done.stderr.splitlines() if line.startswith("warning: ")]
    assert len(said) == 1
    assert "every start compiles anew" in said[0]
    assert "NUMBA_CACHE_DIR" in said[0]


def test_without_a_folder_kernels_still_compute(unwritable: Path) -> None:
    code = "from featreg.runtime.jit import compiled\n"
    code += "from featreg.warming import cache_folders, ready\n"
    code += "@compiled\ndef twice(x):\n    return 2 * x\n"
    code += "print(twice(21), cache_folders(), ready())"
    (unwritable / "probe.py").write_text(code)
    done = run(unwritable, "probe.py")
    assert done.stdout.split() == ["42", "set()", "False"], done.stderr


def test_a_user_without_home_gets_no_folder_called_tilde(unwritable: Path) -> None:
    """No HOME and no entry among the users: the system cannot say where the home is."""
    code = "import os, pwd\nfor name in ('HOME', 'XDG_CACHE_HOME'):\n    os.environ.pop(name)\n"
    code += "def nobody(uid):\n    raise KeyError(uid)\npwd.getpwuid = nobody\n"
    code += "access = os.access\nos.access = lambda path, *rest: 'runtime' not in str(path) and access(path, *rest)\n"
    code += "from featreg.cli.doctor import examine\nprint(examine()['kernels']['folder'])"
    (unwritable / "homeless.py").write_text(code)
    done = run(unwritable, "homeless.py")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("no folder")
    assert not (unwritable / "~").exists()


def test_compiled_code_is_kept_where_the_user_says(unwritable: Path, tmp_path: Path) -> None:
    done = run(unwritable, "-c", "import featreg.warming as w; print(w.cache_folders())", NUMBA_CACHE_DIR=str(tmp_path))
    assert str(tmp_path) in done.stdout
    assert not done.stderr


def test_what_is_not_prepared_is_sought_once(monkeypatch: pytest.MonkeyPatch) -> None:
    sought: list[object] = []

    def prepared(kernel: object, key: object) -> None:
        sought.append(key)

    monkeypatch.setattr(jit, "prepared", prepared)
    kernel = jit.compiled(_doubled)
    assert [kernel(value) for value in (3.0, 4.0, 5)] == [6.0, 8.0, 10]
    assert sought == [("float",), ("int",)]


def _doubled(value: float) -> float:
    return 2 * value


def test_where_numba_compiles_nothing_it_keeps_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """With NUMBA_DISABLE_JIT what it makes of a kernel is the function itself."""
    module: Any = ModuleType("some_kernels")

    def twice(x: int) -> int:
        return 2 * x

    twice.__module__ = module.__name__
    module.twice = jit.compiled(twice)
    monkeypatch.setattr(jit, "_jit", lambda function, *_: function)
    assert _folders(module) == set()
    assert module.twice(21) == 42


def test_kernels_that_numba_is_kept_from_compiling_are_said(tmp_path: Path) -> None:
    code = "from featreg.runtime.jit import compiled\n@compiled\ndef twice(x):\n    return 2 * x\nprint(twice(21))"
    (tmp_path / "probe.py").write_text(code)
    done = subprocess.run(
        [sys.executable, "probe.py"], cwd=tmp_path, env={**os.environ, "NUMBA_DISABLE_JIT": "1"}, capture_output=True,
        text=True, check=True,
    )  # fmt: skip
    assert done.stdout == "42\n"
    assert done.stderr.count("keeps numba from compiling") == 1
