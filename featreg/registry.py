"""The one list of plugins and methods: register, register_preset, available, create, parameters.

Own plugin folders (`featreg.detectors`, `featreg.descriptors`, `featreg.matchers`), the core's models, and entry
points of the group "featreg.plugins" are loaded at the first look-up. A module that cannot be imported hides only
itself and is named with the reason when asked for.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import logging
import pkgutil
import sys
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache, partial
from importlib.metadata import distributions, entry_points
from typing import Any, Literal, TypeVar, overload

from featreg.errors import (
    DuplicatePluginError,
    ParameterError,
    PluginError,
    PluginUnavailableError,
    UnknownNameError,
    suggest,
)
from featreg.interfaces import Descriptor, Detector, Filter, Matcher, Model, Nearest
from featreg.presets import PRESETS, Preset
from featreg.presets.checking import checked_preset
from featreg.runtime.parameters import Parameter, checked, declared

Kind = Literal["detector", "descriptor", "nearest", "matcher", "filter", "model"]
KINDS: Mapping[str, type[Any]] = {
    "detector": Detector,
    "descriptor": Descriptor,
    "nearest": Nearest,
    "matcher": Matcher,
    "filter": Filter,
    "model": Model,
}
ROOMS = ("featreg.detectors", "featreg.descriptors", "featreg.matchers")
CORE = ("featreg.geometry", "featreg.geolocation")
#: Under which other packages name theirs.
GROUP = "featreg.plugins"

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
    table: Mapping[str, Parameter] | None = None
    block_parameters: Mapping[str, Any] = field(default_factory=dict)
    compiled: bool = True
    describes: str | None = None

    @property
    def declared(self) -> Mapping[str, Parameter]:
        """Name -> what is declared of a parameter, by the class or by the table that the plugin is a row of."""
        if self.table is None:
            return {} if self.kind == "model" else declared(self.factory)
        return self.table


_entries: dict[tuple[str, str], Entry] = {}
_broken: dict[str, str] = {}
_loaded = False
_lock = threading.RLock()


def register(name: str, *, unavailable: str = "") -> Callable[[type[T]], type[T]]:
    """Class decorator: add a plugin class under `name`; its kind follows from its base class.

    From then on what the class is constructed with is checked against its annotations, see
    `featreg.runtime.parameters`. `unavailable` is the reason and the cure where the class exists but cannot be used.

    Raises
    ------
    PluginError
        The name is taken, the class has no kind, or its parameters are not keywords with defaults.
    """

    def add(cls: type[T]) -> type[T]:
        kind = kind_of(cls, name)
        defaults = {} if kind == "model" else _defaults(name, cls)
        if defaults:
            checked(name)(cls)
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

    `parameters` are name -> default, or a `Parameter` that says more; the other arguments are those of `Entry`.
    `featreg.interop.family.register_table` does so for every row of a table.
    """
    table = {
        key: value if isinstance(value, Parameter) else Parameter.of(inspect.Parameter.empty, value)
        for key, value in parameters.items()
    }
    defaults = {key: parameter.default for key, parameter in table.items()}
    said: dict[str, Any] = {"compiled": compiled, "describes": describes}
    said["block_parameters"] = dict(block_parameters or {})
    _add(Entry(kind, name, factory, module, defaults, summary, unavailable, on_demand, table, **said))


def register_preset(name: str, preset: Preset) -> None:
    """Add a method under `name`: from then on `featreg.match`, comparisons and the command line take it.

    Its parts may be registered later; they are looked up when the method is used. Called in a module that an entry
    point of the group "featreg.plugins" names, it is there for every program.

    Parameters
    ----------
    name : a word of small letters, digits and hyphens
    preset : its parts, their parameters and its switches; `dataclasses.replace` makes one of another

    Raises
    ------
    DuplicatePluginError
        Another method has the name.
    PluginError
        The name cannot be written on a command line, or `preset` is none, holds nothing or two things that make tie
        points, or values of the wrong kind.
    """
    preset = checked_preset(name, preset)
    with _lock:
        if PRESETS.get(name, preset) != preset:
            raise DuplicatePluginError(f"another method is called '{name}': {PRESETS[name].summary}")
        PRESETS[name] = preset


def presets() -> Mapping[str, Preset]:
    """Return every method by name, those of other packages included."""
    if _foreign():
        _load()
    return PRESETS


