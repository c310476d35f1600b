"""Translation of kernels to LLVM's code by numba, for the files that `featreg.runtime.precompiled` reads.

Only numba's own front end has run on that code, and its removal of reference counts: nothing in it depends on the
processor. It needs nothing of numba or Python when it runs: arrays are read where CPython keeps them, and memory comes
from the C library.
"""

from __future__ import annotations

import contextlib
import hashlib
import re
from collections.abc import Callable, Iterator
from graphlib import CycleError, TopologicalSorter
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from llvmlite import ir
from numba.core import cgutils, codegen, compiler, types
from numba.core.registry import cpu_target
from numba.np.arrayobj import populate_array
from numba.np.numpy_support import from_dtype

from featreg.runtime.precompiled import DATA, EXTENTS, STRIDES, Prepared

#: Functions of the C library that prepared code may call; everything else it must bring along.
C_LIBRARY = {
    "malloc", "free", "memcpy", "memset", "memmove", "abort",
    "hypot", "atan2", "log1p", "expm1", "pow", "exp", "log", "log10", "sin", "cos", "tan", "sqrt", "floor", "ceil",
    "fmod", "erf", "erfc", "acos", "asin", "atan", "rint", "round", "trunc",
}  # fmt: skip
C_LIBRARY |= {f"{name}f" for name in C_LIBRARY}
_NUMBERS = {"int": types.int64, "float": types.float64, "bool": types.boolean, "float32": types.float32}
#: How numba begins the names of this package's kernels.
OWN = "_ZN7featreg"
#: Where the samples of an array lie that a function is given, in LLVM's text.
_SAMPLES = re.compile(r"ptr (%arg\.\w+\.4\b)")
#: A block's label in LLVM's text, and where a branch goes.
_LABEL, _TARGET = re.compile(r'("[^"]+"|[\w.$-]+):'), re.compile(r'label %("[^"]+"|[\w.$-]+)')
# numba's record of an allocation (references, destructor, what it is told, data, size), by the C library.
_MEMORY = """
declare noalias ptr @malloc(i64)
declare void @free(ptr)
define noalias ptr @NRT_MemInfo_alloc_aligned(i64 %size, i32 %align) {
  %a = zext i32 %align to i64
  %room = add i64 %size, 112
  %all = add i64 %room, %a
  %p = call noalias ptr @malloc(i64 %all)
  %none = icmp eq ptr %p, null
  br i1 %none, label %out, label %good
good:
  %start = ptrtoint ptr %p to i64
  %less = sub i64 %a, 1
  %behind = add i64 %start, 48
  %far = add i64 %behind, %less
  %mask = sub i64 0, %a
  %at = and i64 %far, %mask
  %data = inttoptr i64 %at to ptr
  store i64 1, ptr %p
  %f1 = getelementptr i8, ptr %p, i64 8
  store ptr null, ptr %f1
  %f2 = getelementptr i8, ptr %p, i64 16
  store ptr null, ptr %f2
  %f3 = getelementptr i8, ptr %p, i64 24
  store ptr %data, ptr %f3
  %f4 = getelementptr i8, ptr %p, i64 32
  store i64 %size, ptr %f4
  %f5 = getelementptr i8, ptr %p, i64 40
  store ptr null, ptr %f5
  br label %out
out:
  ret ptr %p
}
define void @NRT_MemInfo_call_dtor(ptr %p) {
  call void @free(ptr %p)
  ret void
}
"""


