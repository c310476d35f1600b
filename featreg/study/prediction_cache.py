"""Predictions kept on disk under a digest of all that decides them, so that they are made once and scored often."""

from __future__ import annotations

import dataclasses
import inspect
import io
import sys
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from featreg._version import __version__
from featreg.errors import FeatregError, InputError
from featreg.interfaces import Model, Plugin
from featreg.io.raster_files import files_of
from featreg.pipeline.keywords import deciding, of_pipeline
from featreg.registry import KINDS, entries
from featreg.results.json_file import write_registration
from featreg.results.registration import Registration
from featreg.runtime.digests import digest_bytes, digest_value
from featreg.runtime.files import write_atomic
from featreg.runtime.numpy_files import load_arrays
from featreg.types import FloatArray

#: Rooms that only look at results: a new metric matches nothing again.
AFTERWARDS = ("cli", "exports", "marking", "pictures", "report", "study")


class PredictionCache:
    """Results in a folder, each under the digest of everything that went into it: never of another protocol.

    Part of every digest is the source of this package's core and of the plugins that the method uses, so that who works
    on a plugin never meets what an older version of it gave, and keeps what other methods gave.
    """

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        self.images: dict[str, str] = {}

    def key(self, name: str, images: tuple[Any, ...], keywords: Mapping[str, Any], also: Any = None) -> str | None:
        """The digest, or None where something has no certain one: such a result is not kept.

        `name` stands for the images, whose digest is taken once; of the `keywords` of `featreg.match` those count that
        can change a result; `also` is what else it depends on.
        """
        if self.folder is None:
            return None
        try:
            if name not in self.images:
                self.images[name] = _digest([_content(image) for image in images])
            decides = deciding(keywords)
            return _digest([f"featreg {__version__}", _code(decides), self.images[name], decides, also])
        except (TypeError, ValueError, AttributeError, OSError, RecursionError):
            return None

    def read(self, key: str | None) -> tuple[Registration | None, dict[str, float] | None]:
        """The result and its times (stage -> seconds of a serial run), None for what is not there or not whole."""
        if self.folder is None or key is None or not (self.folder / f"{key}.json").is_file():
            return None, None
        try:
            kept = Registration.from_json(self.folder / f"{key}.json")
        except InputError:
            return None, None
        provenance = dict(kept.provenance)
        mark = provenance.pop("comparison", None)
        if not isinstance(mark, dict) or mark.get("key") != key:
            return None, None
        act = mark.get("act")
        times = {str(k): float(v) for k, v in act.items()} if isinstance(act, dict) else None
        return dataclasses.replace(kept, provenance=provenance), times

    def write(self, key: str | None, result: Registration | str, act: Mapping[str, float] | None) -> None:
        """Keep a result and its times; a failure (text) is not kept."""
        if self.folder is None or key is None or isinstance(result, str):
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        provenance = {**result.provenance, "comparison": {"key": key, "act": None if act is None else dict(act)}}
        write_registration(dataclasses.replace(result, provenance=provenance), self.folder / f"{key}.json")

    def read_points(self, key: str | None) -> FloatArray | None:
        """(N, 2) keypoints, or None for what is not there or not whole."""
        if self.folder is None or key is None or not (self.folder / f"{key}.npz").is_file():
            return None
        try:
            kept = load_arrays(self.folder / f"{key}.npz")
            xy, mark = kept["xy"], str(kept["key"])
        except (OSError, ValueError, LookupError):
            return None
        whole = mark == key and xy.dtype == np.float64 and xy.ndim == 2 and xy.shape[1] == 2 and np.isfinite(xy).all()
        return xy if whole else None

    def write_points(self, key: str | None, xy: FloatArray) -> None:
        """Keep keypoints."""
        if self.folder is None or key is None:
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        out = io.BytesIO()
        np.savez_compressed(out, xy=xy, key=np.array(key))
        write_atomic(self.folder / f"{key}.npz", out.getvalue())


def _content(image: Any) -> Any:
    """What the digest of an image is taken of: of a product, a dataset or a raster with a header, all its files."""
    if not isinstance(image, str | Path):
        return image
    try:
        files = [Path(file) for file in files_of(str(image))]
    except FeatregError:
        files = [Path(image)]
    if not files:
        raise ValueError("an image elsewhere has no certain content")
    return files if isinstance(image, Path) and image.is_file() else [str(image), *files]


def _code(keywords: Mapping[str, Any]) -> list[str]:
    """Digests of the code that decides a result: the core, and the plugins that the method uses."""
    return [_core(), *(_file(module) for module in sorted(_modules(keywords)))]


def _modules(keywords: Mapping[str, Any]) -> set[str]:
    """The modules of the plugins of a method; those of all plugins where the method cannot be built."""
    from featreg.pipeline.assembly import assemble_all

    try:
        pipelines = assemble_all(**of_pipeline(keywords), blocks=None)
    except (FeatregError, TypeError):
        return {found.module for kind in KINDS for found in entries(kind)}
    plugins = [part for made in pipelines for part in (made.matcher, *(keeper for _, keeper in made.filters))]
    modules = {module for plugin in plugins if plugin is not None for module in _of(plugin)}
    return modules | {made.model.__module__ for made in pipelines}


def _of(plugin: Plugin) -> set[str]:
    """The modules of a plugin, of what its class rests on, and of its parts."""
    own = {cls.__module__ for cls in type(plugin).__mro__ if cls.__module__ not in ("builtins", "abc")}
    return own.union(*(_of(part) for part in plugin.parts))


def core_files() -> list[Path]:
    """The modules of this package that may decide a result."""
    package = Path(__file__).parents[1]
    found = (path for path in package.rglob("*.py") if path.relative_to(package).parts[0] not in AFTERWARDS)
    return sorted(found)


@lru_cache(maxsize=1)
def _core() -> str:
    """Digest of those modules."""
    package = Path(__file__).parents[1]
    return _digest([[path.relative_to(package).as_posix(), path.read_bytes()] for path in core_files()])


@lru_cache
def _file(module: str) -> str:
    """Digest of the source of a loaded module, with the whole package of one that is not ours; of its name without."""
    source = getattr(sys.modules.get(module), "__file__", None)
    top = module.partition(".")[0]
    folders = [] if top == "featreg" else getattr(sys.modules.get(top), "__path__", [])
    files = sorted(file for folder in folders for file in Path(folder).rglob("*.py"))
    content = (path.read_bytes() for path in files or ([] if source is None else [Path(source)]))
    return digest_bytes(module.encode() + b"".join(content))


def _digest(value: Any) -> str:
    return digest_value(value, _parts)


def _parts(value: Any) -> dict[str, Any] | None:
    """What decides what a model or a plugin does: its parameters, which a plugin keeps under their own names."""
    if isinstance(value, Model):
        return dict(value.parameters)
    if isinstance(value, tuple(KINDS.values())):
        return {name: getattr(value, name) for name in inspect.signature(type(value)).parameters}
    return None
