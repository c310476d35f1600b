"""Kernels that were translated to LLVM's code when the package was built, made into machine code of this processor.

Beside a module of kernels lies a file of the same name that ends in `.bc`, which setup.py writes. It holds, for each
kernel and each kind of arguments that the methods use, what numba makes of it before anything depends on the processor,
and the machine code of the processor on which it was built. On another one the first call optimises the former (a tenth
of a second or less) and keeps the object on disk; later starts load that. The steps are numba's own, and so are the
bits of the results. `FEATREG_KERNELS=bitcode` leaves that machine code out, where the file is written or read.

Where a file is missing, was made for another system, another LLVM, from another source or by another translator, there
is nothing prepared, and numba compiles as ever. `FEATREG_KERNELS=numba` asks for that.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from featreg.runtime import calling, machine
from featreg.runtime.calling import MISS
from featreg.runtime.environment import KERNELS, setting
from featreg.runtime.kernel_sources import Source, source_digest

#: Offsets in bytes of the fields of an array of numpy, as its code has them: data, extents and strides.
DATA, EXTENTS, STRIDES = calling.DATA, calling.EXTENTS, calling.STRIDES


def _word(number: Any) -> int:
    """A number of 64 bits; an error where it needs more, of which ctypes would take the lowest."""
    word = int(number)
    if not -(1 << 63) <= word < 1 << 63:
        raise OverflowError(f"a kernel takes whole numbers of 64 bits, got {word}")
    return word


#: Kinds of numbers: the types that pass as one, and what they become.
NUMBERS: dict[str, tuple[tuple[type, ...], Callable[[Any], Any], Any]] = {
    "int": ((int, np.int64), _word, ctypes.c_int64),
    "float": ((float, np.float64), float, ctypes.c_double),
    "bool": ((bool, np.bool_), bool, ctypes.c_bool),
    "float32": ((np.float32,), float, ctypes.c_float),
}
#: Variables of numba that ask for other code than is prepared, and what they are where they do not. NUMBA_DISABLE_JIT
#: is none of them: it keeps numba from compiling, and as Python kernels would count in other types.
OTHER_CODE = {
    "NUMBA_BOUNDSCHECK": "0", "NUMBA_DEBUGINFO": "0", "NUMBA_OPT": "3", "NUMBA_LOOP_VECTORIZE": "1",
    "NUMBA_SLP_VECTORIZE": "0",
}  # fmt: skip
_KINDS = {kind: name for name, (kinds, _, _) in NUMBERS.items() for kind in kinds}
#: Kinds of results: what holds them.
RESULTS = {"int": ctypes.c_int64, "float": ctypes.c_double, "bool": ctypes.c_int64}


def key_of(values: tuple[Any, ...]) -> tuple[str, ...] | None:
    """The kinds of the arguments of a call; None where one is neither a plain number nor an array in order of bytes and
    at an address that suit the processor.

    That of an array is its samples' and the number of its axes, with ":A" where it is not contiguous.
    """
    key = []
    for value in values:
        if type(value) is np.ndarray:
            if not (value.dtype.isnative and value.flags.aligned):
                return None
            key.append(f"{value.dtype.str[1:]}:{value.ndim}{'' if value.flags.c_contiguous else ':A'}")
        elif type(value) in _KINDS:
            key.append(_KINDS[type(value)])
        else:
            return None
    return tuple(key)


class Bound:
    """Machine code of one kernel for arguments of one kind.

    Parameters
    ----------
    address : of the code
    key : kinds of the arguments
    result : kind of the result; "" for None
    name : of the kernel, for errors
    entry : address of what `featreg.runtime.calling.entered` made of it
    outputs : places of the arrays that it writes into

    `quick` is called with the arguments one by one and returns `MISS` where it does not know the kind of one exactly,
    as of a number that is a bool or a dtype that is another object; calling the object itself then decides.
    """

    def __init__(
        self, address: int, key: tuple[str, ...], result: str, name: str, entry: int, outputs: tuple[int, ...]
    ) -> None:
        self.name, self.key, self.count = name, key, len(key)
        self.quick = calling.callable_of(entry, key, name)
        self.result: Any = RESULTS.get(result)
        self.as_bool = result == "bool"
        self.wanted: list[tuple[Any, int, Any]] = []
        kinds: list[Any] = [ctypes.c_void_p]
        for kind, flags in zip(key, calling.flags_of(key, outputs), strict=True):
            dtype, *layout = kind.split(":")
            if layout:
                self.wanted.append((np.dtype(dtype), int(layout[0]), flags))
                kinds.append(ctypes.py_object)
            else:
                types, convert, c_type = NUMBERS[kind]
                self.wanted.append((types, -1, convert))
                kinds.append(c_type)
        self._kinds, self._address = kinds, address

    @cached_property
    def call(self) -> Any:
        """The code as ctypes calls it: without the GIL, while ctypes holds the arrays."""
        return ctypes.CFUNCTYPE(ctypes.c_int32, *self._kinds)(self._address)

    def fits(self, values: tuple[Any, ...]) -> bool:
        """Whether the arguments are of its kind."""
        return self._given(values) is not None

    def _given(self, values: tuple[Any, ...]) -> list[Any] | None:
        if len(values) != self.count:
            return None
        given = []
        for value, (kind, dimensions, then) in zip(values, self.wanted, strict=True):
            if dimensions < 0:
                if type(value) not in kind:
                    return None
                given.append(then(value))
            elif (
                type(value) is np.ndarray
                and value.dtype == kind
                and value.ndim == dimensions
                and value.flags.num & then == then
            ):
                given.append(value)
            else:
                return None
        return given

    def __call__(self, values: tuple[Any, ...]) -> Any:
        given = self._given(values)
        if given is None:
            return MISS
        if self.result is None:
            status, out = self.call(None, *given), None
        else:
            held = self.result()
            status, out = self.call(ctypes.addressof(held), *given), held.value
        if status != 0:
            raise RuntimeError(f"the compiled {self.name} failed with status {status}")
        return bool(out) if self.as_bool else out


@dataclass(frozen=True)
class Prepared:
    """One kernel of a file.

    Parameters
    ----------
    key : kinds of its arguments
    result : kind of its result; "" for None
    symbol : of its code
    outputs : places of the arrays that it writes into
    code : LLVM's
    made : machine code of the processor on which this was prepared; empty where there is none
    """

    key: tuple[str, ...]
    result: str
    symbol: str
    outputs: tuple[int, ...]
    code: bytes
    made: bytes = b""


def file_of(source: Path) -> Path:
    """Where the prepared kernels of a module lie."""
    return source.with_suffix(".bc")


def written(entries: dict[tuple[str, str], list[Prepared]], llvm: list[int], triple: str) -> bytes:
    """The content of a file: (kernel, digest of its source) -> what is prepared of it."""
    body, listed, here = b"", [], machine.machine()
    for (name, digest), prepared in sorted(entries.items()):
        for one in sorted(prepared, key=lambda one: one.key):
            # Where there is no machine code nothing stands for it, not even what unpacks to nothing.
            packed, made = (zlib.compress(code, 9) if code else b"" for code in (one.code, one.made))
            listed.append(
                {
                    "kernel": name,
                    "source": digest,
                    "key": one.key,
                    "result": one.result,
                    "symbol": one.symbol,
                    "outputs": one.outputs,
                    "at": [len(body), len(packed)],
                    "made": [len(body) + len(packed), len(made)],
                }
            )
            body += packed + made
    header = json.dumps(
        {"llvm": llvm, "triple": triple, "machine": "" if here is None else here.identity, "kernels": listed},
        separators=(",", ":"),
    ).encode()
    return header + b"\n" + body


@cache
def _content(path: Path) -> tuple[dict[str, Any], bytes] | None:
    try:
        header, _, body = path.read_bytes().partition(b"\n")
        return json.loads(header), body
    except (OSError, ValueError):
        return None


_digest: Any = cache(source_digest)


def listed(source: Path) -> list[dict[str, Any]]:
    """What lies prepared beside a module, of whichever source."""
    found = _content(file_of(source))
    return [] if found is None else list(found[0]["kernels"])


def current(kernel: Source) -> list[dict[str, Any]]:
    """What is prepared of a kernel, from its source as it is now; nothing where numba is asked for."""
    if left_to_numba():
        return []
    name = kernel.function.__name__
    of_name = [entry for entry in listed(kernel.path) if entry["kernel"] == name]
    # Without a digest nothing tells whether what lies there is of the kernel as it is.
    return [entry for entry in of_name if entry["source"] and entry["source"] == _digest(kernel)]


def left_to_numba() -> bool:
    """Whether the environment asks for numba itself, or for code that only numba makes."""
    other = any(os.environ.get(name, "") not in ("", usual) for name, usual in OTHER_CODE.items())
    return other or setting(KERNELS) == "numba"


def prepared_here(kernel: Source) -> bool:
    """Whether a kernel is prepared, for some arguments, in code that this machine takes."""
    found, here = _content(file_of(kernel.path)), machine.machine()
    return (
        found is not None
        and here is not None
        and here.takes(found[0]["llvm"], found[0]["triple"])
        and bool(current(kernel))
    )


def prepared(kernel: Source, key: tuple[str, ...] | None) -> Bound | None:
    """The machine code of a kernel for arguments of these kinds; None where nothing is prepared for them here."""
    found = _content(file_of(kernel.path))
    if key is None or found is None:
        return None
    for entry in current(kernel):
        if tuple(entry["key"]) == key:
            here = machine.machine()
            if here is None or not here.takes(found[0]["llvm"], found[0]["triple"]):
                return None
            code, made = (found[1][start : start + size] for start, size in (entry["at"], entry["made"]))
            if found[0]["machine"] != here.identity or setting(KERNELS) == "bitcode":
                made = b""
            symbol, result, outputs = entry["symbol"], entry["result"], tuple(entry["outputs"])
            addresses = here.addresses(symbol, code, key, result, outputs, made)
            if addresses is not None:
                return Bound(addresses[0], key, result, entry["kernel"], addresses[1], outputs)
    return None


def ready(one: Prepared) -> Prepared:
    """A kernel with its machine code for the processor at hand, where there is such."""
    here = machine.machine()
    if here is None or setting(KERNELS) == "bitcode":
        return one
    entry = calling.entered(one.symbol, one.key, one.result, one.outputs)
    # Without machine code it is made at the first call, where a failure is said.
    with contextlib.suppress(RuntimeError):
        return replace(one, made=here.optimised(one.code, entry))
    return one
