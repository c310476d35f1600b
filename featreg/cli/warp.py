"""`featreg warp`: the product of a registration, the secondary on the reference grid."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from featreg.cli import completion
from featreg.cli.checking import check_name, check_output, whole_number
from featreg.cli.options import NodataOption
from featreg.cli.progress import counter
from featreg.runtime.threads import limited_threads

if TYPE_CHECKING:
    from featreg.products.warping import Product


def factors(text: Any) -> Any:
    """Read one number > 0, or two with a comma between them."""
    try:
        values = [float(part) for part in str(text).split(",")]
    except ValueError:
        values = []
    if len(values) not in (1, 2) or not all(0 < v < float("inf") for v in values):
        raise typer.BadParameter(f"one number > 0, or two as SX,SY, is needed, got '{text}'")
    return values[0], values[-1]


def warp(
    result_file: Annotated[
        str, typer.Argument(metavar="RESULT.json", help="What `featreg match --json` wrote.", show_default=False)
    ],
    secondary: Annotated[
        str,
        typer.Argument(
            metavar="SEC",
            help="The secondary of that result, or another file of its footprint (bands, pixel size).",
            show_default=False,
        ),
    ],
    output: Annotated[
        str, typer.Option("--output", "-o", metavar="OUT.tif", help="GeoTIFF to write.", show_default=False)
    ],
    like: Annotated[
        str | None,
        typer.Option(
            "--like",
            metavar="REF",
            help="The reference image, or a file of its footprint, whose grid and georeferencing the output gets.",
            show_default="the path in the result",
        ),
    ] = None,
    resampling: Annotated[
        str,
        typer.Option(
            "--resampling",
            metavar="KIND",
            help="nearest, bilinear, cubic or lanczos.",
            autocompletion=completion.words("nearest", "bilinear", "cubic", "lanczos"),
        ),
    ] = "lanczos",
    band: Annotated[
        str | None,
        typer.Option("--band", metavar="BAND", help="Only this band: its name, number, iq or rgb.", show_default="all"),
    ] = None,
    secondary_scale: Annotated[
        Any,
        typer.Option(
            "--secondary-scale",
            parser=factors,
            metavar="S|SX,SY",
            help="Pixels of SEC per pixel of the secondary that was matched.",
            show_default="told from georeferencing or size",
        ),
    ] = None,
    deramp: Annotated[
        bool,
        typer.Option(
            "--deramp",
            help="Interpolate complex samples without their phase ramp: TOPS by its annotation, else as they show it.",
        ),
    ] = False,
    coherence: Annotated[
        str | None,
        typer.Option(
            "--coherence",
            metavar="FILE.tif",
            help="Also write the coherence with the reference; both images complex.",
            show_default=False,
        ),
    ] = None,
    coherence_window: Annotated[
        int, typer.Option("--coherence-window", parser=whole_number(3), metavar="N", help="Side in pixels, odd.")
    ] = 5,
    stac: Annotated[
        str | None,
        typer.Option(
            "--stac",
            metavar="TIME",
            help="Also write a STAC item OUT.json; TIME or START/END: when SEC was acquired (2024-05-01T05:11:20Z).",
            show_default=False,
        ),
    ] = None,
    scale: Annotated[
        str | None,
        typer.Option(
            "--scale",
            metavar="SCALE",
            help="What the samples are: amplitude, intensity or db.",
            show_default="as in the result",
        ),
    ] = None,
    calibrate: Annotated[
        str | None,
        typer.Option(
            "--calibrate",
            metavar="QUANTITY",
            help="Write sigma0, beta0 or gamma0 by the metadata of the product SEC.",
            show_default="as in the result",
            autocompletion=completion.words("sigma0", "beta0", "gamma0"),
        ),
    ] = None,
    nodata: NodataOption = None,
    workers: Annotated[
        int | None,
        typer.Option("--workers", parser=whole_number(1), metavar="N", help="Threads.", show_default="one per core"),
    ] = None,
) -> None:
    """Resample the secondary onto the reference.

    Writes a cloud-optimised GeoTIFF on the reference's grid and with its georeferencing, scenes of any size. Samples
    keep the file's dtype, scale and nodata value. Exit code 3 means that the registration, and so the output, cannot be
    trusted.
    """
    inputs = [result_file, secondary, *([like] if like else [])]
    check_output(output, "--output", suffixes=[".tif", ".tiff"], inputs=inputs)
    check_output(coherence, "--coherence", suffixes=[".tif", ".tiff"], inputs=inputs)
    for target in (output, coherence):
        if stac is not None and target is not None:
            check_output(str(Path(target).with_suffix(".json")), "--stac", inputs=inputs)
    with limited_threads(workers):
        from featreg.io.scales import SCALES
        from featreg.products.resample import TAPS
        from featreg.products.warping import warp_file
        from featreg.results.registration import Registration

        check_name(resampling, TAPS, "resampling")
        if scale is not None:
            check_name(scale, SCALES, "scale")
        result = Registration.from_json(result_file, tie_points=False)
        product = warp_file(
            result,
            secondary,
            output,
            like=like,
            resampling=resampling,
            band=band,
            scale=scale,
            nodata=nodata,
            calibrate=calibrate,
            secondary_scale=secondary_scale,
            deramp=deramp,
            coherence=coherence,
            coherence_window=coherence_window,
            stac=stac,
            workers=workers,
            progress=counter(f"resampling '{secondary}'"),
        )
    for line in _summary(product, output, coherence):
        typer.echo(line)
    raise typer.Exit(0 if result.status == "ok" else 3)


def _summary(product: Product, output: str, coherence: str | None) -> list[str]:
    from featreg.products.tops_phase import TopsPhase

    height, width = product.shape
    bands = "" if len(product.bands) == 1 else f"{len(product.bands)} bands, "
    place = "georeferenced as the reference" if product.georeferenced else "without georeferencing"
    blank = "" if product.nodata is None else f", nodata {product.nodata:g}"
    lines = [
        f"written: {output}, {bands}{width} x {height} pixels, {product.dtype}, {place}{blank}, "
        f"{100 * product.valid:.1f} % of the reference covered"
    ]
    if isinstance(product.ramp, TopsPhase):
        lines.append(f"phase ramp: that of {product.ramp.bursts} TOPS bursts, as the annotation states it")
    elif product.ramp is not None:
        x, y = (f"{v:.2f}" for v in product.ramp.concentration)
        lines.append(f"phase ramp: agrees with the samples by {x} along x, {y} along y (1 = wholly)")
    if coherence is not None and product.coherence is not None:
        lines.append(f"written: {coherence}, mean coherence {product.coherence:.3f}")
    return [*lines, *(f"written: {item}, a STAC item" for item in product.items)]
