"""What a result records about how it was made."""

from __future__ import annotations

import platform
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version

from featreg._version import __version__

LIBRARIES = ("numpy", "opencv-contrib-python-headless", "numba", "scipy", "rasterio")


@lru_cache(maxsize=1)
def _versions() -> tuple[tuple[str, str], ...]:
    found = [("featreg", __version__), ("python", platform.python_version())]
    for name in LIBRARIES:
        try:
            found.append((name, version(name)))
        except PackageNotFoundError:
            continue
    return tuple(found)


def versions() -> dict[str, str]:
    """Return the versions of this package, of Python and of the libraries that decide results."""
    return dict(_versions())
