"""Kernels that were translated beforehand: the bits of numba's own, and numba where they do not serve."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import zlib
from pathlib import Path
from types import FunctionType
from typing import Any, cast

import numpy as np
import pytest

import featreg
from featreg.runtime import calling, jit, kernel_sources, machine, precompiled
from featreg.runtime.kernel_sources import source_digest
from featreg.runtime.machine import Machine
from featreg.runtime.preparing import LIST
from featreg.sar.keypoints import binary_kernels, corner_kernels, hamming_kernels, motion_kernels
from featreg.warming import stale_kernels

#: Kernels whose source was changed compile when they are called, until they are translated again.
CHANGED = stale_kernels()
LLVM = pytest.importorskip("llvmlite.binding")


def in_place(module: Any) -> None:
    if module.__name__ in CHANGED:
        pytest.skip(f"{module.__name__} was changed: `make kernels` translates it again")


def test_the_files_hold_every_kernel_that_the_default_method_calls() -> None:
    for module, name in ((hamming_kernels, "nearest_by_slices"), (binary_kernels, "nearest_hamming")):
        kernel: Any = getattr(module, name)
        listed = [entry for entry in precompiled.listed(kernel.path) if entry["kernel"] == name]
        assert listed, f"{name} is not prepared: make kernels"
        assert all(entry["key"] for entry in listed)


def test_the_files_hold_every_kernel_that_is_listed() -> None:
    """One that raises, or makes arrays that are not of a fixed kind, cannot be translated: it would compile later."""
    package = Path(featreg.__file__).parents[1]
    missing = []
    for module, kernels in json.loads(LIST.read_text(encoding="utf-8")).items():
        if module in CHANGED:
            continue
        path = package.joinpath(*module.split(".")).with_suffix(".py")
        held = [(entry["kernel"], entry["key"]) for entry in precompiled.listed(path)]
        missing += [
            f"{module}.{name}({key})" for name, keys in kernels.items() for key in keys if (name, key) not in held
        ]
    assert missing == []


def test_prepared_code_gives_the_bits_of_numba() -> None:
    """Also where the arrays of a helper are declared not to overlap, which numba does not tell LLVM."""
    in_place(hamming_kernels)
    rng = np.random.default_rng(0)
    reference, secondary = (rng.integers(0, 2**63, (n, 4), dtype=np.uint64) for n in (300, 250))
    slices = np.zeros((1, (64 * 4 + 1) * hamming_kernels.LANES), np.uint64)
    hamming_kernels.slice_bits(secondary, slices)
    ours, numbas = ([np.zeros(n, np.uint64) for n in (hamming_kernels.MEMORY, 300, 250)] for _ in range(2))
    kernel: Any = hamming_kernels.nearest_by_slices
    bound = precompiled.prepared(kernel, precompiled.key_of((reference, slices, *ours)))
    assert bound is not None
    values = (reference, slices, *ours)
    assert bound.quick(*values) == bound(values) == kernel.dispatcher(reference, slices, *numbas)
    for mine, theirs in zip(ours, numbas, strict=True):
        assert mine.tobytes() == theirs.tobytes()
    bits = np.unpackbits((reference[:5, None] ^ secondary).view(np.uint8), axis=2).sum(axis=2)
    assert (ours[1][:5] >> np.uint64(32)).tolist() == bits.min(axis=1).tolist()


def test_arrays_that_may_not_be_written_are_refused_as_numba_does() -> None:
    """Where they are only read they are served: memory maps, broadcast views and arrays that somebody locked."""
    in_place(corner_kernels)
    numba_errors = pytest.importorskip("numba.core.errors")
    kernel: Any = jit.Kernel(cast(Any, corner_kernels.in_order).function, "never")
    known: dict[str, Any] = {"at": np.array([4, 7, 2]), "values": np.array([3, 9, 5], np.uint8), "width": 3}
    known |= {"xy": np.zeros((2, 2), np.int64), "score": np.zeros(2, np.uint8)}

    def locked(name: str) -> dict[str, Any]:
        other = np.array(known[name])
        other.flags.writeable = False
        return known | {name: other}

    for _ in range(2):
        for name in ("at", "values"):
            kernel(*locked(name).values())
            assert known["score"].tolist() == [9, 5]
            assert known["xy"].tolist() == [[1, 2], [2, 0]]
            known["xy"][:], known["score"][:] = 0, 0
        assert kernel._dispatcher is None
    for _ in range(2):
        for name in ("xy", "score"):
            given = locked(name)
            with pytest.raises(numba_errors.TypingError, match="readonly"):
                kernel(*given.values())
            assert not given[name].any()
        kernel(*known.values())
        known["xy"][:], known["score"][:] = 0, 0
    assert len(kernel._bound) == 1


def test_code_that_only_numba_makes_is_left_to_it(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in precompiled.OTHER_CODE:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.delenv("FEATREG_KERNELS", raising=False)
    assert not precompiled.left_to_numba()
    for name, value in {"NUMBA_BOUNDSCHECK": "1", "NUMBA_SLP_VECTORIZE": "1", "NUMBA_OPT": "0"}.items():
        monkeypatch.setenv(name, value)
        assert precompiled.left_to_numba()
        assert precompiled.current(cast(Any, corner_kernels.in_order)) == []
        monkeypatch.setenv(name, precompiled.OTHER_CODE[name])
        assert not precompiled.left_to_numba()


def test_the_processor_is_the_one_that_numba_makes_code_for(monkeypatch: pytest.MonkeyPatch) -> None:
    codegen, config = (pytest.importorskip(f"numba.core.{name}") for name in ("codegen", "config"))
    cases: list[dict[str, str]] = [
        {}, {"ENABLE_AVX": "0"}, {"ENABLE_AVX": "1", "CPU_NAME": "sandybridge"}, {"CPU_NAME": "sandybridge"},
        {"CPU_NAME": "generic"}, {"CPU_NAME": "haswell", "CPU_FEATURES": "+avx2"}, {"CPU_FEATURES": ""},
    ]  # fmt: skip
    for case in cases:
        with monkeypatch.context() as patch:
            for name in ("ENABLE_AVX", "CPU_NAME", "CPU_FEATURES"):
                patch.delenv(f"NUMBA_{name}", raising=False)
            for name, value in case.items():
                patch.setenv(f"NUMBA_{name}", value)
            config.reload_config()
            made = codegen.JITCPUCodegen.__new__(codegen.JITCPUCodegen)
            numbas = made._get_host_cpu_name(), made._get_host_cpu_features()
            assert machine._processor(LLVM) == numbas, case
    config.reload_config()


def test_machine_code_of_another_processor_is_left_aside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What lies ready is used without anything made or kept; else LLVM's code is optimised, and the object kept."""
    in_place(motion_kernels)
    monkeypatch.setattr(machine, "folder", lambda: tmp_path)
    kernel: Any = motion_kernels.matches_of_turns
    entry = precompiled.current(kernel)[0]
    key, content = tuple(entry["key"]), precompiled.file_of(kernel.path).read_bytes()
    header, _, body = content.partition(b"\n")
    start, size = entry["made"]
    damaged = body[:start] + bytes(size) + body[start + size :]
    here = json.dumps(json.loads(header) | {"machine": Machine().identity}).encode() + b"\n"
    other = json.dumps(json.loads(header) | {"machine": "of another"}).encode() + b"\n"
    if json.loads(header)["machine"] == Machine().identity:
        assert precompiled.prepared(kernel, key) is not None
        assert not list(tmp_path.iterdir())
    for number, text in enumerate((other + body, here + damaged)):
        path = tmp_path / f"{number}_kernels.py"
        path.write_bytes(kernel.path.read_bytes())
        path.with_suffix(".bc").write_bytes(text)
        monkeypatch.setattr(precompiled, "_digest", lambda _: entry["source"])
        monkeypatch.setattr(machine, "machine", Machine)
        assert precompiled.prepared(changed(kernel, path), key) is not None
        assert len(list(tmp_path.glob("*.o"))) == 1


