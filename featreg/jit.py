"""How this package compiles its hot loops: one decorator over `numba.njit`, cached on disk, without the GIL.

Modules of kernels import this one, so numba (about half a second) is imported only when a kernel is first needed.
No fastmath where results are summed: sums keep their order, and equal input gives equal bits.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Compile `function` for the argument types of each call; cached on disk, releases the GIL."""
    return cast(F, numba.njit(cache=True, nogil=True, error_model="numpy")(function))


def inlined(function: F) -> F:
    """Compile a small helper into the kernels that call it."""
    return cast(F, numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")(function))
