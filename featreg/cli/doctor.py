"""`featreg doctor`: versions, cores, compiled kernels, OpenCV's algorithms, hidden plugins, extras."""

from __future__ import annotations

import json
import os
import platform
import re
import shutil
import sys
import textwrap
from collections.abc import Mapping
from typing import Annotated, Any

import typer

from featreg.runtime.threads import THREAD_VARIABLES, available_processors
from featreg.runtime.versions import LIBRARIES, version_of, versions

#: Distributions that a command needs.
OF_COMMANDS = ("typer", "rich", "matplotlib", "pyarrow")
#: The four builds of OpenCV, of which any may be installed.
OPENCV = (
    "opencv-contrib-python-headless",
    "opencv-contrib-python",
    "opencv-python-headless",
    "opencv-python",
)
MISSING = "not installed"


def doctor(as_json: Annotated[bool, typer.Option("--json", help="Print JSON for machines.")] = False) -> None:
    """Show what this installation is made of.

    Versions, cores and threads, compiled kernels, where OpenCV keeps what, plugins that cannot be used here and why,
    and extras that are not installed.
    """
    found = examine()
    if as_json:
        typer.echo(json.dumps(found, indent=2))
        return
    _section("versions", found["versions"])
    _section("threads", found["threads"])
    cached: Mapping[str, bool] = found["kernels"]["cached"]
    cold = [name for name, warm in cached.items() if not warm]
    state = f"{len(cached) - len(cold)} of {len(cached)} modules compiled, kept in {found['kernels']['folder']}"
    _section("kernels", {"": state})
    if cold:
        _section("", {"": f"compiled when first used: {', '.join(cold)}"})
    where = found["opencv"]
    homes = {home: [n for n, w in where.items() if w == home] for home in ("cv2", "cv2.xfeatures2d")}
    _section("OpenCV", {home: ", ".join(names) for home, names in homes.items() if names})
    _section("", {name: reason for name, reason in where.items() if reason not in homes})
    _section("plugins that cannot be used here", found["unavailable"] or {"": "none"})
    _section("plugins that cannot be imported", found["hidden_plugins"] or {"": "none"})
    extras = {
        name: f"missing {', '.join(e['missing'])}; install with: {e['install']}" if e["missing"] else "installed"
        for name, e in found["extras"].items()
    }
    _section("extras", extras or {"": "none declared"})


def _section(title: str, values: Mapping[str, Any]) -> None:
    if title:
        typer.echo(title)
    width = max((len(name) for name in values), default=0)
    columns = max(60, min(shutil.get_terminal_size().columns, 120))
    for name, value in values.items():
        head = f"  {name:<{width}}  " if name else "  "
        text = textwrap.fill(
            str(value), columns, initial_indent=head, subsequent_indent=" " * len(head), break_on_hyphens=False
        )
        typer.echo(text)


def examine() -> dict[str, Any]:
    """Look at the installation.

    Returns
    -------
    A dict fit for JSON: ``versions`` {name: version}, ``threads`` {what: number}, ``kernels`` {folder, modules},
    ``opencv`` {algorithm: where it is or why not}, ``hidden_plugins`` {module: reason}, ``unavailable`` {"kind name":
    reason}, ``extras`` {name: {missing, install}}.
    """
    from featreg import registry
    from featreg.interop import opencv
    from featreg.warming import kernels_cached

    kernels = kernels_cached()
    unavailable = {f"{e.kind} {e.name}": e.unavailable for kind in registry.KINDS for e in registry.entries(kind)}
    return {
        "versions": _versions(),
        "threads": _threads(),
        "kernels": {"folder": _cache_folder(), "cached": dict(kernels)},
        "opencv": opencv.homes(),
        "hidden_plugins": dict(registry.broken()),
        "unavailable": {name: reason for name, reason in unavailable.items() if reason},
        "extras": missing_extras(),
    }


def missing_extras() -> Mapping[str, Mapping[str, Any]]:
    """Return extra -> {"missing": names of its libraries that are not installed, "install": the command}.

    The extras are those that the installed package declares.
    """
    from importlib.metadata import PackageNotFoundError, requires

    try:
        needed = requires("featreg") or []
    except PackageNotFoundError:
        needed = []
    libraries: dict[str, list[str]] = {}
    parts: dict[str, list[str]] = {}
    for line in needed:
        extra = re.search(r"extra\s*==\s*['\"]([^'\"]+)['\"]", line)
        name = re.match(r"([A-Za-z0-9._-]+)\s*(?:\[([^\]]*)\])?", line)
        if extra is None or name is None:
            continue
        own = libraries.setdefault(extra[1], [])
        if name[1].lower() == "featreg":
            parts.setdefault(extra[1], []).extend(part.strip() for part in (name[2] or "").split(","))
        else:
            own.append(name[1])

    def all_of(extra: str, seen: frozenset[str]) -> list[str]:
        """The libraries of an extra and of those it is made of."""
        inner = [n for part in parts.get(extra, []) if part not in seen for n in all_of(part, seen | {part})]
        return list(dict.fromkeys([*libraries.get(extra, []), *inner]))

    return {
        name: {"missing": missing, "install": f"pip install 'featreg[{name}]'" if missing else ""}
        for name in sorted(libraries)
        for missing in [[n for n in all_of(name, frozenset({name})) if version_of(n) is None]]
    }


def _versions() -> dict[str, str]:
    builds = [f"{name} {number}" for name in OPENCV if (number := version_of(name)) is not None]
    known = versions()
    opencv = f"{known.pop('opencv', MISSING)} ({', '.join(builds) or 'of no known distribution'})"
    return {
        "featreg": known.pop("featreg"),
        "Python": f"{known.pop('python')} ({sys.executable})",
        "system": f"{platform.system()} {platform.machine()}",
        "OpenCV": opencv,
        **{name: known.get(name) or version_of(name) or MISSING for name in (*LIBRARIES, *OF_COMMANDS)},
    }


def _threads() -> dict[str, Any]:
    found: dict[str, Any] = {"cores": os.cpu_count(), "usable cores": available_processors()}
    try:
        import cv2

        found["OpenCV threads"] = cv2.getNumThreads()
    except ImportError:
        pass
    for name in THREAD_VARIABLES:
        if name in os.environ:
            found[name] = os.environ[name]
    return found


def _cache_folder() -> str:
    """Where the compiled kernels lie: beside their modules, unless that folder cannot be written."""
    from featreg.warming import cache_folders

    folders = sorted(str(folder) for folder in cache_folders())
    if not folders:
        return "no folder (none can be written, every start compiles anew; set NUMBA_CACHE_DIR)"
    home = os.path.expanduser("~")
    return ", ".join(f"~{folder[len(home) :]}" if folder.startswith(home + os.sep) else folder for folder in folders)