def test_arguments_of_another_kind_are_no_call_of_it() -> None:
    in_place(motion_kernels)
    kernel: Any = motion_kernels.matches_of_turns
    entry = precompiled.current(kernel)[0]
    bound = precompiled.prepared(kernel, tuple(entry["key"]))
    assert bound is not None
    assert bound((1,)) is calling.MISS
    assert bound(tuple("wrong" for _ in entry["key"])) is calling.MISS
    assert precompiled.prepared(kernel, ("f4:1",)) is None


def test_numbers_beyond_64_bits_are_errors_from_the_first_call_on() -> None:
    in_place(binary_kernels)
    words, nearest = np.zeros((4, 4), np.uint64), [np.zeros(4, np.uint64) for _ in range(2)]
    kernel: Any = jit.Kernel(cast(Any, binary_kernels.nearest_hamming).function, "never")
    for _ in range(2):
        with pytest.raises(OverflowError):
            kernel(words, words, 2**63, *nearest)
        kernel(words, words, 128, *nearest)


def test_code_of_a_newer_llvm_is_not_prepared_here(monkeypatch: pytest.MonkeyPatch) -> None:
    in_place(binary_kernels)
    kernel: Any = binary_kernels.nearest_hamming
    assert precompiled.prepared_here(kernel)
    monkeypatch.setattr(Machine, "takes", lambda *_: False)
    assert not precompiled.prepared_here(kernel)


