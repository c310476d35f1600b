"""`featreg view`: the page of one result."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from featreg.cli.checking import check_output
from featreg.cli.result_options import ReferenceOption, SecondaryOption


def view(
    result_file: Annotated[
        str, typer.Argument(metavar="RESULT.json", help="What `featreg match --json` wrote.", show_default=False)
    ],
    output: Annotated[
        str | None,
        typer.Option(
            "--output", "-o", metavar="FILE.html", help="Page to write.", show_default="one in a temporary folder"
        ),
    ] = None,
    reference: ReferenceOption = None,
    secondary: SecondaryOption = None,
    truth: Annotated[
        str | None,
        typer.Option("--truth", metavar="FILE", help="Show tie points as correct or false.", show_default=False),
    ] = None,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")] = True,
) -> None:
    """Look at a result in a browser.

    The page holds both images to swipe and flicker, the overlay, tie points, residuals and gates.

    The page is one file that needs no network. Exit code 3 means that the registration cannot be trusted.
    """
    inputs = [file for file in (result_file, reference, secondary, truth) if file is not None]
    check_output(output, "--output", suffixes=[".html", ".htm"], inputs=inputs)
    from featreg.report.from_registration import write_registration_report
    from featreg.results.registration import Registration

    result = Registration.from_json(result_file)
    if output is None:
        # The browser reads the page after this program has ended, so nobody can take it away.
        output = str(Path(tempfile.mkdtemp(prefix="featreg-view-"), f"{Path(result_file).stem}.html"))
    write_registration_report(output, result, reference=reference, secondary=secondary, truth=truth)
    typer.echo(f"written: {output}")
    if result.status != "ok":
        typer.echo(f"warning: the registration is {result.status} ({result.reason})", err=True)
    if browser:
        import webbrowser

        webbrowser.open(Path(output).absolute().as_uri())
    raise typer.Exit(0 if result.status == "ok" else 3)
