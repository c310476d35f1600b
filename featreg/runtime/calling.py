"""How Python calls prepared code: a function of CPython's own kind, which reads its arguments where they lie.

`ctypes` takes half a microsecond an argument, more than many kernels take for a few hundred points. What is linked to a
kernel here looks at the types of its arguments, releases the GIL, calls the kernel and makes a Python number of what it
found, without a step of the interpreter. Whatever it does not know exactly it leaves to its caller (`MISS`).
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import numpy as np

#: Of a call whose arguments are of another kind.
MISS = object()
#: Offsets in bytes: the type of any object, what a number holds, and of an array its data, number of axes, extents,
#: strides, dtype and flags.
TYPE, VALUE = 8, 16
DATA, AXES, EXTENTS, STRIDES, DTYPE, FLAGS = 16, 24, 32, 40, 56, 64
#: Flags of an array: its samples lie one after the other, at addresses that suit them, and may be written.
CONTIGUOUS, ALIGNED, WRITEABLE = 1, 0x100, 0x400
#: The flag of a function of a vector of arguments.
FASTCALL = 0x80
#: LLVM's types of the numbers that are passed.
_PASSED = {"int": "i64", "float": "double", "bool": "i1", "float32": "float"}
#: What the code finds in its table, by name; the dtype of each argument follows.
_NAMES = (
    "array", "miss", "none", "true", "false", "numpy_true", "numpy_false", "float", "numpy_float", "int", "numpy_int",
    "numpy_float32", "PyLong_AsLongLong", "PyErr_Occurred", "PyEval_SaveThread", "PyEval_RestoreThread",
    "PyFloat_FromDouble", "PyLong_FromLongLong", "PyErr_SetString", "PyExc_RuntimeError", "Py_IncRef", "message",
)  # fmt: skip
_OBJECTS = {
    "array": np.ndarray, "miss": MISS, "none": None, "true": True, "false": False, "numpy_true": np.True_,
    "numpy_false": np.False_, "float": float, "numpy_float": np.float64, "int": int, "numpy_int": np.int64,
    "numpy_float32": np.float32,
    "PyExc_RuntimeError": RuntimeError,
}  # fmt: skip


class _Method(ctypes.Structure):
    """CPython's PyMethodDef."""

    _fields_ = (
        ("name", ctypes.c_void_p),
        ("code", ctypes.c_void_p),
        ("flags", ctypes.c_int),
        ("doc", ctypes.c_void_p),
    )


def layout_holds() -> bool:
    """Whether arrays and numbers lie in memory as prepared code reads them, which no standard promises."""
    sample = np.zeros((3, 5), np.int16)[:, ::2]

    def word(start: int, kind: Any = ctypes.c_int64) -> Any:
        return kind.from_address(start).value

    data, extents, strides = (word(id(sample) + offset) for offset in (DATA, EXTENTS, STRIDES))
    whole, locked, shifted = np.zeros(3), np.zeros(3), np.zeros(9, np.uint8)[1:].view(np.float64)
    locked.flags.writeable = False
    flags = [word(id(array) + FLAGS, ctypes.c_int32) for array in (sample, whole, locked, shifted)]
    return bool(
        data == sample.ctypes.data
        and [word(extents), word(extents + 8), word(strides), word(strides + 8)] == [3, 3, 10, 4]
        and word(id(sample) + TYPE) == id(np.ndarray)
        and word(id(sample) + DTYPE) == id(sample.dtype)
        and word(id(sample) + AXES, ctypes.c_int32) == 2
        and [flag & CONTIGUOUS for flag in flags] == [0, CONTIGUOUS, CONTIGUOUS, CONTIGUOUS]
        and [flag & WRITEABLE for flag in flags] == [WRITEABLE, WRITEABLE, 0, WRITEABLE]
        and [flag & ALIGNED for flag in flags] == [ALIGNED, ALIGNED, ALIGNED, 0]
        and word(id(whole) + AXES, ctypes.c_int32) == 1
        and _held(np.int64(-12345), ctypes.c_int64) == -12345
        and _held(-1.25, ctypes.c_double) == _held(np.float64(-1.25), ctypes.c_double) == -1.25
        and _held(np.float32(-1.25), ctypes.c_float) == -1.25
    )


