"""What no module of the library does. The direction of imports is held by import-linter (`make lint`)."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("detectors", "descriptors", "matchers")

# The library's third-party imports and the distributions that bring them.
DISTRIBUTIONS = {
    "annotated_types": "annotated-types",
    "cv2": "opencv-contrib-python-headless",
    "yaml": "pyyaml",
    "skimage": "scikit-image",
    "llvmlite": "numba",
}
LATE = {"cv2", "matplotlib", "pandas", "pyarrow", "rasterio", "scipy", "torch", "kornia", "geopandas", "xarray", "tqdm"}


@dataclass(frozen=True)
class Import:
    """One imported module: where, and whether when the importing module is loaded."""

    source: str
    target: str
    line: int
    at_load: bool


@cache
def modules() -> dict[str, Path]:
    """Name -> file of every module of the library."""
    found = {}
    for top in ("featreg", *ROOMS):
        for path in sorted((ROOT / top).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            inside = parts if top == "featreg" else ("featreg", *parts)
            found[".".join(inside[:-1] if inside[-1] == "__init__" else inside)] = path
    return found


@cache
def tree(name: str) -> ast.Module:
    return ast.parse(modules()[name].read_text(encoding="utf-8"))


@cache
def imports(name: str) -> tuple[Import, ...]:
    return tuple(_imports(name, tree(name), at_load=True))


def _imports(name: str, node: ast.AST, *, at_load: bool) -> Iterator[Import]:
    """Every import below a node, those for type checkers only left out."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import):
            yield from (Import(name, alias.name, child.lineno, at_load) for alias in child.names)
        elif isinstance(child, ast.ImportFrom):
            assert child.level == 0, f"{name}:{child.lineno} imports relatively"
            for alias in child.names:
                whole = f"{child.module}.{alias.name}"
                yield Import(name, whole if whole in modules() else str(child.module), child.lineno, at_load)
        elif isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            for other in child.orelse:
                yield from _imports(name, other, at_load=at_load)
        else:
            function = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
            yield from _imports(name, child, at_load=at_load and not function)


LIBRARY = sorted(name for name in modules() if name != "featreg")


@pytest.mark.parametrize("name", sorted(modules()))
def test_the_library_does_not_print_assert_exit_or_unpickle(name: str) -> None:
    command_line = name.startswith("featreg.cli") or name == "featreg.__main__"
    for node in ast.walk(tree(name)):
        if isinstance(node, ast.Assert) and not command_line:
            pytest.fail(f"{name}:{node.lineno} asserts: raise an error of featreg.errors")
        if not isinstance(node, ast.Call):
            continue
        called = ast.unparse(node.func)
        if called in ("print", "exit", "quit", "sys.exit") and not command_line:
            pytest.fail(f"{name}:{node.lineno} calls {called}")
        copied = node.args and ast.unparse(node.args[0]).startswith("pickle.dumps(")
        if re.fullmatch(r"(pickle|cPickle|dill|joblib|shelve)\.\w*(load|loads|open|Unpickler)", called) and not copied:
            pytest.fail(f"{name}:{node.lineno} calls {called}: a file from elsewhere could run code")
        unsafe = [k for k in node.keywords if k.arg == "allow_pickle" and ast.unparse(k.value) != "False"]
        assert not unsafe, f"{name}:{node.lineno} allows pickles"


@pytest.mark.parametrize("name", sorted(modules()))
def test_third_party_libraries_are_declared_and_heavy_ones_imported_late(name: str) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    groups = [project["dependencies"], *(v for k, v in project.get("optional-dependencies", {}).items() if k != "dev")]
    declared = {re.split(r"[^\w-]", text)[0].lower() for group in groups for text in group}
    for found in imports(name):
        top = found.target.split(".")[0]
        if top == "featreg" or top in sys.stdlib_module_names:
            continue
        assert DISTRIBUTIONS.get(top, top).lower() in declared, f"{name}:{found.line}: {top} is not declared"
        asked_for = name == "featreg.xarray"  # who imports this module has xarray and means it
        assert not (found.at_load and top in LATE and not asked_for), (
            f"{name}:{found.line}: import {top} inside the function that needs it"
        )
        if found.at_load and top == "numba":
            allowed = ("featreg.runtime.jit", "featreg.runtime.precompiling")
            assert name in allowed, f"{name}:{found.line}: kernels import featreg.runtime.jit, not numba"


def test_kernels_are_imported_inside_functions() -> None:
    """A module of kernels brings numba (half a second), so loading another module must not load it."""
    early = [
        f"{name}:{found.line} {found.target}"
        for name in LIBRARY
        for found in imports(name)
        if found.at_load and found.target.endswith("_kernels") and not name.endswith("_kernels")
    ]
    assert early == []


def test_every_exception_from_the_type_check_says_why() -> None:
    silent = [
        f"{name}:{number}"
        for name, path in modules().items()
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if re.search(r"# type: ignore(\[[^\]]*\])?\s*$", line)
    ]
    assert silent == []