def test_a_kernel_that_another_thread_bound_meanwhile_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two threads make the first call: the second waits for the first, and must not go to numba."""

    @jit.compiled
    def kernel(value: float) -> float:
        return -value

    class Ready:
        """Stands for machine code."""

        def fits(self, values: tuple[Any, ...]) -> bool:
            return True

        def __call__(self, values: tuple[Any, ...]) -> float:
            return float(10 * values[0])

    held: Any = kernel
    monkeypatch.setattr(jit, "_jit", lambda *_: pytest.fail("numba was asked"))
    monkeypatch.setattr(held, "_bound", (Ready(),))
    assert held._first((2.0,)) == 20.0


def test_kinds_of_arguments() -> None:
    image = np.zeros((4, 6), np.float32)
    values = (image, image[:, ::2], 3, np.int64(3), 2.0, True, np.float32(1), np.zeros(2, np.bool_))
    kinds = ("f4:2", "f4:2:A", "int", "int", "float", "bool", "float32", "b1:1")
    assert precompiled.key_of(values) == kinds
    assert precompiled.key_of((image.astype(">f4"),)) is None
    assert precompiled.key_of(((image, image),)) is None


def changed(kernel: Any, path: Path) -> Any:
    """The same kernel as of another file."""
    code = kernel.function.__code__.replace(co_filename=str(path))
    return jit.Kernel(FunctionType(code, kernel.function.__globals__, kernel.function.__name__), "never")


def test_a_changed_source_and_a_damaged_file_are_left_to_numba(tmp_path: Path) -> None:
    in_place(corner_kernels)
    kernel: Any = corner_kernels.in_order  # of no other kernel, whose file would be another
    entry = precompiled.current(kernel)[0]
    source, content = kernel.path.read_bytes(), precompiled.file_of(kernel.path).read_bytes()
    for number, (text, kept, serves) in enumerate(
        (
            (source, content, True),
            (source + b"#", content, False),
            (source, b"", False),
            (source, content.partition(b"\n")[0] + b"\n" + bytes(len(content)), False),
            (source, content.replace(b'"llvm":[', b'"llvm":[9'), False),
        )
    ):
        path = tmp_path / f"{number}_kernels.py"
        path.write_bytes(text)
        path.with_suffix(".bc").write_bytes(kept)
        other = changed(kernel, path)
        found = precompiled.prepared(other, tuple(entry["key"]))
        assert (found is not None) is serves, number


def test_without_machine_code_it_is_made_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As of a file that was written with FEATREG_KERNELS=bitcode, on the machine where it is read."""
    in_place(corner_kernels)
    monkeypatch.setattr(machine, "folder", lambda: tmp_path)
    kernel: Any = corner_kernels.in_order
    content = precompiled.file_of(kernel.path).read_bytes()
    header, body = json.loads(content.partition(b"\n")[0]), content.partition(b"\n")[2]
    entry = precompiled.current(kernel)[0]
    start, size = entry["at"]
    key = tuple(entry["key"])
    code = zlib.decompress(body[start : start + size])
    bare = precompiled.Prepared(key, entry["result"], entry["symbol"], tuple(entry["outputs"]), code)
    path = tmp_path / "bare_kernels.py"
    path.write_bytes(kernel.path.read_bytes())
    entries = {("in_order", entry["source"]): [bare]}
    path.with_suffix(".bc").write_bytes(precompiled.written(entries, header["llvm"], header["triple"]))
    monkeypatch.setattr(precompiled, "_digest", lambda _: entry["source"])
    found = precompiled.prepared(changed(kernel, path), key)
    assert found is not None
    xy, score = np.zeros((2, 2), np.int64), np.zeros(2, np.uint8)
    found((np.array([4, 7, 2]), np.array([3, 9, 5], np.uint8), 3, xy, score))
    assert score.tolist() == [9, 5]
    assert len(list(tmp_path.glob("*.o"))) == 1


