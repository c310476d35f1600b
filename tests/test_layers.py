"""The direction of dependence, and what no module of the library does."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("detectors", "descriptors", "matchers")
LONGEST = 450

# Layer -> its modules under featreg (a folder stands for all in it), and the layers these may import beside their own.
LAYERS: dict[str, tuple[set[str], set[str]]] = {
    "base": ({"_version", "errors", "array_checks", "derived", "jit", "timing", "provenance"}, set()),
    "types": ({"types"}, {"base"}),
    "sar": ({"sar"}, {"base", "types"}),
    "interfaces": ({"interfaces"}, {"base", "types"}),
    "registry": ({"registry"}, {"base", "types", "interfaces"}),
    "geometry": ({"geometry"}, {"base", "types", "interfaces", "registry"}),
    "robust": ({"robust", "robust_kernels"}, {"base", "types", "interfaces", "registry", "geometry"}),
    "input": (
        {"io", "tie_points", "opencv", "torch_arrays", "kornia"},
        {"base", "types", "sar"},
    ),
    "simulate": (
        {"simulate"},
        {"base", "types", "sar", "geolocation", "input"},
    ),
    "geolocation": ({"geolocation"}, {"base", "types", "interfaces", "registry", "geometry", "robust", "input"}),
    "plugins": (set(ROOMS), {"base", "types", "sar", "interfaces", "registry", "geometry", "robust", "input"}),
    "results": (
        {"result_file", "standard_errors", "truth", "resample", "resample_kernels", "products", "exports"},
        {"base", "types", "sar", "interfaces", "registry", "geometry", "geolocation", "input"},
    ),
    "focusing": (
        {"focusing"},
        {"base", "types", "sar", "interfaces", "registry", "input"},
    ),
    "pipeline": (
        {"feature_matcher", "scale_search", "presets", "refine", "trust", "pipeline", "assembly", "matching",
         "extraction"},
        {"base", "types", "sar", "interfaces", "registry", "geometry", "robust", "input", "simulate", "focusing"},
    ),
    "scene": (
        {"scene"},
        {"base", "types", "sar", "interfaces", "registry", "geometry", "geolocation", "robust", "input", "results",
         "pipeline"},
    ),
    "evaluation": (
        {"evaluation", "comparison", "table", "prediction_cache", "pictures",
         "warming", "experiments", "report", "marking"},
        {"base", "types", "sar", "interfaces", "registry", "geometry", "geolocation", "input", "simulate", "results",
         "focusing", "pipeline", "scene"},
    ),
    "cli": (
        {"cli", "commands", "demo", "doctor", "__main__"},
        {"base", "types", "sar", "interfaces", "registry", "geometry", "geolocation", "input", "simulate", "results",
         "focusing", "pipeline", "scene", "evaluation"},
    ),
}  # fmt: skip

# Imports against the direction, each inside a function, and why.
UPWARD = {
    ("featreg.types", "featreg.opencv"): "Features.to_keypoints: a method of the type, OpenCV known in one place",
    ("featreg.types", "featreg.torch_arrays"): "Features.to_lafs: a method of the type, tensors known in one place",
    ("featreg.types", "featreg.result_file"): "Registration.to_json: a method of the type, the format in its own file",
    ("featreg.types", "featreg.standard_errors"): "Registration.standard_errors: what geometry makes of its tie points",
    ("featreg.interfaces", "featreg.io"): "detect and compute take plain arrays, as OpenCV's do",
    ("featreg.matching", "featreg.scene.run"): "match hands large images over to the block engine",
    ("featreg.registry", "featreg.presets"): "available('method') lists the presets beside the plugins",
}
# The library's third-party imports and the distributions that bring them.
DISTRIBUTIONS = {"cv2": "opencv-contrib-python-headless", "yaml": "pyyaml"}
LATE = {"cv2", "matplotlib", "pandas", "pyarrow", "rasterio", "scipy", "torch", "kornia"}


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


def layer(name: str) -> str:
    top = name.removeprefix("featreg.").split(".")[0]
    found = [key for key, (members, _) in LAYERS.items() if top in members]
    assert len(found) == 1, f"{name} stands in {found or 'no layer'}: put it into one layer of LAYERS"
    return found[0]


LIBRARY = sorted(name for name in modules() if name != "featreg")


@pytest.mark.parametrize("name", LIBRARY)
def test_imports_point_downwards(name: str) -> None:
    here = layer(name)
    allowed = {here, *LAYERS[here][1]}
    for found in imports(name):
        if not found.target.startswith("featreg."):
            continue
        if (name, found.target) in UPWARD:
            assert not found.at_load, f"{name}:{found.line}: {found.target} may be imported inside a function only"
            continue
        there = layer(found.target)
        assert there in allowed, f"{name}:{found.line}: layer '{here}' may not import '{there}' ({found.target})"


def test_every_documented_exception_is_still_needed() -> None:
    made = {(found.source, found.target) for name in LIBRARY for found in imports(name)}
    assert set(UPWARD) <= made


def test_no_module_needs_itself_to_load() -> None:
    graph = {n: {m for f in imports(n) if f.at_load for m in loaded(n, f.target)} for n in LIBRARY}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(f"modules import each other: {' -> '.join(error.args[1])}")


def loaded(source: str, target: str) -> set[str]:
    """A module of the library and the packages around it, which Python loads first; not those that `source` is in."""
    parts = target.split(".")
    chain = {".".join(parts[: end + 1]) for end in range(1, len(parts))}
    return {name for name in chain & set(modules()) if name == target or not f"{source}.".startswith(f"{name}.")}


def is_plugin(name: str) -> bool:
    return name.startswith(tuple(f"featreg.{room}" for room in ROOMS))


@pytest.mark.parametrize("name", [n for n in LIBRARY if is_plugin(n)])
def test_a_plugin_never_imports_another(name: str) -> None:
    others = [f"{f.target} (line {f.line})" for f in imports(name) if is_plugin(f.target)]
    assert others == []


@pytest.mark.parametrize("name", [n for n in LIBRARY if not is_plugin(n)])
def test_the_core_reaches_plugins_through_the_registry(name: str) -> None:
    if name == "featreg.registry":
        return
    rooms = tuple(f"featreg.{room}" for room in ROOMS)
    said = [n for n in ast.walk(tree(name)) if isinstance(n, ast.Constant) and isinstance(n.value, str)]
    found = [f"{f.target} (line {f.line})" for f in imports(name) if is_plugin(f.target)]
    found += [f"{n.value!r} (line {n.lineno})" for n in said if str(n.value).startswith(rooms)]
    assert found == []


@pytest.mark.parametrize("room", ROOMS)
def test_adding_a_plugin_edits_no_list(room: str) -> None:
    body = tree(f"featreg.{room}").body
    assert len(body) == 1, f"{room}/__init__.py holds a docstring and nothing else"
    assert ast.get_docstring(tree(f"featreg.{room}"))


@pytest.mark.parametrize("name", sorted(modules()))
def test_modules_stay_short_enough_to_read(name: str) -> None:
    lines = len(modules()[name].read_text(encoding="utf-8").splitlines())
    assert lines <= LONGEST, f"{name} has {lines} lines, {LONGEST} are allowed: split it"


@pytest.mark.parametrize("name", sorted(modules()))
def test_the_library_does_not_print_assert_exit_or_unpickle(name: str) -> None:
    command_line = name != "featreg" and layer(name) == "cli"
    for node in ast.walk(tree(name)):
        if isinstance(node, ast.Assert) and not command_line:
            pytest.fail(f"{name}:{node.lineno} asserts: raise an error of featreg.errors")
        if not isinstance(node, ast.Call):
            continue
        called = ast.unparse(node.func)
        if called in ("print", "exit", "quit", "sys.exit") and not command_line:
            pytest.fail(f"{name}:{node.lineno} calls {called}")
        if re.fullmatch(r"(pickle|cPickle|dill|joblib|shelve)\.\w*(load|loads|open|Unpickler)", called):
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
        assert not (found.at_load and top in LATE), (
            f"{name}:{found.line}: import {top} inside the function that needs it"
        )
        if found.at_load and top == "numba":
            assert name == "featreg.jit", f"{name}:{found.line}: kernels import featreg.jit, not numba"


def test_kernels_are_imported_inside_functions() -> None:
    """A module of kernels brings numba (half a second), so loading another module must not load it."""
    early = [
        f"{name}:{found.line} {found.target}"
        for name in LIBRARY
        for found in imports(name)
        if found.at_load and found.target.endswith("_kernels") and not name.endswith("_kernels")
    ]
    assert early == []
