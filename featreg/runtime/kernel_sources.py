"""What a kernel is compiled from: its source, that of all it calls, and every value that it takes from around it.

numba puts the value of a global into the code of a function as it stands when that is compiled, wherever it was
imported from. Code that was kept serves only while all of that is as it was.
"""

from __future__ import annotations

import hashlib
import marshal
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any, Protocol

import numpy as np

from featreg.runtime import calling

#: What translates kernels: where it changed, what it made before does not serve.
TRANSLATOR = Path(__file__).with_name("precompiling.py")
#: How numba compiles every kernel; no fastmath, since sums keep their order.
OPTIONS = {"nogil": True, "error_model": "numpy"}
#: Libraries of which numba knows the functions by itself.
KNOWN_TO_NUMBA = ("numpy", "math", "cmath", "builtins", "numba")


class Source(Protocol):
    """What is asked of a kernel."""

    function: Callable[..., Any]
    inline: str
    disjoint: bool
    compact: bool

    @property
    def path(self) -> Path: ...


class _UncertainError(Exception):
    """The content of a value cannot be known for certain."""


def source_digest(kernel: Source) -> str:
    """Digest of all from which a kernel is compiled; "" where it reads something of which that cannot be said.

    Notes
    -----
    It is taken of the files that hold the kernel and all that it calls, of the values of the globals and
    defaults which these read, how they are to be compiled, and of what translates them.
    """
    try:
        told = sorted(_read_by(kernel))
    except _UncertainError:
        return ""
    digest = hashlib.sha256(f"{calling.DATA} {calling.EXTENTS} {calling.STRIDES} {OPTIONS}".encode())
    digest.update(_of_file(TRANSLATOR))
    for one in told:
        digest.update(f"{len(one)} ".encode() + one)
    return digest.hexdigest()


def _read_by(kernel: Source) -> Iterator[bytes]:
    """A line for each function that a kernel consists of, and for each value that one of them reads."""
    seen, left = {id(kernel)}, [kernel]
    codes: dict[Path, list[CodeType]] = {}
    while left:
        one: Any = left.pop()
        function = _function(one)
        codes.setdefault(Path(function.__code__.co_filename), []).append(function.__code__)
        here = f"{function.__module__}.{function.__qualname__}"
        how = [str(getattr(one, name, "")) for name in ("inline", "disjoint", "compact")]
        yield " ".join((here, *how)).encode()
        for name, value in _values(function):
            called = _function(value)
            if called is None:
                yield f"{here} {name} ".encode() + _content(value)
                continue
            yield f"{here} {name} {called.__module__}.{called.__qualname__}".encode()
            if id(value) not in seen:
                seen.add(id(value))
                left.append(value)
    for path, typed in codes.items():
        try:
            yield _of_file(path)
        except OSError:  # typed in, or out of an archive
            for code in typed:
                # By later versions equal code may be told in other bytes: they name what is referred to more than once.
                yield marshal.dumps(code, 2)


def _function(value: Any) -> Any:
    """The function of Python that a kernel, or a function of numba's, is made of; None where it is none."""
    for name in ("function", "py_func"):
        value = getattr(value, name, value) if not isinstance(value, ModuleType | np.generic) else value
    return value if isinstance(value, FunctionType) else None


def _values(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """Name -> what a function reads that is none of its arguments, inside modules of which it reads something too."""
    names = set(_names(function.__code__))
    for name in names & function.__globals__.keys():
        value = function.__globals__[name]
        yield name, value
        if isinstance(value, ModuleType) and value.__name__.partition(".")[0] not in KNOWN_TO_NUMBA:
            for inner in names & vars(value).keys():
                yield f"{name}.{inner}", vars(value)[inner]
    for place, value in enumerate(function.__defaults__ or ()):
        yield f"default {place}", value
    if function.__closure__:
        raise _UncertainError


def _names(code: CodeType) -> Iterator[str]:
    """The names that a function and those inside it look up, those of attributes among them."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)


def _content(value: Any) -> bytes:
    """A value, told apart from every other one by its kind and content, alike in every process."""
    kind = f"{type(value).__name__} ".encode()
    if value is None or isinstance(value, bool | int | float | complex | str | bytes):
        return kind + repr(value).encode()
    if isinstance(value, np.generic | np.ndarray) and not value.dtype.hasobject:
        return kind + f"{value.dtype.str} {value.shape} ".encode() + value.tobytes()
    if isinstance(value, tuple):
        return kind + b",".join(b"%d %s" % (len(part), part) for part in map(_content, value))
    if isinstance(value, np.dtype):
        return kind + value.str.encode()
    if isinstance(value, ModuleType | np.ufunc):
        return kind + value.__name__.encode()
    if isinstance(value, type | BuiltinFunctionType):
        return kind + f"{value.__module__}.{value.__qualname__}".encode()
    raise _UncertainError


def _of_file(path: Path) -> bytes:
    state = path.stat()
    return _of_content(path, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=256)
def _of_content(path: Path, time_ns: int, size: int) -> bytes:
    return hashlib.sha256(path.read_bytes()).digest()
