"""Large arrays that are written anew again and again: kept while one piece of work runs, so that the system need not
clear and map their pages each time."""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Larger ones are not kept, bytes.
LARGEST = 1 << 28

#: glibc gives freed arrays of up to 32 MiB back to the system until it has seen one of that size freed, bytes.
SEEN = (32 << 20) - (8 << 10)

#: Most of what was freed inside `reusing` that stays with the process afterwards, bytes, and as a share of the memory.
MOST_STAYS, STAYING_SHARE = 3 << 29, 1 / 16

#: Where Linux says how much memory a container may use, control groups of version 2 and 1.
CONTAINER_LIMITS = (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"))

#: Numbers of glibc's parameters: how much of the heap's end may be free before it is given back, and how many arrays
#: are mapped each by itself, and given back so; what the second is from the start.
TRIM_THRESHOLD, MMAP_MAX, MAPPED = -1, -4, 1 << 16

_kept = threading.local()
_reusing = 0
_reusing_lock = threading.Lock()


@lru_cache(maxsize=1)
def expect_large_arrays() -> None:
    """Free one large array that was never written, once in a process, so that the C library keeps those to come.

    Each array of an image is otherwise mapped and cleared by the system page by page, an eighth of a method's time;
    afterwards up to 64 MiB stay with the process. Nothing happens where another C library has no such habit.
    """
    np.empty(SEEN, np.uint8)


@contextmanager
def reusing() -> Iterator[None]:
    """Let the C library hand out again what is freed inside the block, whatever its size.

    The maps of an image of 16 million pixels are mapped, cleared and given back by the system each time that one is
    made, by all threads' or libraries' code that makes them: a quarter to a half of the processor's time of a pair.
    Here each page is cleared once. Afterwards up to a sixteenth of the memory, 1.5 GB at most, stays with the process
    for the next pair, and glibc no longer adapts its thresholds to what the process frees. Blocks may lie in each other
    or run side by side. Nothing happens where the C library is not glibc of 2.33 or later, or where ``MALLOC_...`` or
    ``GLIBC_TUNABLES`` in the environment say how it is to be.
    """
    global _reusing
    library = _glibc()
    if library is None:
        yield
        return
    expect_large_arrays()
    with _reusing_lock:
        _reusing += 1
        if _reusing == 1:
            library.mallopt(MMAP_MAX, 0)
            library.mallopt(TRIM_THRESHOLD, (1 << 31) - 1)
    try:
        yield
    finally:
        with _reusing_lock:
            _reusing -= 1
            if _reusing == 0:
                library.mallopt(MMAP_MAX, MAPPED)
                library.mallopt(TRIM_THRESHOLD, _staying())
                if library.mallinfo2().free > _staying():
                    library.malloc_trim(0)


def give_back_freed() -> None:
    """Give memory that was freed back to the system, whole pages of it, where the C library is glibc.

    It keeps what was freed in small arrays among others for the next small ones, where no large one finds room.
    """
    library = _glibc()
    if library is not None:
        library.malloc_trim(0)


def _staying() -> int:
    """How many free bytes may stay with the process."""
    return min(MOST_STAYS, int(STAYING_SHARE * _memory()))


def _memory() -> int:
    """Bytes of memory that this process may use: of the machine, or of the container where that has fewer."""
    most = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    for limit in CONTAINER_LIMITS:
        # There is no such file, or it says "max".
        with contextlib.suppress(OSError, ValueError):
            most = min(most, int(limit.read_text()))
    return most


class _MallocInfo(ctypes.Structure):
    """What `mallinfo2` of glibc returns; `free` are the bytes of freed memory that the process holds."""

    _fields_ = [
        (name, ctypes.c_size_t)
        for name in ("arena", "chunks", "small", "mapped", "in_maps", "unused", "in_small", "used", "free", "end")
    ]


@lru_cache(maxsize=1)
def _glibc() -> Any:
    """The C library where it is glibc of 2.33 or later and its variables say nothing of how it is to be, else None."""
    if sys.platform != "linux" or any(name.startswith(("MALLOC_", "GLIBC_TUNABLES")) for name in os.environ):
        return None
    library = ctypes.CDLL(None)
    if not all(hasattr(library, name) for name in ("mallopt", "malloc_trim", "mallinfo2")):
        return None
    library.mallopt.argtypes = [ctypes.c_int, ctypes.c_int]
    library.malloc_trim.argtypes = [ctypes.c_size_t]
    library.mallinfo2.restype = _MallocInfo
    return library


@contextmanager
def keeping() -> Iterator[None]:
    """Keep the arrays of this thread's `scratch` until the block ends."""
    expect_large_arrays()
    outer = getattr(_kept, "by_name", None)
    _kept.by_name = {} if outer is None else outer
    try:
        yield
    finally:
        _kept.by_name = outer


def scratch(name: str, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """An array of float32 whose content is arbitrary, for the caller alone until the same thread asks for this name.

    Parameters
    ----------
    name : of what it is for; two that are needed at once have different names
    shape : any; what `keeping` keeps grows with the largest asked for
    """
    by_name = getattr(_kept, "by_name", None)
    count = prod(shape)
    if by_name is None or 4 * count > LARGEST:
        return np.empty(shape, np.float32)
    kept: NDArray[np.float32] | None = by_name.get(name)
    if kept is None or kept.size < count:
        by_name[name] = kept = np.empty(count, np.float32)
    return kept[:count].reshape(shape)


def scratch_bytes(name: str, shape: tuple[int, int]) -> NDArray[np.uint8]:
    """As `scratch`, of uint8."""
    count = prod(shape)
    return scratch(name, (-(-count // 4),)).view(np.uint8)[:count].reshape(shape)
