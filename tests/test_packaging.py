"""The recipes of docs/packaging: the versions of pyproject.toml, files that exist, the steps of the Makefile."""

from __future__ import annotations

import importlib.util
import json
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

import featreg

ROOT = Path(__file__).parents[1]
PACKAGING = ROOT / "docs" / "packaging"
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
#: What conda-forge calls a distribution of PyPI.
CONDA = {"opencv-contrib-python-headless": "py-opencv", "matplotlib": "matplotlib-base", "torch": "pytorch",
         "tomli_w": "tomli-w"}  # fmt: skip
#: Extras of distributions that conda-forge does not have, made of others, or for who works on featreg.
NOT_THERE = ("learned", "sicd", "all", "dev", "docs", "oracles")
INSTRUCTIONS = ("ARG", "FROM", "WORKDIR", "COPY", "RUN", "ENV", "USER", "ENTRYPOINT", "CMD")


def ranges(requirements: list[str]) -> dict[str, frozenset[str]]:
    """Name on conda-forge -> its bounds."""
    found = {}
    for text in requirements:
        name, bounds = re.fullmatch(r"([A-Za-z0-9._-]+)\s*(.*)", text).groups()  # type: ignore[union-attr]
        found[CONDA.get(name, name)] = frozenset(part for part in bounds.split(",") if part)
    return found


@pytest.fixture(scope="module")
def recipe() -> dict[str, Any]:
    """The recipe without its templates, as conda-build fills them."""
    text = (PACKAGING / "conda" / "meta.yaml").read_text(encoding="utf-8")
    (version,) = re.findall(r'{% set version = "(.+?)" %}', text)
    text = re.sub(r"{%.*?%}", "", text).replace("{{ version }}", version).replace("{{ PYTHON }}", "python")
    assert "{{" not in text
    loaded: dict[str, Any] = yaml.safe_load(text)
    return loaded


def test_the_recipe_has_the_versions_of_the_project(recipe: dict[str, Any]) -> None:
    python = {"python": frozenset(PROJECT["project"]["requires-python"].split(","))}
    assert ranges(recipe["requirements"]["run"]) == python | ranges(PROJECT["project"]["dependencies"])
    host = ranges(recipe["requirements"]["host"])
    assert host.pop("pip") == frozenset()
    assert host == python | ranges(PROJECT["build-system"]["requires"])
    extras = [
        text
        for name, texts in PROJECT["project"]["optional-dependencies"].items()
        if name not in NOT_THERE
        for text in texts
    ]
    assert ranges(recipe["requirements"]["run_constrained"]) == ranges(extras)


def test_the_recipe_tells_of_this_package(recipe: dict[str, Any]) -> None:
    assert recipe["package"] == {"name": "featreg", "version": featreg.__version__}
    scripts = [f"{name} = {target}" for name, target in PROJECT["project"]["scripts"].items()]
    assert recipe["build"]["entry_points"] == scripts
    assert (PACKAGING / "conda" / recipe["source"]["path"]).resolve() == ROOT
    about = recipe["about"]
    assert (about["license"], about["summary"]) == (PROJECT["project"]["license"], PROJECT["project"]["description"])
    assert (ROOT / about["license_file"]).is_file()
    from featreg.cli.main import COMMANDS

    asked = [command.split()[1] for command in recipe["test"]["commands"]]
    assert all(word in COMMANDS or word == "--version" for word in asked)


@pytest.fixture(scope="module")
def steps() -> list[tuple[str, str]]:
    """(instruction, its argument) of the Dockerfile, lines that go on put together."""
    text = (PACKAGING / "Dockerfile").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    whole = re.sub(r"\\\n\s*", "", "\n".join(lines)).splitlines()
    return [(line.partition(" ")[0], line.partition(" ")[2].strip()) for line in whole]


