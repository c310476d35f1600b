"""`featreg mark`: a local page to mark homologous points by hand."""

from __future__ import annotations

from contextlib import suppress
from typing import Annotated

import typer

from featreg.cli.checking import check_output, whole_number


def mark(
    reference: Annotated[str, typer.Argument(metavar="REF", help="Reference image.", show_default=False)],
    secondary: Annotated[str, typer.Argument(metavar="SEC", help="Secondary image.", show_default=False)],
    output: Annotated[
        str,
        typer.Option(
            "--output", "-o", metavar="FILE", help="Points: .csv, .points (QGIS) or .pts (ENVI); taken up if it exists."
        ),
    ] = "points.csv",
    initial: Annotated[
        str | None,
        typer.Option("--initial", metavar="RESULT.json", help="A result whose model predicts from the start."),
    ] = None,
    port: Annotated[
        int, typer.Option("--port", metavar="N", parser=whole_number(0), help="Port to listen on; 0 takes a free one.")
    ] = 0,
    reference_band: Annotated[
        str | None,
        typer.Option("--reference-band", metavar="BAND", help="Which band of REF.", show_default="the only one"),
    ] = None,
    secondary_band: Annotated[
        str | None,
        typer.Option("--secondary-band", metavar="BAND", help="Which band of SEC.", show_default="the only one"),
    ] = None,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")] = True,
) -> None:
    """Mark homologous points of two images in a local web page.

    The points are saved after every click. Ctrl-C ends it. The file is a truth for `featreg compare --truth`.
    """
    from featreg.marking.server import require_web, serve

    require_web()
    check_output(output, "--output", inputs=[f for f in (reference, secondary, initial) if f is not None])
    from featreg.marking.points import MarkedPoints
    from featreg.marking.tiles import TiledScene

    model = None
    if initial is not None:
        from featreg.errors import InputError
        from featreg.interfaces import FailedFit
        from featreg.results.registration import Registration

        found = Registration.from_json(initial, tie_points=False).model
        if isinstance(found, FailedFit):
            raise InputError(f"--initial '{initial}' holds no model: {found.reason}")
        model = found
    scenes = TiledScene(reference, reference_band), TiledScene(secondary, secondary_band)
    points = MarkedPoints(output, (reference, secondary), (scenes[0].shape, scenes[1].shape), model)

    def started(address: str) -> None:
        typer.echo(f"mark points at {address}")
        typer.echo(f"saved after every step in {output}; Ctrl-C ends")
        if browser:
            import webbrowser

            webbrowser.open(address)

    with suppress(KeyboardInterrupt):
        serve(points, scenes, port=port, started=started)
    typer.echo(f"{len(points.points)} points in {output}")
