"""How this package compiles its hot loops: one decorator, machine code that was prepared or that numba makes, no GIL.

A kernel is first sought among those that lie beside its module, translated by numba when the package was built
(`featreg.runtime.precompiled`): neither numba nor its half second of import is needed then. What was not foreseen
there, and every source that changed since, numba compiles when it is first called and caches on disk.
No fastmath where results are summed: sums keep their order, and equal input gives equal bits.
"""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import os
import sys
import threading
from collections.abc import Callable
from functools import lru_cache, update_wrapper
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar, cast

from featreg.runtime.calling import MISS
from featreg.runtime.kernel_sources import OPTIONS, source_digest
from featreg.runtime.precompiled import Bound, key_of, prepared

logger = logging.getLogger(__name__)
F = TypeVar("F", bound=Callable[..., Any])

_lock = threading.RLock()
#: Whether numba may keep code on disk and take what it kept before.
keeping = True
#: (module, kernel) -> the kinds of arguments that it was called with, where these are being recorded; else None.
calls: dict[tuple[str, str], set[tuple[str, ...]]] | None = None


def compiled(function: F) -> F:
    """Compile `function` for the argument types of each call; cached on disk, releases the GIL."""
    return cast(F, Kernel(function, "never"))


def compact(function: F) -> F:
    """Compile a kernel that a pair calls once or twice on few numbers: prepared as short code, which is made sooner.

    Its loops become vectors where that needs no second copy of them, and are not unrolled.
    """
    return cast(F, Kernel(function, "never", compact=True))


def disjoint(function: F) -> F:
    """Compile a helper of kernels whose arrays never overlap: the compiler may read ahead of what it writes."""
    return cast(F, Kernel(function, "never", disjoint=True))


def inlined(function: F) -> F:
    """Compile a small helper into the kernels that call it."""
    return cast(F, Kernel(function, "always"))


class Kernel:
    """A function of arrays and numbers that runs as machine code.

    Parameters
    ----------
    function : what to compile
    inline : "always" or "never", as numba has it
    disjoint : whether the memory of its arrays never overlaps
    compact : whether its prepared code is to be short rather than fast
    """

    def __init__(
        self, function: Callable[..., Any], inline: str, *, disjoint: bool = False, compact: bool = False
    ) -> None:
        self.function, self.inline, self.disjoint, self.compact = function, inline, disjoint, compact
        self._bound: tuple[Bound, ...] = ()
        self._quick: tuple[Callable[..., Any], ...] = ()
        self._dispatcher: Any = None
        #: Kinds of arguments for which nothing is prepared.
        self._unprepared: set[tuple[str, ...] | None] = set()
        update_wrapper(self, function)

    def __call__(self, *values: Any) -> Any:
        if calls is not None:
            calls.setdefault((self.__module__, self.function.__name__), set()).add(key_of(values) or ())
        for quick in self._quick:
            result = quick(*values)
            if result is not MISS:
                return result
        for bound in self._bound:
            result = bound(values)
            if result is not MISS:
                return result
        return self._first(values)

    def _first(self, values: tuple[Any, ...]) -> Any:
        """The first call with arguments of these kinds, and every one that numba's code serves."""
        key = key_of(values)
        found = None
        if key not in self._unprepared:
            with _lock:
                # Another thread may have bound it since.
                found = next((bound for bound in self._bound if bound.fits(values)), None)
                if found is None and all(bound.key != key for bound in self._bound):
                    found = prepared(self, key)
                    if found is None:
                        self._unprepared.add(key)
                    else:
                        self._bound = (*self._bound, found)
                        self._quick = (*self._quick, found.quick)
        # An array that may not be written is of the same kind: where the kernel would write it, numba says that.
        return self.dispatcher(*values) if found is None or not found.fits(values) else found(values)

    @property
    def path(self) -> Path:
        """The file of its source."""
        return Path(self.function.__code__.co_filename)

    @property
    def used(self) -> dict[str, Kernel]:
        """Name -> the kernels that it calls."""
        scope = self.function.__globals__
        named = {name: scope.get(name) for name in self.function.__code__.co_names}
        return {name: value for name, value in named.items() if isinstance(value, Kernel)}

    @property
    def dispatcher(self) -> Any:
        """The function as numba compiles it; imports numba when it is first asked for."""
        with _lock:
            if self._dispatcher is None:
                # numba knows its own functions only: the copy sees them where the module has kernels.
                scope = self.function.__globals__ | {
                    name: kernel.dispatcher for name, kernel in self.used.items() if kernel is not self
                }
                function = cast(FunctionType, self.function)
                copy = FunctionType(function.__code__, scope, function.__name__, function.__defaults__)
                copy.__qualname__, copy.__doc__ = function.__qualname__, function.__doc__
                self._dispatcher = _jit(copy, self.inline, source_digest(self) if keeping else "")
        return self._dispatcher


def _jit(function: FunctionType, inline: str, digest: str) -> Any:
    """A function of our own making as numba compiles it; `digest` says what it is compiled from, "" where none can."""
    import numba

    if numba.config.DISABLE_JIT:
        _say_not_compiled_once()
    if keeping and digest and _may_have_folder():
        plain = function.__qualname__
        # By itself numba takes what it kept while the file of the function is as it was, whatever became of the values
        # and the functions that this imports: what is compiled from something else gets another name.
        function.__qualname__ = f"{plain}_{digest[:16]}"
        # RuntimeError: no folder of this installation or of the user can be written.
        with contextlib.suppress(RuntimeError):
            return numba.njit(cache=True, inline=inline, **OPTIONS)(function)
        function.__qualname__ = plain
    if keeping and digest:
        _say_once()
    elif keeping:
        logger.warning("%s reads what may be another at each start: its code is not kept", function.__qualname__)
    return numba.njit(inline=inline, **OPTIONS)(function)


def numba_loaded() -> bool:
    """Whether anything has imported numba so far."""
    return "numba" in sys.modules


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


@lru_cache(maxsize=1)
def _say_not_compiled_once() -> None:
    if multiprocessing.parent_process() is None:
        logger.warning(
            "NUMBA_DISABLE_JIT, or .numba_config.yaml in this folder, keeps numba from compiling: kernels of which "
            "nothing is prepared run as Python, very slowly and with other types of numbers, and results may differ"
        )