def test_a_digest_is_of_all_that_a_kernel_calls_also_through_others_of_its_module(tmp_path: Path) -> None:
    outer, inner = (tmp_path / f"{name}_kernels.py" for name in ("outer", "inner"))
    outer.write_text("def called(x):\n    return between(x)\ndef between(x):\n    return deep(x)\n")
    inner.write_text("def deep(x):\n    return called(x) if x else x\n")
    scope: dict[str, Any] = {}
    for path in (outer, inner):
        made: dict[str, Any] = {}
        exec(compile(path.read_text(), str(path), "exec"), made)  # what stands above
        for name in {"called", "between", "deep"} & made.keys():
            function = FunctionType(made[name].__code__, scope, name)
            scope[name] = jit.Kernel(function, "never")
    before = [source_digest(scope[name]) for name in ("called", "between", "deep")]
    inner.write_text(inner.read_text() + "#")
    after = [source_digest(scope[name]) for name in ("called", "between", "deep")]
    assert all(one != other for one, other in zip(before, after, strict=True))


def test_what_another_translator_made_is_left_to_numba(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    in_place(corner_kernels)
    kernel: Any = corner_kernels.in_order
    of_this = source_digest(kernel)
    assert [entry["source"] for entry in precompiled.current(kernel)] == [of_this]
    other = tmp_path / "precompiling.py"
    other.write_bytes(kernel_sources.TRANSLATOR.read_bytes())
    monkeypatch.setattr(kernel_sources, "TRANSLATOR", other)
    assert source_digest(kernel) == of_this
    other.write_bytes(other.read_bytes() + b"#")
    monkeypatch.setattr(precompiled, "_digest", source_digest)
    assert source_digest(kernel) != of_this
    assert precompiled.current(kernel) == []


def test_an_object_of_other_last_passes_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    in_place(motion_kernels)
    monkeypatch.setattr(machine, "folder", lambda: tmp_path)
    kernel: Any = motion_kernels.matches_of_turns
    entry, body = precompiled.current(kernel)[0], precompiled.file_of(kernel.path).read_bytes().partition(b"\n")[2]
    start, size = entry["at"]
    for number in (1, 1, 2):
        monkeypatch.setattr(machine, "_own_digest", lambda number=number: str(number))
        found = Machine().addresses(
            entry["symbol"], body[start : start + size], tuple(entry["key"]), entry["result"], tuple(entry["outputs"])
        )
        assert found
    assert len(list(tmp_path.iterdir())) == 2


def test_an_object_that_was_cut_short_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    in_place(motion_kernels)
    monkeypatch.setattr(machine, "folder", lambda: tmp_path)
    here = Machine()
    kernel: Any = motion_kernels.matches_of_turns
    entry, body = precompiled.current(kernel)[0], precompiled.file_of(kernel.path).read_bytes().partition(b"\n")[2]
    start, size = entry["at"]
    told = entry["symbol"], body[start : start + size], tuple(entry["key"]), entry["result"], tuple(entry["outputs"])
    assert here.addresses(*told)
    (kept,) = tmp_path.iterdir()
    whole = kept.read_bytes()
    kept.write_bytes(whole[: len(whole) // 2])
    assert Machine().addresses(*told)
    assert kept.read_bytes() == whole


def test_a_registration_needs_no_numba() -> None:
    if CHANGED:
        pytest.skip(f"changed: {', '.join(CHANGED)}; `make kernels` translates them again")
    code = (
        "import json, sys, featreg\nfrom featreg.simulate import sar_pair\np = sar_pair((300, 300), seed=1)\n"
        "r = featreg.match(p.reference, p.secondary, seed=0)\n"
        "heavy = ('numba', 'featreg.focusing', 'featreg.detectors.kornia', 'matplotlib', 'pandas')\n"
        "print(json.dumps([r.status, [name for name in heavy if name in sys.modules]]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == ["ok", []]


def test_loops_of_helpers_stay_apart_so_that_they_become_vectors() -> None:
    """Inside a larger loop LLVM does not prove that arrays do not overlap; such code took five times as long."""
    from featreg.sar.gradients import ratio_kernels

    in_place(ratio_kernels)
    kernel: Any = ratio_kernels.log_ratios
    content = precompiled.file_of(kernel.path).read_bytes().partition(b"\n")[2]
    for entry in precompiled.current(kernel):
        start, size = entry["at"]
        module = LLVM.parse_bitcode(zlib.decompress(content[start : start + size]))
        own = [function.name for function in module.functions if function.name.startswith("_ZN7featreg")]
        assert any("four_sums" in name for name in own)
        assert not any("fast_log" in name for name in own)


def test_the_compiler_knows_which_helpers_have_arrays_that_share_no_memory() -> None:
    in_place(hamming_kernels)
    kernel: Any = hamming_kernels.nearest_by_slices
    content = precompiled.file_of(kernel.path).read_bytes().partition(b"\n")[2]
    for entry in precompiled.current(kernel):
        start, size = entry["at"]
        module = LLVM.parse_bitcode(zlib.decompress(content[start : start + size]))
        counts = {
            name: len(re.findall(r"ptr noalias [\w() ]*%arg", next(str(f) for f in module.functions if name in f.name)))
            for name in ("11_add_slices", "13_count_slices")
        }
        assert counts == {"11_add_slices": 3, "13_count_slices": 0}


def test_the_processor_is_the_one_that_numba_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CPU_NAME", "x86-64-v3")
    monkeypatch.setenv("NUMBA_CPU_FEATURES", "+avx2,-avx512f")
    told = Machine()
    assert told.processor == ("x86-64-v3", "+avx2,-avx512f")
    monkeypatch.setattr(machine, "machine", lambda: told)
    assert [machine.processor_has(name) for name in ("avx2", "avx512f", "avx")] == [True, False, False]
    monkeypatch.setattr(machine, "machine", lambda: None)
    assert not machine.processor_has("avx2")
    # Only the generic processor lacks what the one at hand has.
    monkeypatch.delenv("NUMBA_CPU_FEATURES")
    assert Machine().processor[1] == LLVM.get_host_cpu_features().flatten()
    monkeypatch.setenv("NUMBA_CPU_NAME", "generic")
    assert Machine().processor == ("generic", "")
