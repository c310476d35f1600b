"""Predictions kept on disk under a digest of all that decides them, so that they are made once and scored often."""

from __future__ import annotations

import dataclasses
import hashlib
import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from featreg._version import __version__
from featreg.errors import InputError
from featreg.interfaces import Model
from featreg.registry import KINDS
from featreg.result_file import read_registration, write_registration
from featreg.types import Registration


class PredictionCache:
    """Results in a folder, each under the digest of everything that went into it."""

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        self.images: dict[str, bytes] = {}

    def key(self, name: str, pair: tuple[Any, Any], keywords: Mapping[str, Any]) -> str | None:
        """The digest, or None where something has no certain one: such a result is not kept.

        `name` stands for the two images of `pair`, whose digest is taken once.
        """
        if self.folder is None:
            return None
        try:
            if name not in self.images:
                self.images[name] = _digest(list(pair))
            return _digest([f"featreg {__version__}", self.images[name], keywords]).hex()
        except (TypeError, ValueError, AttributeError, OSError, RecursionError):
            return None

    def read(self, key: str | None) -> tuple[Registration | None, float | None]:
        if self.folder is None or key is None or not (self.folder / f"{key}.json").is_file():
            return None, None
        try:
            kept = read_registration(self.folder / f"{key}.json")
        except InputError:
            return None, None
        provenance = dict(kept.provenance)
        mark = provenance.pop("comparison", None)
        if not isinstance(mark, dict) or mark.get("key") != key:
            return None, None
        return dataclasses.replace(kept, provenance=provenance), mark.get("seconds")

    def write(self, key: str | None, result: Registration | str, seconds: float | None) -> None:
        if self.folder is None or key is None or isinstance(result, str):
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        provenance = {**result.provenance, "comparison": {"key": key, "seconds": seconds}}
        write_registration(dataclasses.replace(result, provenance=provenance), self.folder / f"{key}.json")


def _digest(value: Any) -> bytes:
    digest = hashlib.sha256()
    _feed(digest.update, value)
    return digest.digest()


def _feed(update: Callable[[bytes], None], value: Any) -> None:
    """Feed the content of `value` to a digest; TypeError where the content cannot be known for certain."""
    update(f"<{type(value).__module__}.{type(value).__qualname__}>".encode())
    if isinstance(value, str | Path) and Path(value).is_file():
        with open(value, "rb") as file:
            update(Path(value).suffix.encode() + hashlib.file_digest(file, "sha256").digest())
    elif value is None or isinstance(value, bool | int | float | complex | str | bytes | Path | np.generic):
        update(repr(value).encode())
    elif isinstance(value, np.ndarray) and not value.dtype.hasobject:
        update(f"{value.dtype.str}{value.shape}".encode() + np.ascontiguousarray(value).tobytes())
    elif isinstance(value, list | tuple):
        update(str(len(value)).encode())
        for part in value:
            _feed(update, part)
    elif isinstance(value, Mapping):
        _feed(update, [[str(k), value[k]] for k in sorted(value, key=str)])
    elif isinstance(value, Model):
        _feed(update, dict(value.parameters))
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        _feed(update, {f.name: getattr(value, f.name) for f in dataclasses.fields(value) if f.init})
    elif isinstance(value, tuple(KINDS.values())):
        # A plugin is its class and its parameters, which it keeps under their own names.
        _feed(update, {name: getattr(value, name) for name in inspect.signature(type(value)).parameters})
    elif (isinstance(value, type) or inspect.isfunction(value)) and "<" not in value.__qualname__:
        update(f"{value.__module__}.{value.__qualname__}".encode())
    else:
        raise TypeError(f"{type(value)} has no digest")
