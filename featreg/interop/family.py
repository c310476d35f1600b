"""Families: many algorithms of one library as plugins, each a row of a table.

A room's file holds the table and one class that runs any row of it:

    TABLE = {"toy-corners": Row("Corners", "Corners of toys", {**N_FEATURES, "k": Parameter(0.04, Gt(0))})}

    @register_table
    class ToyDetector(Part, Detector):
        table = TABLE

        def detect_features(self, image: Image) -> Features: ...  # self.row, self.parameters

A library of its own kind extends `Row`: how it is built, why it cannot be had, where its weights come from.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from dataclasses import astuple, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np
from annotated_types import BaseMetadata, Ge, GroupedMetadata, Gt, Le, Lt, MultipleOf

from featreg.errors import ParameterError, suggest
from featreg.registry import check_type, kind_of, register_family
from featreg.sar.normalise import METHODS
from featreg.types import Features

#: Limits in words, and whether a value keeps them; NaN keeps none.
LIMITS: Mapping[type, tuple[str, Callable[[Any, Any], bool]]] = {
    Ge: ("at least", operator.ge),
    Gt: ("above", operator.gt),
    Le: ("at most", operator.le),
    Lt: ("below", operator.lt),
    MultipleOf: ("a multiple of", lambda value, step: value % step == 0),
}


@dataclass(frozen=True)
class Parameter:
    """One parameter of a row.

    Parameters
    ----------
    default : its default; values must be of the same type, or a file's path or None where it is None
    limit : the range of its values: `Ge`, `Gt`, `Le`, `Lt`, `Interval` or `MultipleOf` of annotated_types
    choices : the values it may have, or each of them with what the library calls it
    meaning : one line
    keyword : the library's own name of it, "" where it does not reach the library under a name
    """

    default: Any
    limit: BaseMetadata | GroupedMetadata | None = field(default=None, hash=False)
    choices: Mapping[Any, Any] | tuple[Any, ...] = field(default=(), hash=False)
    meaning: str = ""
    keyword: str = ""

    def checked(self, name: str, value: Any) -> Any:
        """Return a value as a plugin keeps it: of the default's type, a path as text.

        Raises
        ------
        ParameterError
            It is of another type, out of range or not among the choices.
        """
        if self.default is None:
            if not isinstance(value, str | Path | None):
                raise ParameterError(f"'{name}' must be the path of a file or None, got {value!r}")
            return None if value is None else str(value)
        if self.choices and value not in tuple(self.choices):
            raise ParameterError(f"'{name}' must be one of {', '.join(map(repr, self.choices))}, got {value!r}")
        check_type(name, value, self.default)
        limits = self.limit if isinstance(self.limit, GroupedMetadata) else filter(None, [self.limit])
        for limit in limits:
            words, holds = LIMITS[type(limit)]
            (bound,) = astuple(limit)  # type: ignore[call-overload]
            if not holds(value, bound):
                raise ParameterError(f"'{name}' must be {words} {bound}, got {value!r}")
        return type(self.default)(value) if isinstance(self.default, int | float) else value


@dataclass(frozen=True)
class Row:
    """One algorithm of a library.

    Parameters
    ----------
    creator : the library's own name of it
    summary : one line
    parameters : every parameter by our name
    """

    creator: str
    summary: str
    parameters: Mapping[str, Parameter] = field(hash=False)

    @property
    def defaults(self) -> dict[str, Any]:
        return {key: parameter.default for key, parameter in self.parameters.items()}

    @property
    def unavailable(self) -> str:
        """Why it cannot be used as it stands, with the cure; "" where it can. Nothing heavy is imported for it."""
        return ""

    @property
    def on_demand(self) -> bool:
        """Whether only what a parameter or a download can give is missing, such as weights."""
        return False


@dataclass(frozen=True)
class Part:
    """One plugin of a family: a row of the class's table by name, and its parameters, also as attributes.

    Parameters
    ----------
    name : under which it is registered
    parameters : the values that differ from the defaults; afterwards all

    Raises
    ------
    ParameterError
        A parameter that the row does not have, or a value it refuses.
    """

    table: ClassVar[Mapping[str, Row]]

    name: str
    parameters: Mapping[str, Any]

    @property
    def row(self) -> Row:
        return self.table[self.name]

    def __post_init__(self) -> None:
        known = self.row.parameters
        values = self.row.defaults
        for key, value in self.parameters.items():
            if key not in known:
                raise ParameterError(f"{self.name} has no parameter '{key}', {suggest(key, known)}")
            values[key] = known[key].checked(f"{self.name}.{key}", value)
        object.__setattr__(self, "parameters", values)
        vars(self).update(values)

    def __hash__(self) -> int:
        return hash((self.name, *self.parameters.values()))

    @classmethod
    def made(cls, name: str, /, **parameters: Any) -> Any:
        return cls(name, parameters)


P = TypeVar("P", bound=type[Part])


def register_table(cls: P) -> P:
    """Class decorator: add every row of the class's table as a plugin; the kind follows from the base class.

    Raises
    ------
    PluginError
        A name is taken, or the class has no kind.
    """
    kind = kind_of(cls, cls.__name__)
    plugin: Any = cls
    describes = getattr(plugin, "describes", None)
    for name, row in cls.table.items():
        register_family(
            kind,
            name,
            partial(cls.made, name),
            row.defaults,
            summary=row.summary,
            module=cls.__module__,
            unavailable=row.unavailable,
            on_demand=row.on_demand,
            block_parameters=plugin.block_parameters,
            compiled=plugin.compiled,
            describes=describes if describes in row.parameters else None,
        )
    return cls


def best_first(features: Features, count: int) -> Features:
    """The best `count` features in a fixed order: ties by position, size and angle."""
    x, y = features.xy.T
    return features.take(np.lexsort((features.angle, features.scale, x, y, -features.score))[:count])


#: What many rows share.
N_FEATURES = {"n_features": Parameter(5000, Ge(1), meaning="at most so many features, best first")}
DESCRIBE = {"describe": Parameter(True, meaning="return descriptors with the points")}
NORMALISE = {"normalise": Parameter("auto", choices=METHODS, meaning="how amplitude becomes 8 bits")}
WEIGHTS = Parameter(None, meaning="file of trained weights; None takes those that the library downloads")
