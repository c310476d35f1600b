"""Families: many algorithms of one library as plugins, each a row of a table.

A room's file holds the table and one class that runs any row of it:

    TABLE = {"toy-corners": Row("Corners", "Corners of toys", {**N_FEATURES, "k": option(0.04, Gt(0))})}

    @register_table
    class ToyDetector(Member, Detector):
        table = TABLE

        def detect_features(self, image: Image) -> Features: ...  # self.row, self.parameters

A library of its own kind extends `Row`: how it is built, why it cannot be had, where its weights come from.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar

import numpy as np
from annotated_types import Ge

from featreg.errors import ParameterError, suggest
from featreg.registry import kind_of, register_family
from featreg.runtime.parameters import Parameter
from featreg.sar.normalise import METHODS
from featreg.types import Features


@dataclass(frozen=True)
class Option(Parameter):
    """A parameter of a row: what is declared of it, and what the library calls it.

    Parameters
    ----------
    keyword : the library's own name of it; "" where it does not reach the library under a name
    constants : choice -> what the library calls that
    """

    keyword: str = ""
    constants: Mapping[Any, Any] = field(default_factory=dict, hash=False)


class File(Option):
    """The path of a file, as text or `Path`, or None."""

    def allows(self, value: Any) -> bool:
        return isinstance(value, str | Path | None)

    @property
    def wanted(self) -> str:
        return "the path of a file or None"


def option(default: Any, limit: Any = None, *, choices: Any = (), meaning: str = "", keyword: str = "") -> Option:
    """Declare a parameter of a row.

    Parameters
    ----------
    default : its default; values must be of the same type
    limit : the range of its values: `Ge`, `Gt`, `Le`, `Lt`, `Interval`, `MultipleOf` or `Predicate` of annotated_types
    choices : the values it may have, or each of them with what the library calls it
    meaning : one line
    keyword : the library's own name of it
    """
    annotation: Any = Literal[tuple(choices)] if choices else Annotated[type(default), limit]
    constants = choices if isinstance(choices, Mapping) else {}
    return Option(**vars(Parameter.of(annotation, default, meaning)), keyword=keyword, constants=constants)


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
    parameters: Mapping[str, Option] = field(hash=False)

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
class Member:
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
            known[key].check(f"{self.name}.{key}", value)
            plain = isinstance(known[key].default, int | float)
            values[key] = type(known[key].default)(value) if plain else str(value) if isinstance(value, Path) else value
        object.__setattr__(self, "parameters", values)
        vars(self).update(values)

    def __hash__(self) -> int:
        return hash((self.name, *self.parameters.values()))

    @classmethod
    def made(cls, name: str, /, **parameters: Any) -> Any:
        return cls(name, parameters)


P = TypeVar("P", bound=type[Member])


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
            row.parameters,
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
N_FEATURES = {"n_features": option(5000, Ge(1), meaning="at most so many features, best first")}
DESCRIBE = {"describe": option(True, meaning="return descriptors with the points")}
NORMALISE = {"normalise": option("auto", choices=METHODS, meaning="how amplitude becomes 8 bits")}