def _held(number: Any, kind: Any) -> Any:
    return kind.from_address(id(number) + VALUE).value


def flags_of(key: tuple[str, ...], outputs: tuple[int, ...]) -> list[int]:
    """The flags that each array of a call must have; 0 for numbers.

    As numba has it: what is written into may not be read-only, and what is only read may be.
    """
    wanted = [0] * len(key)
    for place, kind in enumerate(key):
        _, *layout = kind.split(":")
        if layout:
            wanted[place] = ALIGNED | (0 if layout[1:] else CONTIGUOUS) | (WRITEABLE if place in outputs else 0)
    return wanted


def entered(symbol: str, key: tuple[str, ...], result: str, outputs: tuple[int, ...]) -> str:
    """LLVM's text of the function ``<symbol>_call`` that calls a kernel.

    Parameters
    ----------
    symbol : of the kernel's code, which takes where its result goes, arrays as objects and numbers
    key : kinds of the arguments
    result : kind of the result; "" for None
    outputs : places of the arrays that it writes into
    """
    lines: list[str] = []
    count = 0

    def made(text: str) -> str:
        nonlocal count
        count += 1
        lines.append(f"  %t{count} = {text}")
        return f"%t{count}"

    def known(index: int | str) -> str:
        place = _NAMES.index(index) if isinstance(index, str) else len(_NAMES) + index
        return made(f"load ptr, ptr {made(f'getelementptr ptr, ptr %table, i64 {place}')}")

    def field(thing: str, offset: int, kind: str) -> str:
        return made(f"load {kind}, ptr {made(f'getelementptr i8, ptr {thing}, i64 {offset}')}")

    def must(condition: str) -> None:
        nonlocal count
        count += 1
        lines.extend((f"  br i1 {condition}, label %b{count}, label %miss", f"b{count}:"))

    given = [f"ptr {'null' if not result else '%held'}"]
    for place, (kind, flags) in enumerate(zip(key, flags_of(key, outputs), strict=True)):
        thing = made(f"load ptr, ptr {made(f'getelementptr ptr, ptr %args, i64 {place}')}")
        _, *layout = kind.split(":")
        if layout:
            must(made(f"icmp eq ptr {field(thing, TYPE, 'ptr')}, {known('array')}"))
            must(made(f"icmp eq ptr {field(thing, DTYPE, 'ptr')}, {known(place)}"))
            must(made(f"icmp eq i32 {field(thing, AXES, 'i32')}, {int(layout[0])}"))
            found = made(f"and i32 {field(thing, FLAGS, 'i32')}, {flags}")
            must(made(f"icmp eq i32 {found}, {flags}"))
            given.append(f"ptr {thing}")
            continue
        if kind == "bool":
            true, other = (made(f"icmp eq ptr {thing}, {known(name)}") for name in ("true", "numpy_true"))
            false, third = (made(f"icmp eq ptr {thing}, {known(name)}") for name in ("false", "numpy_false"))
            value = made(f"or i1 {true}, {other}")
            must(made(f"or i1 {value}, {made(f'or i1 {false}, {third}')}"))
        else:
            type_of = field(thing, TYPE, "ptr")
            numpys = made(f"icmp eq ptr {type_of}, {known(f'numpy_{kind}')}")
            own = "false" if kind == "float32" else made(f"icmp eq ptr {type_of}, {known(kind)}")
            must(made(f"or i1 {own}, {numpys}"))
            value = field(thing, VALUE, _PASSED[kind])
            if kind == "int":
                count += 1
                at = f"c{count}"
                lines.extend((f"  br label %{at}s", f"{at}s:", f"  br i1 {own}, label %{at}, label %{at}e", f"{at}:"))
                long = made(f"call i64 {known('PyLong_AsLongLong')}(ptr {thing})")
                lines.extend((f"  br label %{at}e", f"{at}e:"))
                value = made(f"phi i64 [ {long}, %{at} ], [ {value}, %{at}s ]")
                # It says by -1 that a number does not fit, and an error is set then.
                minus = made(f"icmp eq i64 {value}, -1")
                lines.extend((f"  br i1 {minus}, label %{at}w, label %{at}g", f"{at}w:"))
                error = made(f"call ptr {known('PyErr_Occurred')}()")
                wrong = made(f"icmp ne ptr {error}, null")
                lines.extend((f"  br i1 {wrong}, label %error, label %{at}g", f"{at}g:"))
        given.append(f"{_PASSED[kind]} {value}")
    state = made(f"call ptr {known('PyEval_SaveThread')}()")
    # The kernel is not copied into this function: its bits stay those of the code by itself.
    status = made(f"call i32 @{symbol}({', '.join(given)}) noinline")
    lines.append(f"  call void {known('PyEval_RestoreThread')}(ptr {state})")
    good = made(f"icmp eq i32 {status}, 0")
    lines.extend((f"  br i1 {good}, label %good, label %failed", "failed:"))
    kind_of = known("PyExc_RuntimeError")
    lines.append(f"  call void {known('PyErr_SetString')}(ptr {kind_of}, ptr {known('message')})")
    lines.extend(("  br label %error", "error:", "  ret ptr null", "good:"))
    if result == "int":
        value = made("load i64, ptr %held")
        number = made(f"call ptr {known('PyLong_FromLongLong')}(i64 {value})")
        lines.append(f"  ret ptr {number}")
    elif result == "float":
        value = made("load double, ptr %held")
        number = made(f"call ptr {known('PyFloat_FromDouble')}(double {value})")
        lines.append(f"  ret ptr {number}")
    else:
        found = known("none")
        if result == "bool":
            value = made("load i64, ptr %held")
            one = made(f"icmp ne i64 {value}, 0")
            found = made(f"select i1 {one}, ptr {known('true')}, ptr {known('false')}")
        lines.extend((f"  call void {known('Py_IncRef')}(ptr {found})", f"  ret ptr {found}"))
    lines.append("miss:")
    missed = known("miss")
    lines.extend((f"  call void {known('Py_IncRef')}(ptr {missed})", f"  ret ptr {missed}"))
    kinds = ", ".join(("ptr", *(_PASSED.get(kind, "ptr") for kind in key)))
    return "\n".join(
        (
            f"declare i32 @{symbol}({kinds})",
            f"define ptr @{symbol}_call(ptr %self, ptr %args, i64 %n) {{",
            "  %held = alloca i64",
            f"  %where = getelementptr i8, ptr %self, i64 {DATA}",
            "  %table = load ptr, ptr %where",
            f"  %right = icmp eq i64 %n, {len(key)}",
            "  br i1 %right, label %begin, label %miss",
            "begin:",
            *lines,
            "}",
        )
    )