def kind_of(cls: type[Any], name: str) -> Kind:
    """Return the kind of a class that is to be registered under `name`, or raise `PluginError` where it has none."""
    kinds: list[Any] = [kind for kind, base in KINDS.items() if issubclass(cls, base)]
    if len(kinds) != 1:
        raise PluginError(f"plugin '{name}' ({cls.__module__}) must extend exactly one of {', '.join(KINDS)}")
    found: Kind = kinds[0]
    return found


def available(kind: str) -> list[str]:
    """Return the sorted names of a kind: detector, descriptor, nearest, matcher, filter, model or method."""
    if kind == "method":
        return sorted(presets())
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
    alone = _alone(kind, name)
    if alone is not None:
        return alone
    known = {e.name: e for e in entries(kind)}
    if name not in known:
        raise unknown(kind, name)
    return known[name]


def unknown(kind: str, name: str) -> UnknownNameError:
    """Return the error of a name that a kind does not have: what else it is, the nearest ones, and what is hidden."""
    kinds = {one: [e.name for e in entries(one)] for one in KINDS} | {"method": list(presets())}
    others = " and a ".join(one for one, names in kinds.items() if name in names)
    what = f": that is a {others}, not a {kind};" if others else ","
    hidden = "".join(f"; {m} could not be imported ({why})" for m, why in _broken.items())
    return UnknownNameError(f"unknown {kind} '{name}'{what} {suggest(name, kinds[kind])}{hidden}")


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
    known = found.declared
    for key, value in parameters.items():
        if key not in known:
            raise ParameterError(f"{kind} '{name}' has no parameter '{key}', {suggest(key, known)}")
        known[key].check(f"{name}.{key}", value)
    return found.factory(**parameters)


def model_class(name: str) -> type[Model]:
    """Return the class of a registered geometric model."""
    cls: type[Model] = entry("model", name).factory  # type: ignore[assignment]  # of this kind all are
    return cls


def model_name(cls: type[Model]) -> str:
    """Return the registered name of a model class (its class name where it has none)."""
    registered = next((e.name for e in list(_entries.values()) if e.kind == "model" and e.factory is cls), None)
    return registered or next((e.name for e in entries("model") if e.factory is cls), cls.__name__)


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


def _alone(kind: str, name: str) -> Entry | None:
    """The entry of a plugin of ours that stands in the file of its name, without importing all others.

    None where there is no such file, where other packages have plugins too, which must not share a name, and where all
    are imported already.
    """
    if _loaded or kind not in KINDS or _foreign():
        return None
    file = name.replace("-", "_")
    places = (CORE[0],) if kind == "model" else tuple(f"{room}.{file}" for room in ROOMS) if file.isidentifier() else ()
    with _lock:
        for place in places:
            if (kind, name) not in _entries and importlib.util.find_spec(place) is not None:
                _import(place, partial(importlib.import_module, place), ours=True)
        found = _entries.get((kind, name))
    # What the caller registered may share its name with a file that was not imported yet.
    return found if found is not None and found.module.startswith((*ROOMS, *CORE)) else None


@cache
def _foreign() -> bool:
    """Whether another package has plugins; most packages' entry points need not be parsed for that."""
    texts = (distribution.read_text("entry_points.txt") for distribution in distributions())
    return any(GROUP in text for text in texts if text) and bool(entry_points(group=GROUP))


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
                _import(module, partial(importlib.import_module, module), ours=True)
        for point in entry_points(group=GROUP):
            _import(point.value, point.load)
        _loaded = True


def _import(name: str, load: Callable[[], Any], *, ours: bool = False) -> None:
    """Load a module or an entry point: everything that it registers, or nothing and the reason why."""
    before, methods = set(_entries), set(PRESETS)
    try:
        load()
    except (Exception, SystemExit) as error:
        # A name of ours that is taken already was taken by the caller, whose mistake that is.
        if ours and isinstance(error, DuplicatePluginError):
            raise
        for key in _entries.keys() - before:
            # A module that it imported whole stands on its own: it would not be run again.
            if _entries[key].module == name.partition(":")[0] or _entries[key].module not in sys.modules:
                del _entries[key]
        for method in PRESETS.keys() - methods:
            del PRESETS[method]
        _broken[name] = f"{type(error).__name__}: {error}"
        logger.warning("plugin %s is hidden: %s", name, _broken[name])
