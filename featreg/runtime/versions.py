"""What a result records about how it was made."""

from __future__ import annotations

import platform
from functools import lru_cache

from featreg._version import __version__

#: Beside OpenCV, which comes under four names, the libraries that decide results.
LIBRARIES = ("numpy", "numba", "scipy", "scikit-image", "rasterio")


@lru_cache(maxsize=1)
def _versions() -> tuple[tuple[str, str], ...]:
    numbers = {name: version_of(name) for name in LIBRARIES} | {"opencv": _opencv()}
    found = [(name, number) for name, number in numbers.items() if number is not None]
    return (("featreg", __version__), ("python", platform.python_version()), *found)


def versions() -> dict[str, str]:
    """Return the versions of this package, of Python and of the libraries that decide results."""
    return dict(_versions())


def version_of(name: str) -> str | None:
    """The version of an installed distribution; None where it is not installed."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _opencv() -> str | None:
    """Of the module itself: any of its four distributions may be installed, or one built here that is none."""
    try:
        import cv2
    except ImportError:
        return None
    return str(cv2.__version__)
