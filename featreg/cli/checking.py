"""Values and paths that a command was given: what they may be, and the one line that says what would be right."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import typer

from featreg.errors import InputError, ParameterError, suggest
from featreg.runtime.files import folder_of, is_stream

#: In place of a file's name: what would be written goes to the standard output.
STDOUT = "-"


def whole_number(least: int) -> Callable[[Any], int]:
    """Return a reader of whole numbers from `least` on, whose complaint says what was given."""

    def read(text: Any) -> int:
        try:
            value = int(str(text))
        except ValueError:
            value = least - 1
        if value < least:
            raise typer.BadParameter(f"a whole number >= {least} is needed, got '{text}'")
        return value

    return read


def number(text: Any) -> float:
    """Read a number."""
    try:
        return float(text)
    except ValueError as error:
        raise typer.BadParameter(f"a number is needed, got '{text}'") from error


def distance(text: Any) -> float:
    """Read a number of pixels greater than 0."""
    value = number(text)
    if not 0 < value < float("inf"):
        raise typer.BadParameter(f"a number of pixels > 0 is needed, got '{text}'")
    return value


def check_output(
    path: str | None, what: str, *, suffixes: Sequence[str] = (), inputs: Iterable[str] = (), stdout: bool = False
) -> None:
    """Raise an `InputError` where a file could not be written, before any work is done for it.

    Parameters
    ----------
    path : None is no file, and right
    what : the option, for the message
    suffixes : how the name may end
    inputs : files that must not be overwritten
    stdout : whether "-" may stand for the standard output
    """
    if path is None or (stdout and path == STDOUT):
        return
    target = Path(path)
    if not path or path == "-":
        raise InputError(f"{what} needs the name of a file, got '{path}'")
    if target.is_dir():
        raise InputError(
            f"{what} '{path}' is a directory, give a file name such as '{target / ('out' + _first(suffixes))}'"
        )
    if suffixes and target.suffix.lower() not in suffixes:
        raise InputError(f"{what} '{path}' must end in {' or '.join(suffixes)}")
    if not is_stream(target):
        check_folder(folder_of(target), f"{what} '{path}'")
    if target.exists() and not os.access(target, os.W_OK):
        raise InputError(f"{what} '{path}' exists and may not be replaced, give another name")
    for given in inputs:
        if target.exists() and Path(given).exists() and target.samefile(given):
            raise InputError(f"{what} '{path}' would replace an input, give another name")


def check_folder(folder: Path, what: str) -> None:
    """Raise an `InputError` where no file can be made in a folder."""
    if not folder.exists():
        raise InputError(f"{what}: the folder '{folder}' does not exist, make it first")
    if not folder.is_dir():
        raise InputError(f"{what}: '{folder}' is a file, a folder is needed")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"{what}: the folder '{folder}' may not be written to, choose another")


def check_name(given: str, known: Iterable[str], what: str) -> None:
    """Raise a `ParameterError` that suggests the nearest name where `given` is none of those known."""
    names = list(known)
    if given not in names:
        raise ParameterError(f"unknown {what} '{given}', {suggest(given, names)}")


def _first(suffixes: Sequence[str]) -> str:
    return suffixes[0] if suffixes else ".json"
