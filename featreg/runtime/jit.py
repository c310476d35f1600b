"""How this package compiles its hot loops: one decorator over `numba.njit`, cached on disk, without the GIL.

Modules of kernels import this one, so numba (about half a second) is imported only when a kernel is first needed.
No fastmath where results are summed: sums keep their order, and equal input gives equal bits.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
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
    try:
        return cast(F, numba.njit(cache=True, **options)(function))
    except RuntimeError as error:
        # No folder of this installation or of the user can be written: compile anew in every process.
        logger.info("%s is not cached: %s", function.__name__, error)
        return cast(F, numba.njit(**options)(function))
