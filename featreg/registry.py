"""The one list of plugins: register, available, create, parameters.

Own plugin folders (`featreg.detectors`, `featreg.descriptors`, `featreg.matchers`), the core's models, and entry
points of the group "featreg.plugins" are loaded at the first look-up. A module that cannot be imported hides only
itself and is named with the reason when asked for.
"""

from __future__ import annotations

import importlib
import inspect
import logging
import pkgutil
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import entry_points
from typing import Any, Literal, TypeVar, overload

import numpy as np

from featreg.errors import (
    DuplicatePluginError,
    ParameterError,
    PluginError,
    PluginUnavailableError,
    UnknownNameError,
    suggest,
)
from featreg.interfaces import Descriptor, Detector, Filter, Matcher, Model, Nearest

Kind = Literal["detector", "descriptor", "nearest", "matcher", "filter", "model"]
KINDS: Mapping[Kind, type[Any]] = {
    "detector": Detector,
    "descriptor": Descriptor,
    "nearest": Nearest,
    "matcher": Matcher,
    "filter": Filter,
    "model": Model,
}
ROOMS = ("featreg.detectors", "featreg.descriptors", "featreg.matchers")
CORE = ("featreg.geometry", "featreg.geolocation")

# What values of parameters are, the narrower first: a bool is an int in Python.
TYPES: tuple[tuple[tuple[type, ...], str], ...] = (
    ((bool, np.bool_), "true or false"),
    ((int, np.integer), "a whole number"),
    ((float, np.floating), "a number"),
    ((str,), "a word"),
)

logger = logging.getLogger(__name__)
T = TypeVar("T")


@dataclass(frozen=True)
class Entry:
    """One registered plugin: how to make it, which parameters it takes, or why it cannot be had.

    One that is `on_demand` can be made all the same: a parameter or a download supplies what is missing.
    `block_parameters` and `compiled` are those of `featreg.interfaces.Plugin`, `describes` is that of `Detector`.
    """

    kind: str
    name: str
    factory: Callable[..., Any]
    module: str
    parameters: Mapping[str, Any]
    summary: str = ""
    unavailable: str = ""
    on_demand: bool = False
    block_parameters: Mapping[str, Any] = field(default_factory=dict)
    compiled: bool = True
    describes: str | None = None


_entries: dict[tuple[str, str], Entry] = {}
_broken: dict[str, str] = {}
_loaded = False
_lock = threading.RLock()


def register(name: str, *, unavailable: str = "") -> Callable[[type[T]], type[T]]:
    """Class decorator: add a plugin class under `name`; its kind follows from its base class.

    `unavailable` is the reason and the cure where the class exists but cannot be used here.

    Raises
    ------
    PluginError
        The name is taken, the class has no kind, or its parameters are not keywords with defaults.
    """

    def add(cls: type[T]) -> type[T]:
        kind = kind_of(cls, name)
        defaults = {} if kind == "model" else _defaults(name, cls)
        said = {key: getattr(cls, key) for key in ("block_parameters", "compiled", "describes") if hasattr(cls, key)}
        _add(Entry(kind, name, cls, cls.__module__, defaults, _first_line(cls), unavailable, **said))
        return cls

    return add


def register_family(
    kind: Kind,
    name: str,
    factory: Callable[..., Any],
    parameters: Mapping[str, Any],
    *,
    summary: str,
    module: str,
    unavailable: str = "",
    on_demand: bool = False,
    block_parameters: Mapping[str, Any] | None = None,
    compiled: bool = True,
    describes: str | None = None,
) -> None:
    """Add one member of a third-party family from a table: `factory(**parameters)` makes the plugin.

    The other arguments are those of `Entry`. `featreg.interop.family.register_table` does so for every row of a table.
    """
    _add(
        Entry(
            kind,
            name,
            factory,
            module,
            dict(parameters),
            summary,
            unavailable,
            on_demand,
            dict(block_parameters or {}),
            compiled,
            describes,
        )
    )


def kind_of(cls: type[Any], name: str) -> Kind:
    """Return the kind of a class that is to be registered under `name`, or raise `PluginError` where it has none."""
    kinds: list[Kind] = [kind for kind, base in KINDS.items() if issubclass(cls, base)]
    if len(kinds) != 1:
        raise PluginError(f"plugin '{name}' ({cls.__module__}) must extend exactly one of {', '.join(KINDS)}")
    return kinds[0]


def available(kind: str) -> list[str]:
    """Return the sorted names of a kind: detector, descriptor, nearest, matcher, filter, model or method."""
    if kind == "method":
        from featreg.presets import PRESETS

        return sorted(PRESETS)
    return sorted(e.name for e in entries(kind) if not e.unavailable)


