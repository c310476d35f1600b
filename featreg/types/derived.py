"""Maps derived from an image, computed once and shared by the stages that need them."""

from __future__ import annotations

import inspect
import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from functools import lru_cache
from typing import Any

import numpy as np

MAX_BYTES = 1 << 30
#: Kinds of values that take no memory to speak of.
PLAIN = frozenset((bool, int, float))


@lru_cache(maxsize=256)
def _named(function: Callable[..., Any]) -> tuple[tuple[str, str], dict[str, Any]]:
    """The full name of a function, and what it has defaults for: spelt out or not, they name the same map."""
    if "<" in function.__qualname__:
        raise TypeError(f"derive needs a module-level function, got {function.__qualname__}")
    parameters = inspect.signature(function).parameters.values()
    name = function.__module__, function.__qualname__
    return name, {p.name: p.default for p in parameters if p.default is not p.empty}


@lru_cache(maxsize=512)
def _key(function: Callable[..., Any], *params: tuple[str, Any]) -> Any:
    """What names a map, and equals that of the same function with the same parameters, in whatever order."""
    name, known = _named(function)
    return name, tuple(sorted({**known, **dict(params)}.items()))


class DerivedMaps:
    """A bounded store of `function(image, **params)` results, one lock per key.

    The key is the function's full name and its parameters, so two stages that ask for the same map share one result
    without knowing each other. Least recently used maps go first once `max_bytes` is exceeded; a result that is neither
    array, image nor dataclass says its `nbytes` itself.
    """

    def __init__(self, max_bytes: int = MAX_BYTES) -> None:
        self._max_bytes = max_bytes
        self._lock = threading.Lock()
        self._locks: dict[Any, threading.Lock] = {}
        self._maps: OrderedDict[Any, tuple[Any, int]] = OrderedDict()
        self._bytes = 0

    def get(self, image: Any, function: Callable[..., Any], params: Mapping[str, Any]) -> Any:
        key = _key(function, *params.items())
        # Looking up and moving are one operation each for the interpreter; what went in between is still at hand.
        found = self._maps.get(key)
        if found is not None:
            try:  # noqa: SIM105  # a context of its own takes longer than all of this
                self._maps.move_to_end(key)
            except KeyError:
                pass
            return found[0]
        with self._locks.setdefault(key, threading.Lock()):
            found = self._maps.get(key)
            if found is not None:
                return found[0]
            value = function(image, **params)
            self._keep(key, value)
            return value

    def clear(self) -> None:
        with self._lock:
            self._maps.clear()
            self._locks.clear()
            self._bytes = 0

    def _keep(self, key: Any, value: Any) -> None:
        if type(value) in PLAIN:
            self._maps[key] = value, 0
            return
        parts = value if isinstance(value, tuple) else (value,)
        arrays = [array for part in parts for array in _arrays(part)]
        for array in arrays:
            array.setflags(write=False)
        with self._lock:
            size = sum(a.nbytes for a in arrays) or sum(getattr(part, "nbytes", 0) for part in parts)
            self._maps[key] = (value, size)
            self._bytes += size
            while self._bytes > self._max_bytes and len(self._maps) > 1:
                gone, (_, freed) = self._maps.popitem(last=False)
                self._bytes -= freed
                self._locks.pop(gone, None)


def _arrays(part: Any) -> list[np.ndarray[Any, Any]]:
    """What of a result takes memory: itself, the pixels of a derived image, the arrays of a dataclass."""
    if isinstance(part, np.ndarray):
        return [part]
    if hasattr(part, "pixels"):
        # A pyramid level, for example; what is derived from it is its own.
        held = [part.pixels]
    else:
        held = [getattr(part, f.name) for f in fields(part)] if is_dataclass(part) else [part]
    return [array for array in held if isinstance(array, np.ndarray)]
