"""What this installation is made of: versions, cores, compiled kernels, OpenCV's algorithms, hidden plugins, extras."""

from __future__ import annotations

import os
import platform
import re
import sys
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, requires
from typing import Any

from featreg.runtime.threads import THREAD_VARIABLES, available_processors
from featreg.runtime.versions import LIBRARIES, version_of, versions

#: Distributions that a command needs.
OF_COMMANDS = ("typer", "rich", "matplotlib", "pandas", "pyarrow")
#: The four builds of OpenCV, of which any may be installed.
OPENCV = (
    "opencv-contrib-python-headless",
    "opencv-contrib-python",
    "opencv-python-headless",
    "opencv-python",
)
MISSING = "not installed"


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
    found: dict[str, list[str]] = {}
    try:
        needed = requires("featreg") or []
    except PackageNotFoundError:
        needed = []
    for line in needed:
        extra = re.search(r"extra\s*==\s*['\"]([^'\"]+)['\"]", line)
        name = re.match(r"[A-Za-z0-9._-]+", line)
        if extra and name:
            absent = version_of(name[0]) is None
            found.setdefault(extra[1], []).extend([name[0]] if absent else [])
    return {
        name: {"missing": missing, "install": f"pip install 'featreg[{name}]'" if missing else ""}
        for name, missing in sorted(found.items())
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