def entries(kind: str) -> list[Entry]:
    """Return every entry of a kind, those that cannot be used here included, sorted by name."""
    if kind not in KINDS:
        raise UnknownNameError(f"unknown kind '{kind}', {suggest(kind, [*KINDS, 'method'])}")
    _load()
    return sorted((e for e in _entries.values() if e.kind == kind), key=lambda e: e.name)


def broken() -> Mapping[str, str]:
    """Return module or entry point -> reason, for what could not be imported."""
    _load()
    return dict(_broken)


def entry(kind: str, name: str) -> Entry:
    """Return one entry.

    Raises
    ------
    UnknownNameError
        No plugin of that name; the text suggests the nearest.
    """
    known = {e.name: e for e in entries(kind)}
    if name not in known:
        hidden = "".join(f"; {m} could not be imported ({why})" for m, why in _broken.items())
        raise UnknownNameError(f"unknown {kind} '{name}', {suggest(name, known)}{hidden}")
    return known[name]


@overload
def create(kind: Literal["detector"], name: str, **parameters: Any) -> Detector: ...
@overload
def create(kind: Literal["descriptor"], name: str, **parameters: Any) -> Descriptor: ...
@overload
def create(kind: Literal["nearest"], name: str, **parameters: Any) -> Nearest: ...
@overload
def create(kind: Literal["matcher"], name: str, **parameters: Any) -> Matcher: ...
@overload
def create(kind: Literal["filter"], name: str, **parameters: Any) -> Filter: ...
def create(kind: str, name: str, **parameters: Any) -> Any:
    """Make a plugin by name, with its parameters as keywords.

    Raises
    ------
    UnknownNameError, PluginUnavailableError
        No such plugin, or one that cannot be used here.
    ParameterError
        A parameter that the plugin does not have, or a value it refuses.
    """
    found = entry(kind, name)
    if found.unavailable and not found.on_demand:
        raise PluginUnavailableError(f"{kind} '{name}' cannot be used here: {found.unavailable}")
    for key, value in parameters.items():
        if key not in found.parameters:
            raise ParameterError(f"{kind} '{name}' has no parameter '{key}', {suggest(key, found.parameters)}")
        check_type(f"{name}.{key}", value, found.parameters[key])
    return found.factory(**parameters)


def check_type(name: str, value: Any, default: Any) -> None:
    """Raise a `ParameterError` where a value is of another type than the default it replaces (None takes any)."""
    wanted = next((words for kinds, words in TYPES if isinstance(default, kinds)), None)
    given = next((words for kinds, words in TYPES if isinstance(value, kinds)), None)
    if wanted is None or given == wanted or (wanted, given) == ("a number", "a whole number"):
        return
    raise ParameterError(f"'{name}' must be {wanted} (its default is {default!r}), got {value!r}")


def model_class(name: str) -> type[Model]:
    """Return the class of a registered geometric model."""
    cls: type[Model] = entry("model", name).factory  # type: ignore[assignment]
    return cls


def model_name(cls: type[Model]) -> str:
    """Return the registered name of a model class (its class name where it has none)."""
    return next((e.name for e in entries("model") if e.factory is cls), cls.__name__)


def _defaults(name: str, cls: type[Any]) -> dict[str, Any]:
    defaults = {}
    for key, parameter in inspect.signature(cls).parameters.items():
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD) or parameter.default is parameter.empty:
            raise PluginError(f"plugin '{name}' ({cls.__module__}): parameter '{key}' must be a keyword with a default")
        defaults[key] = parameter.default
    return defaults


def _first_line(cls: type[Any]) -> str:
    return (inspect.getdoc(cls) or "").split("\n", 1)[0]


def _add(new: Entry) -> None:
    with _lock:
        old = _entries.get((new.kind, new.name))
        if old is not None and (old.module, old.factory) != (new.module, new.factory):
            raise DuplicatePluginError(f"two plugins are called {new.kind} '{new.name}': {old.module} and {new.module}")
        _entries[new.kind, new.name] = new


def _load() -> None:
    global _loaded
    if _loaded:
        return
    with _lock:
        if _loaded:
            return
        for module in CORE:
            importlib.import_module(module)
        for room in ROOMS:
            for found in pkgutil.iter_modules(importlib.import_module(room).__path__):
                module = f"{room}.{found.name}"
                _import(module, partial(importlib.import_module, module))
        for point in entry_points(group="featreg.plugins"):
            _import(point.value, point.load)
        _loaded = True


def _import(name: str, load: Callable[[], Any]) -> None:
    try:
        load()
    except DuplicatePluginError:
        raise
    except Exception as error:
        _broken[name] = f"{type(error).__name__}: {error}"
        logger.warning("plugin %s is hidden: %s", name, _broken[name])
