"""What is printed where someone looks: colours and widths of a terminal, none of them in a pipe or with NO_COLOR."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterable

import typer

#: Characters a line where nothing says how many there are.
WIDTH = 100


def terminal_width() -> int:
    """Characters that fit on a line of the standard output."""
    return max(40, shutil.get_terminal_size((WIDTH, 24)).columns)


def coloured() -> bool:
    """Whether the standard output shows colours, and nobody asked for none (https://no-color.org)."""
    return sys.stdout.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def print_styled(lines: Iterable[Iterable[tuple[str, str]]]) -> None:
    """Print lines of (text, style), styles as rich names them."""
    if not coloured():
        for line in lines:
            typer.echo("".join(text for text, _ in line))
        return
    from rich.console import Console
    from rich.text import Text

    console = Console(file=sys.stdout, force_terminal=True, highlight=False, soft_wrap=True)
    for line in lines:
        console.print(Text.assemble(*((text, style) for text, style in line if text)))
