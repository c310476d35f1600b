"""Arrays that are written anew: kept inside a piece of work, fresh outside it, each thread its own."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from featreg.runtime import buffers
from featreg.runtime.buffers import keeping, scratch, scratch_bytes


def run(code: str) -> list[int]:
    """The numbers that a process of its own prints."""
    # A cluster of dask in the same process leaves a variable by which glibc would not adapt.
    plain = {name: value for name, value in os.environ.items() if not name.startswith(("MALLOC_", "GLIBC_TUNABLES"))}
    done = subprocess.run([sys.executable, "-c", code], env=plain, capture_output=True, text=True, check=True)
    return [int(count) for count in done.stdout.split()]


def test_an_array_is_kept_while_the_work_runs_and_grows_with_what_is_asked_for() -> None:
    with keeping():
        first = scratch("a", (4, 5))
        assert first.shape == (4, 5)
        assert first.dtype == np.float32
        assert np.shares_memory(first, scratch("a", (2, 3)))
        assert not np.shares_memory(first, scratch("b", (4, 5)))
        larger = scratch("a", (40, 5))
        assert not np.shares_memory(first, larger)
        with keeping():
            assert np.shares_memory(larger, scratch("a", (4, 5)))
        assert np.shares_memory(larger, scratch("a", (4, 5)))
    assert not np.shares_memory(larger, scratch("a", (4, 5)))


def test_what_is_too_large_and_other_threads_get_their_own() -> None:
    with keeping():
        mine = scratch("a", (100,))
        theirs: list[bool] = []

        def work() -> None:
            with keeping():
                theirs.append(np.shares_memory(mine, scratch("a", (100,))))

        thread = threading.Thread(target=work)
        thread.start()
        thread.join()
        assert theirs == [False]
        large = buffers.LARGEST // 4 + 1
        assert not np.shares_memory(scratch("a", (large,)), scratch("a", (large,)))


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="of glibc's habit")
def test_large_arrays_are_not_mapped_anew_each_time() -> None:
    code = (
        "import resource, numpy as np\n"
        "from featreg.runtime.buffers import expect_large_arrays\n"
        "def faults():\n"
        "    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt\n"
        "    for _ in range(20):\n"
        "        [np.ones(3 << 20, np.uint8) for _ in range(12)]\n"
        "    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before\n"
        "faults(); print(faults()); expect_large_arrays(); faults(); print(faults())\n"
    )
    before, after = run(code)
    assert after < 0.2 * before


@pytest.mark.skipif(buffers._glibc() is None, reason="of glibc's habit")
def test_inside_reusing_arrays_of_any_size_are_handed_out_again_and_little_stays_afterwards() -> None:
    code = (
        "import resource, numpy as np\n"
        "from featreg.runtime import buffers\n"
        "def faults():\n"
        "    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt\n"
        "    for _ in range(3):\n"
        # One written page in two megabytes, so that the test is quick whatever the size of a page.
        "        np.empty(80 << 20, np.uint8)[:: 1 << 21] = 1\n"
        "    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before\n"
        "fresh = faults()\n"
        "with buffers.reusing():\n"
        "    faults()\n"
        "    with buffers.reusing():\n"
        "        inside = faults()\n"
        "    still = faults()\n"
        "    held = buffers._glibc().mallinfo2().free\n"
        "    buffers.MOST_STAYS = 1 << 20\n"
        "print(fresh, inside, still, faults(), held)\n"
    )
    fresh, inside, still, afterwards, held = run(code)
    assert max(inside, still) < 0.2 * fresh
    assert afterwards > 0.5 * fresh
    assert held >= 80 << 20


def test_bytes_are_kept_as_well() -> None:
    with keeping():
        first = scratch_bytes("bytes", (5, 7))
        assert first.shape == (5, 7)
        assert first.dtype == np.uint8
        assert first.flags.c_contiguous
        assert np.shares_memory(first, scratch_bytes("bytes", (3, 4)))


@pytest.mark.skipif(buffers._glibc() is None, reason="of glibc's habit")
def test_what_stays_is_a_share_of_what_a_container_may_use(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    limits = tmp_path / "max", tmp_path / "limit_in_bytes", tmp_path / "missing"
    monkeypatch.setattr(buffers, "CONTAINER_LIMITS", limits)
    limits[0].write_text("max\n")
    limits[1].write_text(f"{1 << 26}\n")
    assert buffers._staying() == 1 << 22


FREED = """
import os
import numpy as np
from featreg.runtime.buffers import give_back_freed
resident = lambda: int(open("/proc/self/statm").read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
arrays = [np.ones(1 << 13, np.uint8) for _ in range(8 << 10)]
last = np.ones(1 << 13, np.uint8)  # without it the end of the heap would go by itself
arrays.clear()
print(resident())
give_back_freed()
print(resident(), last.sum())
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library")
def test_small_arrays_that_were_freed_leave_the_process() -> None:
    before, after, kept = run(FREED)
    assert before - after > 32 << 20
    assert kept == 1 << 13
