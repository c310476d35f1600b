"""Machine code of prepared kernels: for which processor it is made, and what the compiler knows of loops."""

from __future__ import annotations

import json
import re
import zlib
from pathlib import Path
from typing import Any

import pytest

from featreg.runtime import machine, precompiled
from featreg.runtime.machine import Machine
from featreg.sar.keypoints import binary_kernels, hamming_kernels, motion_kernels
from made.prepared import changed, in_place

LLVM = pytest.importorskip("llvmlite.binding")


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


def test_code_of_a_newer_llvm_is_not_prepared_here(monkeypatch: pytest.MonkeyPatch) -> None:
    in_place(binary_kernels)
    kernel: Any = binary_kernels.nearest_hamming
    assert precompiled.prepared_here(kernel)
    monkeypatch.setattr(Machine, "takes", lambda *_: False)
    assert not precompiled.prepared_here(kernel)


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
