"""A stack as a JSON file."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from featreg.errors import FeatregError, InputError
from featreg.geometry import model_from_dict, model_to_dict
from featreg.results.json_file import plain
from featreg.runtime.files import write_atomic
from featreg.stacks.closure import Loop
from featreg.stacks.jumps import Jump
from featreg.stacks.pairs import StackPair

if TYPE_CHECKING:
    from featreg.stacks.stack import Stack

SCHEMA_VERSION = 1


def write_stack(stack: Stack, path: Path) -> None:
    """Write a stack; the file appears whole or not at all."""
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
        "provenance": plain(dict(stack.provenance)),
    }
    write_atomic(path, json.dumps(content, indent=1, allow_nan=False).encode())


def read_stack(path: Path, kind: type[Stack]) -> Stack:
    """Read what `write_stack` wrote."""
    try:
        values: dict[str, Any] = json.loads(path.read_bytes())
        if values["kind"] != "stack" or values["schema_version"] != SCHEMA_VERSION:
            raise ValueError(f"its kind and version are {values['kind']!r} and {values['schema_version']!r}")
        made = kind(
            [str(name) for name in values["names"]],
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
            values["provenance"],
            [str(name) for name in values["names"]],
        )
        _check(made)
        return made
    except OSError as error:
        raise InputError(f"cannot read '{path}': {error.strerror or error}") from error
    except (ValueError, KeyError, TypeError, IndexError, FeatregError) as error:
        raise InputError(
            f"'{path}' is no stack of featreg ({error}); give the stack.json of `featreg stack`"
        ) from error


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
