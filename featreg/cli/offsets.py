"""`featreg offsets`: the displacement field between two images."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from featreg.cli.options import (
    BandOption,
    NodataOption,
    announce_compiling,
    check_folder,
    check_output,
    counter,
    distance,
    whole_number,
)
from featreg.errors import ParameterError
from featreg.runtime.threads import limited_threads


def offsets(
    reference: Annotated[str, typer.Argument(metavar="REF", help="Reference image.", show_default=False)],
    secondary: Annotated[str, typer.Argument(metavar="SEC", help="Secondary image.", show_default=False)],
    output: Annotated[
        str,
        typer.Option("--output", "-o", metavar="OUT", help="GeoTIFF, or HDF5 (.h5) for MintPy.", show_default=False),
    ],
    initial: Annotated[
        str | None,
        typer.Option(
            "--initial",
            metavar="RESULT.json",
            help="A result of `featreg match`, around which to look.",
            show_default="geotransforms, else one grid",
        ),
    ] = None,
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
    mask_reference: Annotated[
        str | None,
        typer.Option(
            "--mask-reference", metavar="FILE", help="Image of the same size, 0 = no data.", show_default=False
        ),
    ] = None,
    mask_secondary: Annotated[
        str | None,
        typer.Option(
            "--mask-secondary", metavar="FILE", help="Image of the same size, 0 = no data.", show_default=False
        ),
    ] = None,
    scale: Annotated[
        str | None,
        typer.Option(
            "--scale",
            metavar="SCALE",
            help="What the samples are: amplitude, intensity or db.",
            show_default="told from the samples",
        ),
    ] = None,
    nodata: NodataOption = None,
    band: BandOption = None,
    reference_band: Annotated[
        str | None,
        typer.Option("--reference-band", metavar="BAND", help="That of the reference.", show_default="--band"),
    ] = None,
    secondary_band: Annotated[
        str | None,
        typer.Option("--secondary-band", metavar="BAND", help="That of the secondary.", show_default="--band"),
    ] = None,
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
    scheduler: Annotated[
        str | None,
        typer.Option(
            "--scheduler",
            metavar="ADDRESS",
            help="Run the blocks on the dask cluster of this scheduler, as tcp://host:8786.",
            show_default=False,
        ),
    ] = None,
    resume: Annotated[
        str | None,
        typer.Option(
            "--resume",
            metavar="DIR",
            help="Keep finished blocks in this folder, and use those that are there.",
            show_default=False,
        ),
    ] = None,
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
    inputs = [file for file in (reference, secondary, initial, mask_reference, mask_secondary) if file is not None]
    check_output(output, "--output", suffixes=[".tif", ".tiff", ".h5", ".he5", ".hdf5"], inputs=inputs)
    check_output(plot, "--plot", suffixes=[".png"], inputs=inputs)
    if scheduler is not None and workers is not None:
        raise ParameterError("--scheduler brings its own workers: leave --workers out")
    if resume is not None:
        check_folder(Path(resume) if Path(resume).is_dir() else Path(resume).parent, f"--resume '{resume}'")
    announce_compiling()
    with limited_threads(workers, 1):
        from featreg.displacement.run import offsets as measure

        field = measure(
            reference,
            secondary,
            step=step,
            window=window,
            search=search,
            initial=initial,
            reference_mask=mask_reference,
            secondary_mask=mask_secondary,
            nodata=nodata,
            scale=scale,
            band=band,
            reference_band=reference_band,
            secondary_band=secondary_band,
            block=block,
            workers=workers,
            scheduler=scheduler,
            resume=resume,
            progress=counter("blocks"),
        )
        field.to_file(output)
        written = [output]
        if plot is not None:
            from featreg.pictures.displacement import draw_offsets

            draw_offsets(field, plot)
            written.append(plot)
    typer.echo(f"{field}\n  written       {', '.join(written)}")
    raise typer.Exit(0 if field.good.any() else 3)
