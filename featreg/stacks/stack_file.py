"""A stack as a JSON file."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from featreg.errors import FeatregError, InputError
from featreg.geometry import model_from_dict, model_to_dict
from featreg.interfaces import Model
from featreg.registry import model_name
from featreg.results.json_file import plain
from featreg.runtime.files import check_ending, write_atomic
from featreg.stacks.closure import Loop
from featreg.stacks.jumps import Jump
from featreg.stacks.pairs import StackPair

if TYPE_CHECKING:
    from featreg.stacks.stack import Stack

SCHEMA_VERSION = 1


def write_stack(stack: Stack, path: Path) -> None:
    """Write a stack; the file appears whole or not at all."""
    check_ending(path, ".json")
    options = _written(stack.provenance.get("options", {}))["options"]
    content = {
        "schema_version": SCHEMA_VERSION,
        "kind": "stack",
        "names": list(stack.names),
        "reference": stack.reference,
        "shape": list(stack.shape),
        "models": [None if model is None else model_to_dict(model) for model in stack.models],
        "status": list(stack.status),
        "reasons": list(stack.reasons),
        "standard_errors": [None if math.isnan(v) else v for v in stack.standard_errors.tolist()],
        "closure": list(stack.closure),
        "loops": [list(loop) for loop in stack.loops],
        "jumps": [list(jump) for jump in stack.jumps],
        "pairs": [pair.to_dict() for pair in stack.pairs],
        "provenance": {
            **plain(dict(stack.provenance)),
            "options": options,
        },
    }
    write_atomic(path, json.dumps(content, indent=1, allow_nan=False).encode())


def read_stack(path: Path, kind: type[Stack]) -> Stack:
    """Read what `write_stack` wrote."""
    try:
        values: dict[str, Any] = json.loads(path.read_bytes())
        if values["kind"] != "stack" or values["schema_version"] != SCHEMA_VERSION:
            raise ValueError(f"its kind and version are {values['kind']!r} and {values['schema_version']!r}")
        names = [str(name) for name in values["names"]]
        made = kind(
            names,
            int(values["reference"]),
            (int(values["shape"][0]), int(values["shape"][1])),
            [None if model is None else model_from_dict(model) for model in values["models"]],
            [str(status) for status in values["status"]],
            [str(reason) for reason in values["reasons"]],
            np.array([math.nan if v is None else v for v in values["standard_errors"]], np.float64),
            [None if v is None else float(v) for v in values["closure"]],
            [Loop(int(a), int(b), int(c), float(v)) for a, b, c, v in values["loops"]],
            [Jump(int(i), float(dx), float(dy)) for i, dx, dy in values["jumps"]],
            [StackPair.from_dict(pair) for pair in values["pairs"]],
            {**values["provenance"], "options": _options(values["provenance"]["options"])},
            # Images that were arrays are in no file.
            [] if any(name == f"image {i}" and not Path(name).exists() for i, name in enumerate(names)) else names,
        )
        _check(made)
        return made
    except OSError as error:
        raise InputError(f"cannot read '{path}': {error.strerror or error}") from error
    except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError, FeatregError) as error:
        raise InputError(
            f"'{path}' is no stack of featreg ({error}); give the stack.json of `featreg stack`"
        ) from error


def _written(value: Any) -> Any:
    """An option in the types of JSON, so that `_given` gives it back: numbers that JSON lacks by their names."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, bool | str | int):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else {"number": repr(value)}
    if isinstance(value, complex):
        return {"number": repr(value)}
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, list | tuple):
        return [_written(part) for part in value]
    if isinstance(value, Mapping):
        return {"options": {str(name): _written(part) for name, part in value.items()}}
    if isinstance(value, type) and issubclass(value, Model):
        return model_name(value)
    if isinstance(value, Model):
        return {"model": model_to_dict(value)}
    return {"object": getattr(value, "__qualname__", type(value).__qualname__)}


def _options(values: Mapping[str, Any]) -> dict[str, Any]:
    return {str(name): _given(part) for name, part in values.items()}


def _given(value: Any) -> Any:
    """What `_written` wrote; an object that no file holds is named, see `Unkept`."""
    if isinstance(value, list):
        return [_given(part) for part in value]
    if not isinstance(value, Mapping):
        return value
    if "number" in value:
        number = complex(value["number"])
        return number if value["number"].endswith(("j", "j)")) else number.real
    if "model" in value:
        return model_from_dict(value["model"])
    if "object" in value:
        return Unkept(str(value["object"]))
    return _options(value["options"])


@dataclass(frozen=True)
class Unkept:
    """An option that was an object of the caller's program, of which a file keeps the name only."""

    name: str


def _check(stack: Stack) -> None:
    """Raise a `ValueError` where the parts of a stack do not fit each other."""
    count = len(stack.names)
    columns = ("models", "status", "reasons", "standard_errors", "closure")
    unequal = [name for name in columns if len(getattr(stack, name)) != count]
    if unequal:
        raise ValueError(f"it names {count} images and holds another number of {', '.join(unequal)}")
    numbers = [stack.reference, *(jump.image for jump in stack.jumps)]
    numbers += [n for pair in stack.pairs for n in (pair.first, pair.second)]
    numbers += [n for loop in stack.loops for n in (loop.a, loop.b, loop.c)]
    if not all(0 <= n < count for n in numbers):
        raise ValueError(f"it numbers an image that is none of its {count}")
    if stack.models[stack.reference] is None or not {"options", "pairs"} <= set(stack.provenance):
        raise ValueError("its reference has no model, or the options of its pairs are missing")
