"""Declared parameters: what a class or a function takes, read from its annotations and checked in one place.

    @checked("corners")
    def corners(image: Image, levels: Annotated[int, Interval(ge=1, le=16)] = 8, edge: Literal["log", "eq5"] = "log")

`int`, `float`, `bool`, `str`, `Literal`, `X | None` and the bounds of `annotated_types` are understood; any other
annotation allows everything. What a parameter means stands in the "Parameters" section of the docstring.
"""

from __future__ import annotations

import inspect
import math
import operator
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from functools import cache, wraps
from types import SimpleNamespace, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from annotated_types import Ge, GroupedMetadata, Gt, Interval, Le, Lt, MultipleOf, Predicate

from featreg.errors import ParameterError, suggest

#: What values of a kind are, in words and as types. A bool is no number.
KINDS: Mapping[type, tuple[str, tuple[type, ...]]] = {
    bool: ("true or false", (bool, np.bool_)),
    int: ("a whole number", (int, np.integer)),
    float: ("a number", (int, float, np.integer, np.floating)),
    str: ("a word", (str,)),
}
BOUNDS: Mapping[str, Callable[[Any, Any], bool]] = {
    "gt": operator.gt,
    "ge": operator.ge,
    "lt": operator.lt,
    "le": operator.le,
    "multiple_of": lambda value, of: value % of == 0,
}
WORDS = {"ge": "of at least", "gt": "above", "le": "up to", "lt": "below"}

#: Kinds of values of which a function remembers those that are allowed, and how many it does.
PLAIN = (int, float, bool, str)
MOST_ALLOWED = 256

#: Declarations that many parameters share.
Count = Annotated[int, Ge(1)]
Positive = Annotated[float, Interval(gt=0, lt=math.inf)]
Share = Annotated[float, Interval(gt=0, le=1)]
Probability = Annotated[float, Interval(gt=0, lt=1)]

Thing = TypeVar("Thing", bound=Callable[..., Any])


@dataclass(frozen=True)
class Parameter:
    """One parameter of a class or a function.

    Parameters
    ----------
    default : what it is where it is not given
    kind : bool, int, float or str; None takes any value
    bounds : of "gt", "ge", "lt", "le" and "multiple_of" those declared, and the bound
    choices : the values it may have, where they are named
    predicates : functions of the value that must hold, called as they would be said: ``odd``
    optional : whether None is a value
    meaning : from the docstring
    """

    default: Any = None
    kind: type | None = None
    bounds: Mapping[str, float] = field(default_factory=dict)
    choices: tuple[Any, ...] = ()
    predicates: tuple[Callable[[Any], bool], ...] = ()
    optional: bool = True
    meaning: str = ""

    @classmethod
    def of(cls, annotation: Any, default: Any = inspect.Parameter.empty, meaning: str = "") -> Parameter:
        """Read an annotation; where there is none, the default's type is the parameter's."""
        if annotation is inspect.Parameter.empty:
            annotation = next((kind for kind, (_, types) in KINDS.items() if isinstance(default, types)), Any)
        metadata: list[Any] = []
        optional = default is None
        while get_origin(annotation) in (Annotated, Union, UnionType):
            if get_origin(annotation) is Annotated:
                annotation, *more = get_args(annotation)
                metadata += more
                continue
            members = [a for a in get_args(annotation) if a is not type(None)]
            optional |= len(members) < len(get_args(annotation))
            annotation = members[0] if len(members) == 1 else Any
        choices = get_args(annotation) if get_origin(annotation) is Literal else ()
        optional |= None in choices
        choices = tuple(choice for choice in choices if choice is not None)
        kind = annotation if annotation in KINDS else type(choices[0]) if choices else None
        bounds: dict[str, float] = {}
        predicates = []
        for one in _single(metadata):
            if isinstance(one, Predicate):
                predicates.append(one.func)
            elif isinstance(one, Gt | Ge | Lt | Le | MultipleOf):
                bounds |= asdict(one)
        return cls(default, kind, bounds, choices, tuple(predicates), optional or kind is None, meaning)

    @property
    def wanted(self) -> str:
        """What would be right, in words: "a whole number from 1 to 16"."""
        if self.choices:
            text = _or([repr(choice) for choice in self.choices])
        elif self.kind is None:
            text = "anything"
        else:
            text = f"{KINDS[self.kind][0]} {self.range}".rstrip()
        return f"{text}, or None" if self.optional and self.kind is not None else text

    @property
    def range(self) -> str:
        """The declared bounds in words, to follow "a number": "from 1 to 16"; "" where there are none."""
        finite = {key: f"{bound:.10g}" for key, bound in self.bounds.items() if math.isfinite(bound)}
        if {"ge", "le"} <= finite.keys():
            parts = [f"from {finite['ge']} to {finite['le']}"]
        else:
            parts = [f"{words} {finite[key]}" for key, words in WORDS.items() if key in finite]
        traits = ["finite"] if len(finite) < len(self.bounds) else []
        traits += [f"a multiple of {finite['multiple_of']}"] if "multiple_of" in finite else []
        traits += [function.__name__.replace("_", " ") for function in self.predicates]
        return ("" if parts or not traits else "that is ") + " and ".join(parts + traits)

    def allows(self, value: Any) -> bool:
        """Whether the parameter may have this value; a numpy scalar counts as the number it is, NaN as none."""
        if value is None or self.kind is None:
            return self.optional
        if self.choices:
            plain = value.item() if isinstance(value, np.generic) else value
            return any(type(plain) is type(choice) and plain == choice for choice in self.choices)
        if isinstance(value, bool | np.bool_) is not (self.kind is bool) or not isinstance(value, KINDS[self.kind][1]):
            return False
        if value != value:
            return False
        within = all(BOUNDS[key](value, bound) for key, bound in self.bounds.items())
        return within and all(holds(value) for holds in self.predicates)

    def check(self, name: str, value: Any) -> None:
        """Raise a `ParameterError` where the parameter may not have this value."""
        if not self.allows(value):
            given = value.item() if isinstance(value, np.generic) else value
            raise ParameterError(f"'{name}' must be {self.wanted}, got {given!r}")


