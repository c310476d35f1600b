"""What a user installs: the public names, a quick import, one version, and a wheel that holds the whole tree."""

from __future__ import annotations

import email
import importlib.metadata
import importlib.util
import inspect
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import pytest
import yaml

import featreg

ROOT = Path(__file__).parents[1]
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
FOLDERS: dict[str, str] = PROJECT["tool"]["setuptools"]["package-dir"]

PUBLIC = [
    "Descriptor",
    "Detector",
    "Experiment",
    "FailedFit",
    "FeatregError",
    "FeatureMatcher",
    "Features",
    "Filter",
    "FilterContext",
    "FocusResult",
    "GroundGrid",
    "Image",
    "Matcher",
    "Matches",
    "Model",
    "Nearest",
    "Offsets",
    "Part",
    "PhaseHistory",
    "Pipeline",
    "Preset",
    "Product",
    "Reason",
    "Registration",
    "Stack",
    "__version__",
    "as_image",
    "available",
    "back_project",
    "carrier",
    "coherence",
    "compare",
    "create",
    "evaluate",
    "export",
    "extractor",
    "fit",
    "focus",
    "match",
    "offsets",
    "progress_bar",
    "read_phase_history",
    "read_tie_points",
    "register",
    "register_family",
    "register_preset",
    "register_stack",
    "warm_up",
    "warp",
    "warp_file",
]
HEAVY = ("cv2", "matplotlib", "numba", "pandas", "pyarrow", "rasterio", "scipy", "torch")


def test_the_public_names_are_these_and_no_others() -> None:
    assert sorted(vars(featreg)["__all__"]) == PUBLIC


@pytest.mark.parametrize("name", [n for n in PUBLIC if n != "__version__"])
def test_every_public_name_can_be_had_and_is_documented(name: str) -> None:
    value = getattr(featreg, name)
    assert inspect.getdoc(value), f"featreg.{name} has no docstring"
    assert name in dir(featreg)
    assert value.__module__.startswith("featreg.")


@pytest.mark.parametrize("name", PUBLIC)
def test_no_module_is_called_like_a_public_name(name: str) -> None:
    """Importing a submodule binds its name in the package, so `featreg.name` would be the function or the module,
    whichever was asked for first."""
    assert importlib.util.find_spec(f"featreg.{name}") is None, f"rename the module featreg.{name}"


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="No featreg attribute mtach"):
        getattr(featreg, "mtach")  # noqa: B009


def test_import_loads_no_heavy_library() -> None:
    code = f"import sys, featreg; print([m for m in {HEAVY!r} if m in sys.modules])"
    assert run(sys.executable, "-c", code).strip() == "[]"


def test_the_version_stands_in_one_place() -> None:
    assert "version" in PROJECT["project"]["dynamic"]
    assert PROJECT["tool"]["setuptools"]["dynamic"]["version"] == {"attr": "featreg._version.__version__"}
    literal = f'"{featreg.__version__}"'
    places = [p.relative_to(ROOT).as_posix() for p in sources() if literal in p.read_text(encoding="utf-8")]
    assert places == ["featreg/_version.py"]