def translated(kernel: Any, key: tuple[str, ...]) -> Prepared:
    """Translate a kernel for arguments of one kind.

    Parameters
    ----------
    kernel : a `featreg.runtime.jit.Kernel`
    key : kinds of its arguments, as `featreg.runtime.precompiled.key_of` gives them

    Raises
    ------
    ValueError
        It needs something of numba's or Python's that is not there when it runs.
    """
    function, dispatcher = kernel.function, kernel.dispatcher
    typing, target = cpu_target.typing_context, cpu_target.target_context
    typing.refresh()
    target.refresh()
    arguments = tuple(_type(kind) for kind in key)
    flags = compiler.Flags()
    flags.nrt = True
    flags.error_model = "numpy"
    flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
    with _without_optimisation():
        made = compiler.compile_extra(typing, target, dispatcher.py_func, arguments, None, flags, {})
        told = "\n".join((function.__module__, function.__name__, *key))
        symbol = f"{function.__name__}_{hashlib.sha256(told.encode()).hexdigest()[:16]}"
        library = target.codegen().create_library(symbol)
        module, result = _entry(target, made, symbol)
        library.add_ir_module(module)
        library.add_linking_library(made.library)
        final = library._final_module
        for linked in dict.fromkeys(library._linking_libraries):
            final.link_in(linked._get_module_for_linking(), preserve=True)
    final = _disjoint(final, function)
    memory = llvm.parse_assembly(_MEMORY)
    memory.triple, memory.data_layout = final.triple, final.data_layout
    final.link_in(memory)
    for thing in (*final.functions, *final.global_variables):
        if not thing.is_declaration and thing.name != symbol:
            thing.linkage = "internal"
    if kernel.compact:
        for part in final.functions:
            if not part.is_declaration:
                part.add_function_attribute("optsize")
    _keep_loops_apart(final)
    outputs = _outputs(final, function, made.fndesc.llvm_func_name, key)
    _prune(final)
    needed = {f.name for f in final.functions if f.is_declaration and not f.name.startswith("llvm.")}
    needed |= {g.name for g in final.global_variables if g.is_declaration}
    if strange := needed - C_LIBRARY:
        raise ValueError(f"{function.__name__} of {', '.join(key)} needs {', '.join(sorted(strange))}")
    return Prepared(key, result, symbol, outputs, bytes(final.as_bitcode()))


def llvm_version() -> list[int]:
    """The version of LLVM whose code this is."""
    return list(llvm.llvm_version_info)


def triple() -> str:
    """The system for which it is."""
    return str(llvm.get_process_triple())


@contextlib.contextmanager
def _without_optimisation() -> Iterator[None]:
    """numba optimises what is called for this processor before it is linked into what calls it: not now."""
    kind = codegen.CPUCodeLibrary
    before = kind._optimize_final_module
    kind._optimize_final_module = lambda self: None
    try:
        yield
    finally:
        kind._optimize_final_module = before


def _disjoint(module: Any, function: Callable[..., Any]) -> Any:
    """Tell LLVM of the kernel's helpers that are declared `disjoint` that their arrays share no memory."""
    names = [one.function.__name__ for one in function.__globals__.values() if getattr(one, "disjoint", False)]
    if not names:
        return module
    lines = str(module).split("\n")
    for k, line in enumerate(lines):
        if line.startswith("define ") and OWN in line and any(f"{len(name)}{name}" in line for name in names):
            lines[k] = _SAMPLES.sub(r"ptr noalias \1", line)
    return llvm.parse_assembly("\n".join(lines))


def _keep_loops_apart(module: Any) -> None:
    """Leave helpers of kernels that hold loops functions of their own when all else is inlined.

    Once a loop is part of a larger one, LLVM no longer proves that what it reads and writes does not overlap, and does
    not vectorise it.
    """
    for function in module.functions:
        if function.linkage.name == "internal" and function.name.startswith(OWN) and _has_loop(function):
            function.add_function_attribute("noinline")


def _has_loop(function: Any) -> bool:
    """Whether its blocks go round in a circle."""
    leads_to: dict[str, set[str]] = {}
    block = ""
    for line in str(function).splitlines():
        if label := _LABEL.match(line):
            block = label[1]
        leads_to.setdefault(block, set()).update(_TARGET.findall(line))
    try:
        TopologicalSorter(leads_to).prepare()
    except CycleError:
        return True
    return False


def _outputs(module: Any, function: Callable[..., Any], native: str, key: tuple[str, ...]) -> tuple[int, ...]:
    """Places of the arrays whose samples a kernel may write: all but those of which LLVM knows that it only reads."""
    copy = module.clone()
    # By itself and called from outside, the kernel keeps its arguments, and LLVM says of each what is done with it.
    kernel = copy.get_function(native)
    kernel.linkage = "external"
    kernel.add_function_attribute("noinline")
    _prune(copy)
    told = {
        argument.name: set(b" ".join(argument.attributes).decode().split())
        for argument in copy.get_function(native).arguments
    }
    names = function.__code__.co_varnames[: len(key)]
    return tuple(
        place
        for place, (name, kind) in enumerate(zip(names, key, strict=True))
        if ":" in kind and not told[f"arg.{name}.4"] & {"readonly", "readnone"}
    )


