"""What a kernel is compiled from: every value that it reads counts, wherever it was imported from."""

from __future__ import annotations

from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import numpy as np
import pytest

from featreg import warming
from featreg.runtime import jit, precompiled
from featreg.runtime.kernel_sources import source_digest

KERNEL = "def kernel(x):\n    return helper(x) + values.STEP\n"
HELPER = "def helper(x):\n    return x * WIDTH\n"


def kernel_of(folder: Path, width: Any, step: Any = 1) -> Any:
    """A kernel that calls another one; WIDTH stands in neither of their files, nor does STEP."""
    values = ModuleType("values")
    vars(values).update({"STEP": step, "UNREAD": False})
    scope: dict[str, Any] = {"__name__": "probe_kernels", "WIDTH": width, "values": values, "unread": step}
    for name, text in (("helper", HELPER), ("kernel", KERNEL)):
        path = folder / f"{name}_kernels.py"
        if not path.exists():
            path.write_text(text)
        exec(compile(text, str(path), "exec"), scope)  # what stands above
        scope[name] = jit.Kernel(scope[name], "never")
    return scope["kernel"]


@pytest.mark.parametrize(
    ("width", "other"),
    [
        (64, 32), (1, 1.0), (1, True), (1, np.int64(1)), (np.float32(0.1), np.float64(np.float32(0.1))), (0.0, -0.0),
        ((1, 2), (2, 1)), ((1, (2, 3)), ((1, 2), 3)), (np.arange(3), np.arange(3.0)),
    ],
)  # fmt: skip
def test_a_value_that_a_helper_imports_is_in_the_digest(tmp_path: Path, width: Any, other: Any) -> None:
    before = source_digest(kernel_of(tmp_path, width))
    assert before == source_digest(kernel_of(tmp_path, width))
    assert before != source_digest(kernel_of(tmp_path, other))


def test_a_value_inside_a_module_is_in_the_digest_and_what_is_not_read_is_not(tmp_path: Path) -> None:
    kernel = kernel_of(tmp_path, 64, 1)
    before = source_digest(kernel)
    scope = kernel.function.__globals__
    scope["unread"], scope["values"].UNREAD = 2, True
    assert source_digest(kernel) == before
    scope["values"].STEP = 2
    assert source_digest(kernel) != before


def test_which_of_two_kernels_a_name_stands_for_is_in_the_digest(tmp_path: Path) -> None:
    kernel = kernel_of(tmp_path, 64)
    before = source_digest(kernel)
    kernel.function.__globals__["helper"] = kernel
    assert source_digest(kernel) != before


def test_how_a_helper_is_compiled_is_in_the_digest(tmp_path: Path) -> None:
    kernel = kernel_of(tmp_path, 64)
    before = source_digest(kernel)
    kernel.function.__globals__["helper"].disjoint = True
    assert source_digest(kernel) != before


def test_what_has_no_certain_content_has_no_digest_and_is_not_kept(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    pytest.importorskip("numba")
    assert source_digest(kernel_of(tmp_path, object())) == ""
    caplog.clear()
    jit._jit(FunctionType(_doubled.__code__, {}, "_doubled"), "never", "")
    assert "is not kept" in caplog.text


def _doubled(value: float) -> float:
    return 2 * value


def test_a_kernel_that_was_typed_in_has_a_digest_of_its_code() -> None:
    digests = []
    for text in ("def kernel(x):\n    return x + 1\n", "def kernel(x):\n    return x + 2\n"):
        scope: dict[str, Any] = {"__name__": "__main__"}
        exec(compile(text, "<typed in>", "exec"), scope)  # what stands above
        digests.append(source_digest(jit.Kernel(scope["kernel"], "never")))
    assert digests[0] != digests[1]
    assert "" not in digests


def test_a_helper_that_was_typed_in_is_in_the_digest() -> None:
    digests = []
    for factor in (2, 2, 3):
        scope: dict[str, Any] = {"__name__": "__main__"}
        for name, text in (("helper", f"def helper(x):\n    return {factor} * x\n"), ("kernel", KERNEL)):
            exec(compile(text, f"<{name}>", "exec"), scope)  # what stands above
            scope[name] = jit.Kernel(scope[name], "never")
        scope["values"] = ModuleType("values")
        digests.append(source_digest(scope["kernel"]))
    assert digests[0] == digests[1] != digests[2]


def test_every_kernel_of_this_package_has_a_digest() -> None:
    kernels: list[Any] = [
        kernel for module in warming._kernel_modules() for kernel in warming._kernels(module).values()
    ]
    assert len(kernels) > 300
    assert [f"{kernel.__module__}.{kernel.__name__}" for kernel in kernels if not source_digest(kernel)] == []


def test_prepared_code_is_not_used_after_a_value_changed_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    from featreg.geolocation import ground_kernels

    kernel: Any = ground_kernels.ground_of
    if not precompiled.current(kernel):
        pytest.skip("`make kernels` translates it")
    monkeypatch.setattr(precompiled, "_digest", source_digest)
    assert precompiled.current(kernel)
    monkeypatch.setitem(kernel.function.__globals__, "CHUNK", 7)
    assert precompiled.current(kernel) == []


def test_of_a_kernel_without_a_digest_nothing_is_prepared(monkeypatch: pytest.MonkeyPatch) -> None:
    from featreg.geolocation import ground_kernels

    kernel: Any = ground_kernels.ground_of
    monkeypatch.setattr(precompiled, "listed", lambda _: [{"kernel": "ground_of", "source": ""}])
    monkeypatch.setattr(precompiled, "_digest", lambda _: "")
    assert precompiled.current(kernel) == []


def test_what_numba_kept_is_not_used_after_a_value_changed_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """numba itself looks at the file of the function alone."""
    pytest.importorskip("numba")
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    results = [kernel_of(tmp_path, width)(np.float64(2.0)) for width in (3, 5, 3)]
    assert results == [7.0, 11.0, 7.0]
    assert {path.name.partition("-")[0].rpartition("_")[0] for path in tmp_path.rglob("*.nbi")} == {
        "helper_kernels.helper", "kernel_kernels.kernel",
    }  # fmt: skip
