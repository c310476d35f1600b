"""`featreg export`: tie points for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from featreg.cli import completion
from featreg.cli.checking import check_name, check_output
from featreg.cli.result_options import ReferenceOption, SecondaryOption

#: Held beside `featreg.exports.formats` by a test, so that help needs no import of it.
NAMES = ("csv", "parquet", "gdal", "qgis", "envi", "colmap", "rpc", "geojson", "gpkg", "geoparquet")


def export(
    result_file: Annotated[
        str, typer.Argument(metavar="RESULT.json", help="What `featreg match --json` wrote.", show_default=False)
    ],
    to: Annotated[
        str,
        typer.Option(
            "--to",
            metavar="FORMAT",
            help=f"One of {', '.join(NAMES)}.",
            show_default=False,
            autocompletion=completion.words(*NAMES),
        ),
    ],
    output: Annotated[
        str,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="File to write: .csv, .parquet, .vrt .tif or .txt (gdal), .points, .pts, .db, _RPC.TXT or .RPB, "
            ".geojson, .gpkg.",
            show_default=False,
        ),
    ],
    stage: Annotated[
        str, typer.Option("--stage", metavar="NAME", help="Which tie points: inliers, a filter's name, or all.")
    ] = "inliers",
    reference: ReferenceOption = None,
    secondary: SecondaryOption = None,
) -> None:
    """Write the tie points for another program.

    Each format gets its own pixel convention. Exit code 3 means that the registration, and so the tie points, cannot be
    trusted; they are still written.
    """
    check_name(to, NAMES, "format")
    from featreg.results.json_file import tie_point_file

    inputs = [result_file, str(tie_point_file(Path(result_file))), reference, secondary]
    check_output(output, "--output", inputs=[f for f in inputs if f is not None])
    from featreg.exports.formats import WITHOUT_POINTS
    from featreg.exports.formats import export as write
    from featreg.results.registration import Registration

    result = Registration.from_json(result_file)
    count = write(result, output, to=to, stage=stage, reference=reference, secondary=secondary)
    held = "the secondary's corrected RPC" if to in WITHOUT_POINTS else f"{count} tie points ({stage})"
    typer.echo(f"written: {output}, {held}")
    if result.status != "ok":
        typer.echo(f"warning: the registration is {result.status} ({result.reason})", err=True)
    raise typer.Exit(0 if result.status == "ok" else 3)