def test_the_image_is_built_of_what_there_is(steps: list[tuple[str, str]]) -> None:
    assert {name for name, _ in steps} <= set(INSTRUCTIONS)
    python = dict(step.split("=") for name, step in steps if name == "ARG")["PYTHON"]
    low, high = re.findall(r"3\.(\d+)", PROJECT["project"]["requires-python"])
    assert int(low) <= int(python.removeprefix("3.")) < int(high)
    bases = [step for name, step in steps if name == "FROM"]
    assert len(bases) == 2
    assert all(re.fullmatch(r"python:\$\{PYTHON\}-slim-bookworm( AS \w+)?", base) for base in bases)
    copied = [step.split() for name, step in steps if name == "COPY"]
    stages = {base.partition(" AS ")[2] for base in bases} - {""}
    assert [words[0] for words in copied if words[0].startswith("--")] == [f"--from={stage}" for stage in stages]
    sources = [word for words in copied if not words[0].startswith("--") for word in words[:-1]]
    assert all((ROOT / source).exists() for source in sources)
    # Whatever the package is built of is there, and nothing that the context leaves out.
    needed = {folder.split("/")[0] for folder in PROJECT["tool"]["setuptools"]["package-dir"].values()}
    needed |= {"pyproject.toml", "setup.py", "README.md", *PROJECT["project"]["license-files"]}
    assert set(sources) == needed
    ignored = (PACKAGING / "Dockerfile.dockerignore").read_text(encoding="utf-8").splitlines()
    assert {line[1:] for line in ignored if line.startswith("!")} == needed
    assert "*" in ignored


def test_the_image_installs_as_make_does(steps: list[tuple[str, str]]) -> None:
    (first, second) = (step for name, step in steps if name == "RUN")
    make = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert "-m venv $(VENV)" in make
    assert "$(PIP) install --quiet -e ." in make
    commands = [command.strip() for command in first.split("&&")]
    assert commands[0] == "python -m venv /opt/featreg"
    assert re.fullmatch(r'/opt/featreg/bin/python -m pip install .* "\.\[\$\{EXTRAS\}\]"', commands[1])
    assert commands[2] == "/opt/featreg/bin/featreg doctor"
    extras = dict(step.split("=") for name, step in steps if name == "ARG")["EXTRAS"].split(",")
    assert set(extras) <= set(PROJECT["project"]["optional-dependencies"])
    # It runs as nobody in particular.
    names = [name for name, _ in steps]
    assert second.startswith("useradd ")
    assert names.index("USER") > names.index("COPY")
    assert dict(steps)["USER"] not in ("root", "0")
    assert json.loads(dict(steps)["ENTRYPOINT"]) == ["featreg"]
    assert json.loads(dict(steps)["CMD"]) == ["--help"]


def test_a_build_takes_no_translated_kernels_from_beside_the_sources(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    distribution = pytest.importorskip("setuptools").Distribution
    spec = importlib.util.spec_from_file_location("featreg_setup", ROOT / "setup.py")
    assert spec is not None
    assert spec.loader is not None
    setup = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(setup)
    (tmp_path / "some").mkdir()
    for name in ("__init__.py", "a_kernels.py", "a_kernels.bc", "table.bc"):
        (tmp_path / "some" / name).write_text("")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FEATREG_KERNELS", "numba")
    command = setup.BuildWithKernels(
        distribution({"script_name": "setup.py", "packages": ["some"], "package_data": {"": ["*.bc"]}})
    )
    command.build_lib = str(tmp_path / "build")
    command.ensure_finalized()
    command.run()
    made = sorted(path.name for path in (tmp_path / "build").rglob("*.*"))
    assert made == ["__init__.py", "a_kernels.py", "table.bc"]
    assert 1 <= setup.worker_count() <= setup.MOST_WORKERS
    monkeypatch.setenv("FEATREG_KERNELS", "nubma")
    with pytest.raises(
        pytest.importorskip("setuptools.errors").OptionError, match="'nubma', give 'numba' or 'bitcode'"
    ):
        command.run()
