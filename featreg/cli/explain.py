"""`featreg explain`: why a result is trusted or not, gate by gate, and what to try."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from featreg.errors import InputError


def explain(
    result_file: Annotated[
        str,
        typer.Argument(
            metavar="RESULT.json",
            help="What `featreg match --json` or `featreg focus --json` wrote.",
            show_default=False,
        ),
    ],
) -> None:
    """Say why a result is trusted or not, and what to try.

    Every gate with what it measures, its value, its limit and why the limit is there; for a failed one the likely
    cause and what to try. Exit code 3 means that the result cannot be trusted.
    """
    status, text = explain_file(result_file)
    typer.echo(text)
    raise typer.Exit(0 if status == "ok" else 3)


def explain_file(path: str | Path) -> tuple[str, str]:
    """Return the status of a result's file and its explanation.

    Raises
    ------
    InputError
        The file is no result of featreg.
    """
    from featreg.results.explaining import explain_focus
    from featreg.results.registration import Registration

    focused = _focus_record(Path(path))
    if focused is not None:
        try:
            return explain_focus(focused)
        except InputError as error:
            raise InputError(f"'{path}' is {error}") from error
    result = Registration.from_json(path)
    try:
        return result.status, result.explain()
    except (KeyError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        raise InputError(f"'{path}' is not a whole featreg result: its provenance cannot be told ({error})") from error


def _focus_record(path: Path) -> dict[str, Any] | None:
    """The object in a file, if it is one of `featreg focus`; anything else is for the reader of registrations."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return data if isinstance(data, dict) and "image_entropy" in data else None
