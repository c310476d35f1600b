"""What was prepared otherwise, or is not whole any more, is left to numba or made again."""

from __future__ import annotations

import json
import zlib
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np
import pytest

from featreg.runtime import jit, kernel_sources, machine, precompiled
from featreg.runtime.kernel_sources import source_digest
from featreg.runtime.machine import Machine
from featreg.sar.keypoints import corner_kernels, motion_kernels
from made.prepared import changed, in_place


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
