"""`featreg list`: a line for every name there is, and what one takes: defaults, ranges, choices, meanings."""

from __future__ import annotations

import difflib
import json
import math
import os
import shutil
import sys
import textwrap
from collections.abc import Iterator, Mapping
from itertools import groupby
from typing import TYPE_CHECKING, Annotated, Any

import typer

from featreg.cli import completion
from featreg.cli.listed import KINDS, Item
from featreg.cli.terminal import print_styled
from featreg.errors import FeatregError, UnknownNameError, suggest

if TYPE_CHECKING:
    from featreg.runtime.parameters import Parameter


def list_names(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="[KIND | NAME]",
            help=f"A kind ({', '.join(KINDS)}), or what is to be shown in full; without it, all kinds.",
            show_default=False,
            autocompletion=completion.listed_names,
        ),
    ] = None,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="Show parameters with defaults, ranges and meanings.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON for machines.")] = False,
) -> None:
    """List methods and parts, or show what one of them takes."""
    from featreg.registry import broken

    items = {kind: _items(kind) for kind in KINDS}
    named = [item for found in items.values() for item in found if item.name == name]
    if name is not None and name not in KINDS and not named:
        known = [*KINDS, *{item.name for found in items.values() for item in found}]
        near = difflib.get_close_matches(name, known, cutoff=0.5)
        raise UnknownNameError(f"unknown kind or name '{name}', {suggest(name, near or KINDS)}")
    shown = [kind for kind in KINDS if name is None or kind == name]
    if as_json:
        listed = [_as_json(item) for item in [*(item for kind in shown for item in items[kind]), *named]]
        listed += [_hidden_as_json(module, reason) for module, reason in broken().items()]
        typer.echo(json.dumps(listed, indent=2))
        return
    for kind in shown:
        print_styled([[(kind, "bold cyan"), ("" if items[kind] else " (none yet)", "")]])
        for item in items[kind]:
            if verbose:
                typer.echo(_in_full(item))
            else:
                print_styled([_line(item, max(len(i.name) for i in items[kind]))])
    for item in named:
        typer.echo(f"{item.kind}\n{_in_full(item)}")
    if broken():
        typer.echo("hidden, because they cannot be imported")
        for module, reason in broken().items():
            typer.echo(_wrapped(f"{module}: {reason}", 2))


def _items(kind: str) -> list[Item]:
    from featreg import registry

    if kind != "method":
        return [Item(kind, e.name, e.summary, e.unavailable) for e in registry.entries(kind)]
    found = []
    for name, preset in sorted(registry.presets().items()):
        try:
            parts = [registry.entry(role, part.name) for role, part in preset.parts]
            why = "; ".join(f"{e.kind} {e.name}: {e.unavailable}" for e in parts if e.unavailable)
        except FeatregError as error:
            why = str(error)
        found.append(Item(kind, name, preset.summary, why))
    return found


def _line(item: Item, width: int) -> list[tuple[str, str]]:
    """One line, cut at the width of the terminal; `featreg list NAME` says all."""
    text = item.summary
    if item.unavailable:
        text = f"{text.removesuffix('.')}; unavailable: {item.unavailable}"
        if _columns() is not None:  # the reason comes first where there is no room for both
            text = f"unavailable: {item.unavailable}"
    name, left = f"  {item.name:<{width}}  ", _columns()
    if left is not None and len(name) + len(text) > left:
        text = text[: max(0, left - len(name) - 3)].rstrip() + "..."
    return [(name, "dim" if item.unavailable else "bold"), (text, "dim" if item.unavailable else "")]


def _columns() -> int | None:
    """Width of the terminal; None where there is none, as for `grep`."""
    if not (sys.stdout.isatty() or "COLUMNS" in os.environ):
        return None
    return max(40, shutil.get_terminal_size().columns)


def _in_full(item: Item) -> str:
    """The name, the summary, and every parameter; those of a method by part."""
    lines = [f"  {item.name}", _wrapped(item.summary, 4)]
    if item.unavailable:
        lines.append(_wrapped(f"unavailable: {item.unavailable}", 4))
    parameters, known = item.parameters(), item.declared()
    lines += _values({key: value for key, value in parameters.items() if not isinstance(value, Mapping)}, known, "", 4)
    for part, values in parameters.items():
        if isinstance(values, Mapping):
            # A method's record has "refinement" beside the switch "refine".
            role = {"locating": "locate", "refinement": "refine"}.get(part, part)
            what = values.get("name", "")
            lines.append(f"    {'filter' if what == role else role}: {what}".removesuffix(": "))
            lines += _values({key: value for key, value in values.items() if key != "name"}, known, f"{role}.", 6)
    return "\n".join(lines)


def _values(values: Mapping[str, Any], known: Mapping[str, Parameter], part: str, pad: int) -> Iterator[str]:
    """Each parameter's value and range, then the meaning that it may share with the next."""

    def meaning(key: str) -> str:
        return known[part + key].meaning if part + key in known else ""

    for text, keys in groupby(values, meaning):
        for key in keys:
            one = known.get(part + key)
            right = f" ({one.wanted})" if one is not None and one.kind is not None else ""
            yield _wrapped(f"{key} = {_shown(values[key])}{right}", pad, 2)
        if text:
            yield _wrapped(text, pad + 4)


def _as_json(item: Item) -> dict[str, Any]:
    from featreg.results.json_file import plain

    known = item.declared()
    return {
        "kind": item.kind,
        "name": item.name,
        "summary": item.summary,
        "parameters": plain(item.parameters()),
        "range": {key: limits for key, one in known.items() if (limits := _limits(one))},
        "choices": {key: list(one.choices) for key, one in known.items() if one.choices},
        "meaning": {key: one.meaning for key, one in known.items() if one.meaning},
        "available": not item.unavailable,
        "unavailable": item.unavailable,
    }


def _hidden_as_json(module: str, reason: str) -> dict[str, Any]:
    empty: dict[str, Any] = {"parameters": {}, "range": {}, "choices": {}, "meaning": {}}
    return {"kind": None, "name": module, "summary": "", **empty, "available": False, "unavailable": reason}


def _limits(one: Parameter) -> dict[str, Any]:
    """Bounds by the names of `annotated_types`; true for what else must hold."""
    found: dict[str, Any] = {key: bound for key, bound in one.bounds.items() if math.isfinite(bound)}
    if len(found) < len(one.bounds):
        found["finite"] = True
    return found | {holds.__name__: True for holds in one.predicates}


def _wrapped(text: str, pad: int, hang: int = 0) -> str:
    """Wrapped at the width of the terminal, where there is one."""
    first, rest = " " * pad, " " * (pad + hang)
    width = _columns()
    if width is None:
        return first + text
    return textwrap.fill(
        text,
        width,
        initial_indent=first,
        subsequent_indent=rest,
        break_long_words=False,
        break_on_hyphens=False,
    )


def _shown(value: Any) -> str:
    return json.dumps(value) if isinstance(value, bool | list | tuple) or value is None else str(value)