def _prune(module: Any) -> None:
    """Inline, drop what nothing calls and the reference counts that cancel: numba's first passes."""
    target = llvm.Target.from_triple(module.triple).create_target_machine(opt=3)
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    options.loop_vectorization = options.slp_vectorization = False
    options.loop_unrolling = False
    builder = llvm.create_pass_builder(target, options)
    passes = builder.getModulePassManager()
    passes.add_loop_rotate_pass()
    passes.add_instruction_combine_pass()
    passes.add_jump_threading_pass()
    passes.add_refprune_pass()
    passes.run(module, builder)


def _type(kind: str) -> Any:
    dtype, *layout = kind.split(":")
    if not layout:
        return _NUMBERS[kind]
    return types.Array(from_dtype(np.dtype(dtype)), int(layout[0]), "A" if layout[1:] else "C")


def _entry(target: Any, made: Any, symbol: str) -> tuple[Any, str]:
    """A function of C's that takes where the result goes, arrays as Python objects and numbers; returns the status."""
    module = ir.Module(symbol)
    module.triple = target.codegen()._tm.triple
    described = made.fndesc
    native = ir.Function(
        module, target.call_conv.get_function_type(described.restype, described.argtypes), described.llvm_func_name
    )
    pointer, word = ir.IntType(8).as_pointer(), ir.IntType(64)
    kinds = [pointer if isinstance(t, types.Array) else target.get_argument_type(t) for t in described.argtypes]
    entry = ir.Function(module, ir.FunctionType(ir.IntType(32), [pointer, *kinds]), symbol)
    builder = ir.IRBuilder(entry.append_basic_block())
    values = []
    for kind, given in zip(described.argtypes, entry.args[1:], strict=True):
        if isinstance(kind, types.Array):
            values.append(_array(target, builder, kind, given))
        else:
            values.append(target.data_model_manager[kind].from_argument(builder, given))
    status, found = target.call_conv.call_function(builder, native, described.restype, described.argtypes, values)
    result = _stored(builder, described.restype, found, builder.bitcast(entry.args[0], word.as_pointer()))
    builder.ret(status.code)
    return module, result


def _array(target: Any, builder: Any, kind: Any, given: Any) -> Any:
    """The array of numba's that is the one of numpy's at an address."""
    word = ir.IntType(64)

    def field(offset: int) -> Any:
        return builder.load(builder.bitcast(builder.gep(given, [word(offset)]), word.as_pointer()))

    def row(offset: int) -> Any:
        start = builder.inttoptr(field(offset), word.as_pointer())
        return [builder.load(builder.gep(start, [word(i)])) for i in range(kind.ndim)]

    array = target.make_array(kind)(target, builder)
    populate_array(
        array,
        data=builder.inttoptr(field(DATA), array.data.type),
        shape=cgutils.pack_array(builder, row(EXTENTS)),
        strides=cgutils.pack_array(builder, row(STRIDES)),
        itemsize=word(target.get_abi_sizeof(target.get_data_type(kind.dtype))),
        meminfo=None,
    )
    return array._getvalue()


def _stored(builder: Any, kind: Any, value: Any, place: Any) -> str:
    """Store a result as eight bytes where it goes; returns its kind."""
    word = ir.IntType(64)
    if kind in (types.none, types.void):
        return ""
    if isinstance(kind, types.Boolean):
        builder.store(builder.zext(value, word) if value.type.width < 64 else value, place)
        return "bool"
    if isinstance(kind, types.Integer):
        wide = builder.sext if str(kind).startswith("int") else builder.zext
        builder.store(wide(value, word) if value.type.width < 64 else value, place)
        return "int"
    if isinstance(kind, types.Float):
        wide = builder.fpext(value, ir.DoubleType()) if kind.bitwidth == 32 else value
        builder.store(wide, builder.bitcast(place, ir.DoubleType().as_pointer()))
        return "float"
    raise ValueError(f"a result of type {kind} cannot be handed over: write it into an array")
