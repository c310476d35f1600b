"""How this package compiles its hot loops: one decorator over `numba.njit`, cached on disk, without the GIL.

Modules of kernels import this one, so numba (about half a second) is imported only when a kernel is first needed.
No fastmath where results are summed: sums keep their order, and equal input gives equal bits.
"""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import os
from collections.abc import Callable
from functools import lru_cache
from typing import Any, TypeVar, cast

import numba

logger = logging.getLogger(__name__)
F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Compile `function` for the argument types of each call; cached on disk, releases the GIL."""
    return _jit(function, "never")


def inlined(function: F) -> F:
    """Compile a small helper into the kernels that call it."""
    return _jit(function, "always")


def _jit(function: F, inline: str) -> F:
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "inline": inline}
    if _may_have_folder():
        # RuntimeError: no folder of this installation or of the user can be written.
        with contextlib.suppress(RuntimeError):
            return cast(F, numba.njit(cache=True, **options)(function))
    _say_once()
    return cast(F, numba.njit(**options)(function))


@lru_cache(maxsize=1)
def _may_have_folder() -> bool:
    """Whether numba may look for a folder: for a user without home its last resort is one named "~" where it stands."""
    named = os.environ.keys() & {"NUMBA_CACHE_DIR", "XDG_CACHE_HOME"}
    return bool(named) or os.path.expanduser("~") != "~" or os.access(os.path.dirname(__file__), os.W_OK)


@lru_cache(maxsize=1)
def _say_once() -> None:
    if multiprocessing.parent_process() is None:
        logger.warning(
            "compiled code cannot be kept, every start compiles anew: neither the folder of the package nor the user's "
            "cache can be written; set NUMBA_CACHE_DIR to a folder that can"
        )