def test_the_citation_names_the_version_the_licence_and_the_authors() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["cff-version"] == "1.2.0"
    assert citation["version"] == featreg.__version__
    assert citation["license"] == PROJECT["project"]["license"]
    (author,) = citation["authors"]
    assert author["name"] in (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert citation["keywords"] == PROJECT["project"]["keywords"]


def test_the_changelog_knows_the_version() -> None:
    assert featreg.__version__ in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_every_folder_with_modules_is_a_listed_package() -> None:
    listed = set(PROJECT["tool"]["setuptools"]["packages"])
    found = {in_wheel(p.parent).replace("/", ".") for p in sources()}
    assert found == listed


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of a clean copy of what a build needs: a stale build/ beside the sources would leak into it.

    Without translated kernels, which take half a minute: `tests/runtime/test_preparing.py` makes some.
    """
    tree, out = tmp_path_factory.mktemp("tree"), tmp_path_factory.mktemp("dist")
    for name in ("pyproject.toml", "setup.py", "README.md", *PROJECT["project"]["license-files"]):
        shutil.copy(ROOT / name, tree / name)
    for name in {folder.split("/")[0] for folder in FOLDERS.values()} | {"tests", "benchmarks"}:
        shutil.copytree(ROOT / name, tree / name, ignore=shutil.ignore_patterns("__pycache__", "*.bc"))
    # No isolation: the development extras bring setuptools, so that nothing is downloaded here.
    build = ("-m", "build", "--wheel", "--no-isolation", "--outdir", str(out), str(tree))
    run(sys.executable, *build, FEATREG_KERNELS="numba")
    (made,) = out.glob("*.whl")
    return made


@pytest.mark.slow
@pytest.mark.xdist_group("wheel")
def test_the_wheel_holds_the_tree_and_nothing_else(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        held = {name for name in archive.namelist() if ".dist-info/" not in name}
        (metadata,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        said = email.message_from_bytes(archive.read(metadata))
    wanted = {in_wheel(path) for path in files()}
    assert held == wanted
    assert said["Version"] == featreg.__version__
    assert said["License-Expression"] == "MIT"
    text = said.get_payload()
    assert said["Description-Content-Type"] == "text/markdown"
    assert isinstance(text, str)
    assert "Two SAR images go in" in text
    assert re.findall(r"\]\((?!https?:)[^)]*\)", text) == []  # nothing beside it on a page of an index


@pytest.mark.slow
@pytest.mark.xdist_group("wheel")
def test_the_wheel_works_in_an_empty_environment(wheel: Path, tmp_path: Path) -> None:
    """Installed with its dependencies, because only that shows that the declared ones suffice.

    The versions are held to those of this environment, whose wheels pip has just fetched and mostly still has in its
    cache.
    """
    python = tmp_path / "env" / ("Scripts" if os.name == "nt" else "bin") / "python"
    run(sys.executable, "-m", "venv", str(tmp_path / "env"))
    constraints = tmp_path / "constraints.txt"
    constraints.write_text(
        "".join(f"{d.name}=={d.version}\n" for d in importlib.metadata.distributions() if d.name != "featreg")
    )
    pip = (str(python), "-m", "pip", "--disable-pip-version-check", "install", "--quiet", "--no-compile")
    run(*pip, "--constraint", str(constraints), str(wheel))
    code = (
        "import json, featreg; from featreg.registry import broken; "
        "print(json.dumps([featreg.__file__, featreg.__version__, featreg.available('detector'), dict(broken())]))"
    )
    home, version, detectors, broken = json.loads(run(str(python), "-c", code, cwd=tmp_path).splitlines()[-1])
    assert Path(home).is_relative_to(tmp_path)
    assert version == featreg.__version__
    # Without the extra the learned methods are listed with what is missing.
    assert detectors == [name for name in featreg.available("detector") if not name.startswith("kornia-")]
    assert all("kornia" in name and "featreg[torch]" in why for name, why in broken.items()), broken
    listed = run(str(python.with_name("featreg")), "list", cwd=tmp_path)
    assert "sar-ofast" in listed
    assert "sar-orb" in listed


def sources() -> list[Path]:
    """Every module of the package."""
    return [path for path in files() if path.suffix == ".py"]


def files() -> list[Path]:
    """Every file of the package's folders, caches and translated kernels aside."""
    tops = sorted({folder.split("/")[0] for folder in FOLDERS.values()})
    found = [path for top in tops for path in sorted((ROOT / top).rglob("*")) if path.is_file()]
    return [path for path in found if "__pycache__" not in path.parts and path.suffix != ".bc"]


def in_wheel(path: Path) -> str:
    """Where a file or folder of the tree stands in the wheel."""
    inside = path.relative_to(ROOT).as_posix()
    return inside if inside.split("/")[0] == "featreg" else f"featreg/{inside}"


def run(*command: str, cwd: Path | None = None, **variables: str) -> str:
    """Run a command without this checkout on the module path, and return what it prints."""
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")}
    done = subprocess.run(command, cwd=cwd, env=environment | variables, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}\n{done.stderr}"
    return done.stdout
