"""Damaged files are results or our own errors, never anything else: the short form of `benchmarks/fuzz.py`."""

from __future__ import annotations

import struct
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError
from featreg.io import as_image
from featreg.io.mat_structure import check_mat
from featreg.runtime.numpy_files import load_array, load_arrays

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
TRIALS, SEED = 8, 2026
KINDS = (
    "images", "windows", "masks", "elevation models", "RPC files", "phase histories", "tie points", "marked points",
    "truths", "experiments", "results", "block files", "formats",
)  # fmt: skip


@pytest.fixture(scope="module")
def fuzz() -> Any:
    sys.path.insert(0, str(BENCHMARKS))
    try:
        import fuzz
    finally:
        sys.path.remove(str(BENCHMARKS))
    return fuzz


@pytest.fixture(scope="module")
def sound(fuzz: Any, tmp_path_factory: pytest.TempPathFactory) -> list[Any]:
    sys.path.insert(0, str(BENCHMARKS))
    try:
        return list(fuzz.seeds(tmp_path_factory.mktemp("sound")))
    finally:
        sys.path.remove(str(BENCHMARKS))


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_are_read_or_refused(kind: str, fuzz: Any, sound: list[Any], tmp_path: Path) -> None:
    mine = [seed for seed in sound if seed.kind == kind]
    assert mine
    for seed in mine:
        assert fuzz.outcome(seed.read, seed.path) == "read"
        for number in range(TRIALS):
            path = fuzz.trial(seed, number, SEED, tmp_path / f"{seed.path.name}-{number}")
            start = time.process_time()
            assert fuzz.outcome(seed.read, path) in ("read", "refused"), (seed.damaged.name, number)
            assert time.process_time() - start < fuzz.LONGEST_S


def test_every_kind_is_damaged(sound: list[Any]) -> None:
    assert {seed.kind for seed in sound} == set(KINDS)


def test_damage_follows_from_the_seed(fuzz: Any) -> None:
    content = b"1.5, 2.5\n3.5, 4.5\n" * 20

    def made(seed: int) -> list[bytes]:
        return [fuzz.damaged(content, np.random.default_rng([seed, k]), text=k % 2 == 0) for k in range(20)]

    assert made(0) == made(0)
    assert made(0) != made(1)
    assert sum(one != content for one in made(0)) > 15


def test_faults_are_told_apart(fuzz: Any, tmp_path: Path) -> None:
    """A reader that hangs, one that takes memory, one that ends its process, one with an error of another kind."""
    import os

    path = tmp_path / "sound" / "a.csv"
    path.parent.mkdir()
    path.write_text("1,2,3,4\n")

    def wrong(_: Path) -> None:
        raise KeyError("x")

    readers = [lambda _: None, wrong, lambda _: os._exit(1), lambda _: time.sleep(60)]
    seeds = [fuzz.Seed("k", path, reader, path) for reader in readers]
    old, fuzz.LONGEST_S = fuzz.LONGEST_S, 0.2
    try:
        found = list(fuzz.watched([(seed, 0) for seed in [*seeds, seeds[0]]], 0, tmp_path / "trial"))
    finally:
        fuzz.LONGEST_S = old
    assert [trial.fault for trial in found] == ["", "KeyError: 'x'", "crash", "hang", ""]


# What was found


def test_a_header_of_numpy_that_is_cut_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    np.save(path, np.ones((20, 20)))
    content = path.read_bytes()
    path.write_bytes(content.replace(b"}", b" ", 1))
    with pytest.raises(ValueError, match="damaged"):
        load_array(path)
    with pytest.raises(InputError, match="broken or cut short"):
        as_image(path)
    np.savez(tmp_path / "b.npz", a=np.ones(3))
    assert list(load_arrays(tmp_path / "b.npz")) == ["a"]
    for wrong in (lambda: load_array(tmp_path / "b.npz"), lambda: load_arrays(tmp_path / "c.npy")):
        np.save(tmp_path / "c.npy", np.ones(3))
        with pytest.raises(ValueError, match="is needed"):
            wrong()


def matlab(path: Path, compressed: bool = False, **arrays: Any) -> bytes:
    from scipy.io import savemat

    savemat(path, arrays, do_compression=compressed)
    return path.read_bytes()


@pytest.mark.parametrize("compressed", [False, True])
def test_whole_matlab_files_pass(compressed: bool, tmp_path: Path) -> None:
    from scipy.sparse import csc_array

    tree = {"a": {"b": 1.5, "c": "text"}, "empty": [], "many": np.array([[(1, 2.0)]], [("x", "O"), ("y", "O")])}
    cells = np.array([[1, "two", [3.0]]], object)
    more = {"sparse": csc_array(np.eye(3)), "z": np.ones((4, 5), np.complex64), "flag": np.array([[True]])}
    matlab(tmp_path / "a.mat", compressed, tree=tree, cells=cells, none=np.zeros((0, 3)), **more)
    check_mat(tmp_path / "a.mat")


def test_the_files_that_scipy_is_tested_with_pass() -> None:
    import scipy.io.matlab

    folder = Path(scipy.io.matlab.__file__).parent / "tests" / "data"
    files = sorted(folder.glob("*.mat"))
    if not files:
        pytest.skip("this scipy was installed without its tests")
    refused = []
    for path in files:
        try:
            check_mat(path)
        except InputError:
            refused.append(path.name)
    # Those that are broken on purpose.
    assert set(refused) <= {"bad_miuint32.mat", "malformed1.mat"}


@pytest.mark.parametrize("change", ["cut", "longer", "shorter", "dimension", "negative", "type", "class", "nothing"])
def test_damaged_matlab_files_are_refused(change: str, tmp_path: Path) -> None:
    """Some of these end the process in scipy."""
    path = tmp_path / "a.mat"
    data = bytearray(matlab(path, a={"x": np.ones((20, 20)), "y": "text"}))
    inner = data.index(struct.pack("<II", 14, 3248), 136)  # the field x: 20 x 20 doubles and 48 bytes before them
    places = {
        "longer": (inner + 4, 1 << 20), "shorter": (inner + 4, 64), "dimension": (inner + 32, 21),
        "negative": (inner + 32, -3), "type": (inner, 9), "class": (inner + 16, 99),
    }  # fmt: skip
    if change == "cut":
        data = data[: len(data) // 2]
    elif change in places:
        struct.pack_into("<i", data, *places[change])
    path.write_bytes(data)
    if change == "nothing":
        check_mat(path)
        return
    with pytest.raises(InputError, match="broken or cut short"):
        check_mat(path)
