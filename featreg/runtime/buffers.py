"""Large arrays that are written anew again and again: kept while one piece of work runs, so that the system need not
clear and map their pages each time."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from math import prod

import numpy as np
from numpy.typing import NDArray

#: Larger ones are not kept, bytes.
LARGEST = 1 << 28

#: glibc gives freed arrays of up to 32 MiB back to the system until it has seen one of that size freed, bytes.
SEEN = (32 << 20) - (8 << 10)

_kept = threading.local()


@lru_cache(maxsize=1)
def expect_large_arrays() -> None:
    """Free one large array that was never written, once in a process, so that the C library keeps those to come.

    Each array of an image is otherwise mapped and cleared by the system page by page, an eighth of a method's time;
    afterwards up to 64 MiB stay with the process. Nothing happens where another C library has no such habit.
    """
    np.empty(SEEN, np.uint8)


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
