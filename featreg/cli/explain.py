"""`featreg explain`: why a result is trusted or not, gate by gate, and what to try."""

from __future__ import annotations

from typing import Annotated

import typer


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
    """Say in plain words why a result is trusted or not, and what to try.

    Every gate with what it measures, its value, its limit and why the limit is there; for a failed one the likely
    cause and what to try. Exit code 3 means that the result cannot be trusted.
    """
    from featreg.results.explaining import explain_file

    status, text = explain_file(result_file)
    typer.echo(text)
    raise typer.Exit(0 if status == "ok" else 3)
