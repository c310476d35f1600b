"""SHA-256 of contents, as hexadecimal text: what a kept result was made of, and whether a file is whole."""

from __future__ import annotations

import dataclasses
import hashlib
import inspect
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


def digest_bytes(content: Any) -> str:
    """Digest of bytes, or of the memory of a contiguous array."""
    return hashlib.sha256(content).hexdigest()


def digest_file(path: str | Path) -> str:
    """Digest of the content of a file; `OSError` where it cannot be read."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def digest_json(value: Any) -> str:
    """Digest of plain values (what JSON knows) in a canonical form: the order of keys does not count."""
    return digest_bytes(json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False).encode())


def digest_arrays(columns: Mapping[str, NDArray[Any]]) -> str:
    """Digest of named arrays: names, types, shapes and values."""
    total = hashlib.sha256()
    for name in sorted(columns):
        values = np.ascontiguousarray(columns[name])
        total.update(f"{name} {values.dtype.str} {values.shape}".encode())
        total.update(values.tobytes())
    return total.hexdigest()


def digest_value(value: Any, parts: Callable[[Any], Any] = lambda value: None) -> str:
    """Digest of nested values of any kind: of the content of files that are named, of arrays, of dataclasses' fields.

    Parameters
    ----------
    value : the value
    parts : what a value consists of that none of these is; None where it does not know either

    Raises
    ------
    TypeError
        The content of a value cannot be known for certain.
    """
    total = hashlib.sha256()
    _feed(total.update, value, parts)
    return total.hexdigest()


def _feed(update: Callable[[bytes], None], value: Any, parts: Callable[[Any], Any]) -> None:
    update(f"<{type(value).__module__}.{type(value).__qualname__}>".encode())
    if isinstance(value, str | Path) and _is_file(value):
        update(f"{Path(value).suffix}{digest_file(value)}".encode())
    elif value is None or isinstance(value, bool | int | float | complex | str | bytes | Path | np.generic):
        update(repr(value).encode())
    elif isinstance(value, np.ndarray) and not value.dtype.hasobject:
        update(f"{value.dtype.str}{value.shape}".encode() + np.ascontiguousarray(value).tobytes())
    elif isinstance(value, list | tuple):
        update(str(len(value)).encode())
        for part in value:
            _feed(update, part, parts)
    elif isinstance(value, Mapping):
        _feed(update, [[str(k), value[k]] for k in sorted(value, key=str)], parts)
    elif (known := parts(value)) is not None:
        _feed(update, known, parts)
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        _feed(update, {f.name: getattr(value, f.name) for f in dataclasses.fields(value) if f.init}, parts)
    elif (isinstance(value, type) or inspect.isfunction(value)) and "<" not in value.__qualname__:
        update(f"{value.__module__}.{value.__qualname__}".encode())
    else:
        raise TypeError(f"{type(value)} has no digest")


def _is_file(name: str | Path) -> bool:
    try:
        return Path(name).is_file()
    except (OSError, ValueError):  # too long for a name, or with a null byte in it
        return False
