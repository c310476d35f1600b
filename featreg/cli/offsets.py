"""`featreg offsets`: the displacement field between two images."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from featreg.cli.block_options import ClusterOptions, kept_when_interrupted
from featreg.cli.checking import check_output, distance, whole_number
from featreg.cli.option_sets import takes
from featreg.cli.options import MaskOptions, ReadingOptions
from featreg.cli.progress import announce_compiling, counter
from featreg.runtime.threads import limited_threads


@takes
def offsets(
    reference: Annotated[str, typer.Argument(metavar="REF", help="Reference image.", show_default=False)],
    secondary: Annotated[str, typer.Argument(metavar="SEC", help="Secondary image.", show_default=False)],
    output: Annotated[
        str,
        typer.Option("--output", "-o", metavar="OUT", help="GeoTIFF, or HDF5 (.h5) for MintPy.", show_default=False),
    ],
    dates: Annotated[
        str | None,
        typer.Option(
            "--dates",
            metavar="YYYYMMDD,YYYYMMDD",
            help="Days of the two images, under which MintPy keeps them.",
            show_default="from the names of the files",
        ),
    ] = None,
    initial: Annotated[
        str | None,
        typer.Option(
            "--initial",
            metavar="RESULT.json",
            help="A result of `featreg match`, around which to look.",
            show_default="geotransforms, else one grid",
        ),
    ] = None,
    *,
    step: Annotated[
        int, typer.Option("--step", parser=whole_number(1), metavar="PX", help="Side of a cell of the field.")
    ] = 16,
    window: Annotated[
        int, typer.Option("--window", parser=whole_number(8), metavar="PX", help="Side of the correlated windows.")
    ] = 64,
    search: Annotated[
        float,
        typer.Option("--search", parser=distance, metavar="PX", help="Largest displacement beyond what is known."),
    ] = 16.0,
    reading: ReadingOptions,
    masks: MaskOptions,
    block: Annotated[
        int | None,
        typer.Option(
            "--block",
            parser=whole_number(1),
            metavar="PX",
            help="Work in blocks of about this many pixels a side.",
            show_default="1024 for images of more than 4 million pixels",
        ),
    ] = None,
    blocks: ClusterOptions,
    plot: Annotated[
        str | None,
        typer.Option(
            "--plot", metavar="FILE.png", help="Draw length, direction and reasons of the field.", show_default=False
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers",
            parser=whole_number(1),
            metavar="N",
            help="Worker processes, where it is done in blocks.",
            show_default="every processor",
        ),
    ] = None,
) -> None:
    """Measure how far each cell of a grid moved between two images.

    Writes dx, dy, their covariance, the height and significance of the peak, and a reason for every cell without a
    displacement, as named bands. Exit code 3 means that no cell could be measured.
    """
    given = (reference, secondary, initial, masks.mask_reference, masks.mask_secondary)
    inputs = [file for file in given if file is not None]
    check_output(output, "--output", suffixes=[".tif", ".tiff", ".h5", ".he5", ".hdf5"], inputs=inputs)
    check_output(plot, "--plot", suffixes=[".png"], inputs=inputs)
    blocks.check(workers)
    days = None if dates is None else [part.strip() for part in dates.split(",")]
    from featreg.displacement.raster import days_of

    # Before the work, not after it.
    days_of(Path(output), reference, secondary, days)
    with kept_when_interrupted(blocks.resume), limited_threads(workers, 1):
        announce_compiling()
        from featreg.displacement.run import offsets as measure

        field = measure(
            reference,
            secondary,
            step=step,
            window=window,
            search=search,
            initial=initial,
            block=block,
            workers=workers,
            scheduler=blocks.scheduler,
            resume=blocks.resume,
            progress=counter("blocks"),
            **reading.reading(),
            **masks.keywords(),
        )
        field.to_file(output, dates=days)
        written = [output]
        if plot is not None:
            from featreg.pictures.displacement import draw_offsets

            draw_offsets(field, plot)
            written.append(plot)
    typer.echo(f"{field}\n  written       {', '.join(written)}")
    raise typer.Exit(0 if field.good.any() else 3)
