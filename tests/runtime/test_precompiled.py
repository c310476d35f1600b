"""Kernels that were translated beforehand: the bits of numba's own, and its errors."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

import featreg
from featreg.runtime import calling, jit, precompiled
from featreg.runtime.preparing import LIST
from featreg.sar.keypoints import binary_kernels, corner_kernels, hamming_kernels, motion_kernels
from made.prepared import CHANGED, in_place


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
