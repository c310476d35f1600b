"""`featreg focus`: a complex image in, the focused image out, with a picture of both and the entropy on the way."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from featreg.cli import completion
from featreg.cli.checking import check_name, check_output, number, whole_number
from featreg.cli.options import BandOption
from featreg.cli.progress import counter, progress
from featreg.errors import InputError, ParameterError
from featreg.runtime.threads import limited_threads

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from featreg.focusing import FocusResult
    from featreg.types import Image

SUFFIXES = (".tif", ".tiff", ".npy")
#: Samples from which the range is divided into blocks where --range-blocks is not given, and samples of a block.
LARGE, BLOCK = 1 << 26, 1 << 25


def focus(
    image: Annotated[
        str,
        typer.Argument(metavar="IN", help="Complex image, see docs/formats.md.", show_default=False),
    ],
    output: Annotated[
        str,
        typer.Option(
            "--output", "-o", metavar="OUT", help="Complex GeoTIFF (.tif) or NPY (.npy) to write.", show_default=False
        ),
    ],
    method: Annotated[
        str,
        typer.Option(
            "--method",
            metavar="NAME",
            help="auto, mea, pmea, mca, pga or legendre.",
            autocompletion=completion.focus_methods,
        ),
    ] = "auto",
    azimuth_axis: Annotated[
        int,
        typer.Option(
            "--azimuth-axis", parser=whole_number(0), metavar="0|1", help="0: azimuth down the columns, 1: along rows."
        ),
    ] = 0,
    fraction: Annotated[
        float | None,
        typer.Option(
            "--fraction",
            parser=number,
            metavar="SHARE",
            help="Share of the range cells that are looked at.",
            show_default="as the method has it",
        ),
    ] = None,
    band: BandOption = None,
    normalize: Annotated[
        bool, typer.Option("--normalize/--no-normalize", help="Weight range cells alike, whatever their energy.")
    ] = True,
    detector: Annotated[
        str, typer.Option("--detector", metavar="NAME", help="Whose feature points pmea counts.")
    ] = "prewitt",
    max_iterations: Annotated[
        int, typer.Option("--max-iterations", parser=whole_number(1), metavar="N", help="Most iterations.")
    ] = 60,
    detrend: Annotated[
        bool, typer.Option("--detrend/--no-detrend", help="Leave the image where it was in azimuth.")
    ] = True,
    range_blocks: Annotated[
        int | None,
        typer.Option(
            "--range-blocks",
            parser=whole_number(1),
            metavar="N",
            help="Blocks of range cells with a phase each.",
            show_default="1, more beyond 67 million samples",
        ),
    ] = None,
    plot: Annotated[
        str | None,
        typer.Option(
            "--plot", metavar="FILE.png", help="Draw the image before and after, and the entropy.", show_default=False
        ),
    ] = None,
    json_file: Annotated[
        str | None,
        typer.Option("--json", metavar="FILE", help="Write phase, entropy and verdict.", show_default=False),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers", parser=whole_number(1), metavar="N", help="Most threads.", show_default="one per core"
        ),
    ] = None,
) -> None:
    """Focus a complex SAR image by autofocus.

    Estimates the phase error of every pulse from the image itself and removes it.

    Georeferencing is kept from GeoTIFF to GeoTIFF. Exit code 3 means that the phase, and so the output, which is still
    written, cannot be trusted.
    """
    inputs = [image, image.rpartition(":")[0]]
    check_output(output, "--output", suffixes=SUFFIXES, inputs=inputs)
    check_output(plot, "--plot", suffixes=[".png"], inputs=inputs)
    check_output(json_file, "--json", suffixes=[".json"], inputs=inputs)
    targets = [Path(p).absolute() for p in (output, plot, json_file) if p is not None]
    if len(set(targets)) < len(targets):
        raise ParameterError("--output, --plot and --json need different files")
    with limited_threads(workers):
        from featreg.focusing import METHODS
        from featreg.focusing import focus as sharpen
        from featreg.io import as_image

        check_name(method, METHODS, "autofocus method")
        progress(f"reading '{image}'")
        before = as_image(image, band=band)
        if not before.is_complex:
            raise InputError(f"{image}: holds real samples, whose phase is lost; focus needs a complex image")
        samples = before.pixels.size
        blocks = range_blocks or (1 if samples <= LARGE else -(-samples // BLOCK))
        start = time.perf_counter()
        result = sharpen(
            before,
            method,
            azimuth_axis=azimuth_axis,
            fraction=fraction,
            normalize=normalize,
            detector=detector,
            max_iterations=max_iterations,
            detrend=detrend,
            range_blocks=blocks,
            workers=workers,
            progress=counter("iteration"),
        )
        seconds = time.perf_counter() - start
        _write_image(Path(output), result.image, before)
        written = [output]
        if json_file is not None:
            from featreg.runtime.files import write_atomic

            text = json.dumps(_record(image, before, result), indent=1, allow_nan=False)
            write_atomic(Path(json_file), (text + "\n").encode())
            written.append(json_file)
        if plot is not None:
            from featreg.pictures.focus import draw_focus

            draw_focus(before, result, plot)
            written.append(plot)
    typer.echo(summary(result, seconds, written))
    raise typer.Exit(0 if result.status == "ok" else 3)


def summary(result: FocusResult, seconds: float, written: list[str]) -> str:
    """Return what a person wants to know of a result, in a few lines."""
    first, last = result.image_entropy
    blocks = len(result.block_edges) - 1
    among = f" in {blocks} range blocks" if blocks > 1 else ""
    iterations = f"{result.iterations} iteration{'s' if result.iterations != 1 else ''}"
    lines = [
        "ok" if result.status == "ok" else f"unreliable: {result.reason}",
        f"  method      {result.method}, {iterations} on {len(result.cells)} range cells{among}",
        f"  entropy     {first:.4f} before, {last:.4f} after",
    ]
    if result.deviation < float("inf"):
        lines.append(f"  phase       expected error {result.deviation:.3f} rad RMS, constant and linear part apart")
    lines += [f"  seconds     {seconds:.2f}", f"  written     {', '.join(written)}"]
    return "\n".join(lines)


def _record(path: str, image: Image, result: FocusResult) -> dict[str, Any]:
    from featreg.runtime.versions import versions

    height, width = image.shape
    return {
        "schema_version": 1,
        "method": result.method,
        "status": result.status,
        "reason": result.reason,
        "deviation": result.deviation if result.deviation < float("inf") else None,
        "gates": {name: gate.to_dict() for name, gate in result.gates.items()},
        "input": {"path": path, "width": width, "height": height},
        "image_entropy": list(result.image_entropy),
        "entropy": result.entropy.tolist(),
        "iterations": result.iterations,
        "cells": result.cells.tolist(),
        "block_edges": list(result.block_edges),
        "phase": result.phase.tolist(),
        "provenance": {"versions": versions()},
    }


def _write_image(target: Path, pixels: NDArray[np.complex64], source: Image) -> None:
    from featreg.io.writers import replacing, write_geotiff

    if target.suffix.lower() != ".npy":
        write_geotiff(target, pixels, source.geolocation)
        return
    import numpy as np

    with replacing(target) as temporary, temporary.open("wb") as file:
        np.save(file, pixels, allow_pickle=False)
