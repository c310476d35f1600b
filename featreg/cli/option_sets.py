"""Options that several commands share, as sets: a dataclass of annotated fields that a command takes as one argument.

    @takes
    def compare(images: ..., method: MethodOptions, output: OutputOptions) -> None: ...

Every field becomes an option of the command; the command is called with the sets filled in.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable
from typing import Any, get_type_hints


def offered(*sets: type) -> set[str]:
    """The names of the options of option sets."""
    return {field.name for kind in sets for field in dataclasses.fields(kind)}


def takes(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command whose parameters that are option sets are replaced by the sets' fields."""
    hints = get_type_hints(command, include_extras=True)
    sets: dict[str, Any] = {name: kind for name, kind in hints.items() if dataclasses.is_dataclass(kind)}
    parameters: list[inspect.Parameter] = []
    for name, parameter in inspect.signature(command).parameters.items():
        if name not in sets:
            parameters.append(parameter.replace(annotation=hints[name], kind=parameter.KEYWORD_ONLY))
            continue
        fields = get_type_hints(sets[name], include_extras=True)
        for field in dataclasses.fields(sets[name]):
            parameters.append(
                inspect.Parameter(
                    field.name, inspect.Parameter.KEYWORD_ONLY, default=field.default, annotation=fields[field.name]
                )
            )

    def run(**given: Any) -> None:
        filled = {
            name: kind(**{field.name: given.pop(field.name) for field in dataclasses.fields(kind)})
            for name, kind in sets.items()
        }
        command(**given, **filled)

    run.__name__, run.__doc__, run.__module__ = command.__name__, command.__doc__, command.__module__
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]  # functions may carry one
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return run
