"""Calls of machine code from Python: what it is given, what it gives back, and what it leaves to its caller."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from featreg.runtime import calling
from featreg.runtime.machine import Machine

LLVM = pytest.importorskip("llvmlite.binding")
KEY = ("f8:1", "int", "float", "bool", "float32", "i2:2:A")
# a[0] + 10 n + 100 x + 1000 b + 10000 f + 100000 c[0, 1], whose samples lie STEP bytes apart; 7 as status of n = 99.
KERNEL = """
define i32 @kernel(ptr %out, ptr %a, i64 %n, double %x, i1 %b, float %f, ptr %c) {
  %p1 = getelementptr i8, ptr %a, i64 16
  %d1 = load ptr, ptr %p1
  %s1 = load double, ptr %d1
  %n1 = sitofp i64 %n to double
  %b1 = uitofp i1 %b to double
  %f1 = fpext float %f to double
  %p2 = getelementptr i8, ptr %c, i64 16
  %d2 = load ptr, ptr %p2
  %p3 = getelementptr i8, ptr %c, i64 40
  %d3 = load ptr, ptr %p3
  %p4 = getelementptr i64, ptr %d3, i64 1
  %step = load i64, ptr %p4
  %p5 = getelementptr i8, ptr %d2, i64 %step
  %c1 = load i16, ptr %p5
  %c2 = sitofp i16 %c1 to double
  %m1 = fmul double %n1, 10.0
  %m2 = fmul double %x, 100.0
  %m3 = fmul double %b1, 1000.0
  %m4 = fmul double %f1, 10000.0
  %m5 = fmul double %c2, 100000.0
  %a1 = fadd double %s1, %m1
  %a2 = fadd double %a1, %m2
  %a3 = fadd double %a2, %m3
  %a4 = fadd double %a3, %m4
  %a5 = fadd double %a4, %m5
  RESULT
  %bad = icmp eq i64 %n, 99
  %status = select i1 %bad, i32 7, i32 0
  ret i32 %status
}
"""
Calls = dict[str, Callable[..., Any]]
RESULTS = {
    "float": "store double %a5, ptr %out",
    "int": "%r = fptosi double %a5 to i64\n  store i64 %r, ptr %out",
    "bool": "%r = fcmp ogt double %a5, 100.0\n  %w = zext i1 %r to i64\n  store i64 %w, ptr %out",
    "": "store double %a5, ptr %d1",
}


@pytest.fixture(scope="module")
def calls() -> Calls:
    """Kind of result -> the kernel with such a result, as a function of Python."""
    machine = Machine()
    return {result: made(machine, result) for result in RESULTS}


def made(machine: Any, result: str) -> Callable[..., Any]:
    symbol = f"kernel_{result}"
    module = LLVM.parse_assembly(KERNEL.replace("RESULT", RESULTS[result]).replace("@kernel", f"@{symbol}"))
    module.triple = LLVM.get_process_triple()
    code = machine.optimised(module.as_bitcode(), calling.entered(symbol, KEY, result, (0,)))
    machine.engine.add_object_file(LLVM.ObjectFileRef.from_data(code))
    machine.engine.finalize_object()
    function = calling.callable_of(machine.engine.get_function_address(f"{symbol}_call"), KEY, "kernel")

    def call(*values: Any, _alive: Any = machine) -> Any:
        return function(*values)

    return call


def values(**other: Any) -> list[Any]:
    known = {"a": np.array([3.0]), "n": 2, "x": 0.5, "b": True, "f": np.float32(0.25), "c": np.eye(4, dtype=np.int16)}
    return list((known | other).values())


def test_numbers_and_arrays_arrive(calls: Calls) -> None:
    call = calls["float"]
    assert call(*values()) == 3 + 20 + 50 + 1000 + 2500
    assert call(*values(n=np.int64(-2), x=np.float64(1.5), b=np.False_)) == 3 - 20 + 150 + 2500
    assert call(*values(n=-1, b=False)) == 3 - 10 + 50 + 2500
    turned = np.arange(6, dtype=np.int16).reshape(2, 3).T
    assert call(*values(c=turned, b=np.True_)) == 3 + 20 + 50 + 1000 + 2500 + 300000
    assert type(call(*values())) is float


def test_results_of_each_kind(calls: Calls) -> None:
    assert calls["int"](*values()) == 3573
    assert type(calls["int"](*values())) is int
    of_bool = calls["bool"]
    assert of_bool(*values()) is True
    assert of_bool(*values(x=-100.0)) is False
    written = values()
    assert calls[""](*written) is None
    assert written[0][0] == 3573


@pytest.mark.parametrize(
    "other",
    [
        {"a": np.zeros(1, np.float32)}, {"a": np.zeros((1, 1))}, {"a": np.zeros(4)[::2]}, {"a": [3.0]},
        {"a": np.zeros(1).astype(">f8")}, {"a": np.ma.array([3.0])}, {"n": 2.0}, {"n": True}, {"n": np.int32(2)},
        {"x": 1}, {"x": np.float32(1)}, {"b": 1}, {"b": None}, {"f": 0.25}, {"c": np.zeros((2, 2), np.uint16)},
    ],
)  # fmt: skip
def test_what_is_of_another_kind_is_left_to_the_caller(calls: Calls, other: dict[str, Any]) -> None:
    assert calls["float"](*values(**other)) is calling.MISS


def test_arrays_are_looked_at_as_numba_does(calls: Calls) -> None:
    """The first array is written into by one of the kernels, the second is only read."""
    call, locked = calls["float"], np.eye(4, dtype=np.int16)
    locked.flags.writeable = False
    assert call(*values(c=locked)) == call(*values())
    assert call(*values(c=np.broadcast_to(np.int16(0), (4, 4)))) == call(*values())
    for kind, name, size in (("<f8", "a", 3), ("<i2", "c", 4)):
        shifted = np.zeros(2 * size * 8 + 1, np.uint8)[1:].view(kind)[:size]
        shifted = shifted.reshape(2, 2) if name == "c" else shifted
        assert not shifted.flags.aligned
        assert call(*values(**{name: shifted})) is calling.MISS
    unwritable = values()
    unwritable[0].flags.writeable = False
    assert calls[""](*unwritable) is calling.MISS
    assert unwritable[0][0] == 3.0


def test_another_number_of_arguments_is_left_to_the_caller(calls: Calls) -> None:
    call = calls["float"]
    assert call() is calling.MISS
    assert call(*values()[:-1]) is calling.MISS
    assert call(*values(), 1) is calling.MISS


def test_numbers_beyond_64_bits_and_a_kernel_that_fails_are_errors(calls: Calls) -> None:
    call = calls["float"]
    with pytest.raises(OverflowError):
        call(*values(n=2**63))
    with pytest.raises(RuntimeError, match="the compiled kernel failed"):
        call(*values(n=99))


def test_calls_leave_no_reference_behind(calls: Calls) -> None:
    call, given = calls["float"], values()
    counted = given[0], given[5], calling.MISS
    before = [sys.getrefcount(thing) for thing in counted]
    for _ in range(100):
        call(*given)
        call(*given, 1)
    assert [sys.getrefcount(thing) for thing in counted] == before


def test_a_function_holds_all_that_it_is_made_of() -> None:
    """CPython reads the flags and the name for as long as there is the function, also while it goes."""
    function = calling.callable_of(12345, KEY, "kernel")
    (table,) = gc.get_referents(function)
    assert type(table) is np.ndarray
    assert table.base is None
    words = table.tolist()
    place = words.index(calling.FASTCALL) - 2
    assert words[place + 1] == 12345
    assert table.ctypes.data < words[place] < table.ctypes.data + table.nbytes
    assert function.__name__ == "kernel"


def test_arrays_lie_as_the_code_reads_them() -> None:
    assert calling.layout_holds()
