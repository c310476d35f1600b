"""Options of the commands that read a result: where its images are now."""

from __future__ import annotations

from typing import Annotated, TypeAlias

import typer

ReferenceOption: TypeAlias = Annotated[
    str | None,
    typer.Option("--reference", metavar="REF", help="Where the reference is now.", show_default="as in the result"),
]

SecondaryOption: TypeAlias = Annotated[
    str | None,
    typer.Option("--secondary", metavar="SEC", help="Where the secondary is now.", show_default="as in the result"),
]