def check(name: str, value: Any, annotation: Any) -> None:
    """Raise a `ParameterError` where a value is not what an annotation allows."""
    Parameter.of(annotation).check(name, value)


@cache
def declared(thing: Callable[..., Any]) -> Mapping[str, Parameter]:
    """Return name -> `Parameter` of what a class or a function takes."""
    meanings = described(inspect.getdoc(thing) or "")
    return {
        name: Parameter.of(_annotation(thing, name, p.annotation), p.default, meanings.get(name, ""))
        for name, p in inspect.signature(thing).parameters.items()
    }


def checked(owner: str) -> Callable[[Thing], Thing]:
    """Decorator: what a function, or the constructor of a class, is given is checked before it runs.

    Parameters
    ----------
    owner : said before the parameter's name in an error, as in 'sar-ofast.levels'; "" for the name alone
    """
    prefix = f"{owner}." if owner else ""

    def decorate(thing: Thing) -> Thing:
        function: Any = thing.__init__ if isinstance(thing, type) else thing  # type: ignore[misc]  # of the class itself
        names = list(inspect.signature(function).parameters)
        allowed: set[tuple[str, type, Any]] = set()

        @wraps(function)
        def call(*args: Any, **keywords: Any) -> Any:
            known = declared(thing)
            # Arguments that do not fit the signature are the function's own to refuse.
            for name, value in (*zip(names, args, strict=False), *keywords.items()):
                if name in known:
                    # What was allowed once is, as long as nothing but its value decides.
                    seen = (name, type(value), value) if type(value) in PLAIN else None
                    if seen in allowed:
                        continue
                    known[name].check(prefix + name, value)
                    if seen is not None and len(allowed) < MOST_ALLOWED:
                        allowed.add(seen)
            return function(*args, **keywords)

        if not isinstance(thing, type):
            return call  # type: ignore[return-value]  # called as before
        thing.__init__ = call  # type: ignore[misc]  # of the class itself
        return thing

    return decorate


def owner_of(key: str, parts: Mapping[str, Iterable[str]], nobody: str, also: Iterable[str] = ()) -> tuple[str, str]:
    """Return the part to which a parameter belongs, and the parameter's own name.

    Parameters
    ----------
    key : ``name`` or ``part.name``
    parts : part -> its parameters
    nobody : who has no such parameter, for the message
    also : further names that a misspelt one may have meant

    Raises
    ------
    ParameterError
        No part has it, or more than one.
    """
    part, _, short = key.rpartition(".")
    owners = [role for role, names in parts.items() if short in names and part in ("", role)]
    if len(owners) == 1:
        return owners[0], short
    if owners:
        raise ParameterError(f"'{key}' is ambiguous: write " + " or ".join(f"'{role}.{short}'" for role in owners))
    names = {f"{role}.{name}" if part else name for role, own in parts.items() for name in own}
    raise ParameterError(f"{nobody} has a parameter '{key}', {suggest(key, names | (set() if part else set(also)))}")


def described(doc: str) -> dict[str, str]:
    """Return name -> meaning from the "Parameters" section of a docstring; "a, b : text" counts for a and for b."""
    section = re.search(r"^Parameters\n-+\n(.*?)(?=^\S[^\n]*\n-{3,}$|\Z)", doc, re.DOTALL | re.MULTILINE)
    found: dict[str, str] = {}
    for names, text in re.findall(r"^(\w[\w, ]*?) : (.*(?:\n+ .*)*)", section[1] if section else "", re.MULTILINE):
        found |= dict.fromkeys(re.split(r",\s*", names), " ".join(text.split()))
    return found


def _single(metadata: list[Any]) -> Iterator[Any]:
    for one in metadata:
        if isinstance(one, GroupedMetadata):
            yield from one
        else:
            yield one


def _annotation(thing: Callable[..., Any], name: str, text: Any) -> Any:
    """An annotation that may be written as text; `Any` where it cannot be read at run time."""
    if not isinstance(text, str):
        return text
    home = next((c for c in getattr(thing, "__mro__", ()) if name in vars(c).get("__annotations__", {})), None)
    function: Any = thing.__init__ if isinstance(thing, type) else thing  # type: ignore[misc]  # of the class itself
    names = vars(sys.modules[home.__module__]) if home else inspect.unwrap(function).__globals__
    try:
        return get_type_hints(SimpleNamespace(__annotations__={name: text}), names, include_extras=True)[name]
    except Exception:
        return Any


def _or(words: list[str]) -> str:
    return " or ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def check_seed(seed: Any) -> None:
    """Raise where a seed is no whole number from 0 on."""
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ParameterError(f"seed must be a whole number >= 0, got {seed!r}")