@cache
def _shared() -> tuple[int, ...]:
    """The addresses that every table begins with, all but that of the message."""
    return tuple(
        id(_OBJECTS[name])
        if name in _OBJECTS
        else int(ctypes.cast(getattr(ctypes.pythonapi, name), ctypes.c_void_p).value or 0)
        for name in _NAMES[:-1]
    )


def callable_of(address: int, key: tuple[str, ...], name: str) -> Any:
    """A Python function of the code that `entered` makes.

    Parameters
    ----------
    address : of that code, which has to live as long as the function
    key : kinds of the arguments
    name : of the kernel, for errors
    """
    dtypes = [np.dtype(kind.split(":")[0]) if ":" in kind else None for kind in key]
    words = len(_NAMES) + len(key)
    described, message = name.encode() + b"\0", f"the compiled {name} failed".encode() + b"\0"
    texts = described + message
    # CPython looks into its PyMethodDef until the function is gone, and lets go of `self` last: all of it lies there.
    table = np.zeros(words + ctypes.sizeof(_Method) // 8 + -(-len(texts) // 8), np.uint64)
    method = _Method.from_address(table.ctypes.data + 8 * words)
    text = table.ctypes.data + 8 * words + ctypes.sizeof(_Method)
    ctypes.memmove(text, texts, len(texts))
    table[:words] = [*_shared(), text + len(described), *(id(dtype) for dtype in dtypes)]
    method.name, method.code, method.flags = text, address, FASTCALL
    kinds = (ctypes.py_object, ctypes.c_void_p, ctypes.py_object, ctypes.c_void_p)
    make: Any = ctypes.PYFUNCTYPE(*kinds)(("PyCFunction_NewEx", ctypes.pythonapi))
    return make(table.ctypes.data + 8 * words, table, None)
