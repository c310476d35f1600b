"""`featreg match` and `featreg warp`: one pair, and the product of its registration."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from featreg.cli_options import (
    FeaturesOption,
    ModelOption,
    NodataOption,
    RefineOption,
    ScaleOption,
    SeedOption,
    SetOption,
    announce_compiling,
    check_name,
    check_output,
    distance,
    limited_threads,
    parse_settings,
    progress,
    whole_number,
)
from featreg.errors import InputError, ParameterError

if TYPE_CHECKING:
    from featreg.types import Geolocation, Registration

RADIUS = 20.0


def match(
    reference: Annotated[str, typer.Argument(metavar="REF", help="Reference image.", show_default=False)],
    secondary: Annotated[str, typer.Argument(metavar="SEC", help="Secondary image.", show_default=False)],
    method: Annotated[str, typer.Option("--method", metavar="NAME", help="One of `featreg list method`.")] = "sar-orb",
    model: ModelOption = None,
    settings: SetOption = None,
    seed: SeedOption = 0,
    n_features: FeaturesOption = None,
    refine: RefineOption = None,
    scale: ScaleOption = None,
    nodata: NodataOption = None,
    initial: Annotated[
        str | None,
        typer.Option(
            "--initial", metavar="RESULT.json", help="An earlier result to search around.", show_default=False
        ),
    ] = None,
    search_radius: Annotated[
        float | None,
        typer.Option(
            "--search-radius",
            parser=distance,
            metavar="PX",
            help="How far from --initial a tie point may lie.",
            show_default=f"{RADIUS:g}",
        ),
    ] = None,
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
    json_file: Annotated[
        str | None,
        typer.Option("--json", metavar="FILE", help="Write the whole result.", show_default=False),
    ] = None,
    plot: Annotated[
        str | None,
        typer.Option("--plot", metavar="FILE.png", help="Draw tie points and overlay.", show_default=False),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers",
            parser=whole_number(1),
            metavar="N",
            help="Most threads of all libraries.",
            show_default="as they choose",
        ),
    ] = None,
) -> None:
    """Register one SAR image to another.

    Finds tie points, fits a geometric model and judges whether it can be trusted.

    Images are GeoTIFF, TIFF, PNG, JPEG, BMP, NPY or file.mat:variable. Exit code 3 means that the result, which is
    still written, cannot be trusted.
    """
    inputs = [f for f in (reference, secondary, initial, mask_reference, mask_secondary) if f is not None]
    check_output(json_file, "--json", inputs=inputs)
    check_output(plot, "--plot", suffixes=[".png"], inputs=inputs)
    keywords = parse_settings(settings)
    if initial is None and search_radius is not None:
        raise ParameterError("--search-radius needs --initial RESULT.json, the result around which to search")
    with limited_threads(workers):
        from featreg.matching import match as register
        from featreg.types import Registration

        if initial is not None:
            search_radius = RADIUS if search_radius is None else search_radius
        announce_compiling()
        progress(f"registering '{secondary}' to '{reference}'")
        result = register(
            reference,
            secondary,
            method=method,
            model=model,
            seed=seed,
            refine=refine,
            n_features=n_features,
            initial=None if initial is None else _known_model(Registration.from_json(initial), initial),
            search_radius=search_radius,
            reference_mask=mask_reference,
            secondary_mask=mask_secondary,
            nodata=nodata,
            scale=scale,
            **keywords,
        )
        written = []
        if json_file is not None:
            result.to_json(json_file)
            written.append(json_file)
        if plot is not None:
            from featreg.io import as_image
            from featreg.pictures import draw_registration

            images = (
                as_image(reference, mask=mask_reference, nodata=nodata, scale=scale),
                as_image(secondary, mask=mask_secondary, nodata=nodata, scale=scale),
            )
            draw_registration(*images, result, plot)
            written.append(plot)
    typer.echo(summary(result, written))
    raise typer.Exit(0 if result.status == "ok" else 3)


def summary(result: Registration, written: list[str]) -> str:
    """Return what a person wants to know of a result, in a few lines."""
    import numpy as np

    from featreg.evaluation import computing_time

    provenance = result.provenance
    verdict = "ok" if result.status == "ok" else f"unreliable: {result.reason}"
    lines = [verdict, f"  method      {provenance['method']}, seed {provenance['seed']}"]
    if result.model:
        trust = "" if result.status == "ok" else " (not to be trusted)"
        lines.append(f"  model       {_describe(result)}{trust}")
    putative = int(result.putative.sum())
    chain = [f"{putative} putative", *(f"{int(mask.sum())} after {name}" for name, mask in result.stages.items())]
    lines.append(f"  tie points  {int(result.inliers.sum())} final: {', '.join(chain)}")
    if result.model and result.inliers.any():
        rmse = float(np.sqrt(np.mean(result.residuals()[result.inliers] ** 2)))
        lines.append(f"  residuals   RMSE {rmse:.2f} px over the final tie points")
    stages = ", ".join(f"{name} {seconds:.2f}" for name, seconds in result.timings.items())
    lines.append(f"  seconds     {computing_time(result):.2f}: {stages}")
    if written:
        lines.append(f"  written     {', '.join(written)}")
    return "\n".join(lines)


def _describe(result: Registration) -> str:
    """The model in words: its kind, and what it does at the centre of the reference."""
    import numpy as np

    from featreg.geometry import decompose, local_linear
    from featreg.interfaces import FailedFit
    from featreg.registry import model_name

    model = result.model
    if isinstance(model, FailedFit):
        return f"none: {model.reason}"
    size = result.provenance["inputs"]["reference"]
    centre = np.array([[(size["width"] - 1) / 2, (size["height"] - 1) / 2]])
    rotation, zoom, _, _ = decompose(local_linear(model, centre)[0])
    dx, dy = (model(centre) - centre)[0]
    return (
        f"{model_name(type(model))}: rotation {rotation:+.3f} deg counter-clockwise, scale {zoom:.5f}, "
        f"shift ({dx:+.2f}, {dy:+.2f}) px (right, down), all at the image centre"
    )


def _known_model(result: Registration, path: str) -> Any:
    from featreg.interfaces import FailedFit

    if isinstance(result.model, FailedFit):
        raise InputError(f"--initial '{path}' holds no model ({result.model.reason}), give a result that has one")
    return result.model


def warp(
    result_file: Annotated[
        str, typer.Argument(metavar="RESULT.json", help="What `featreg match --json` wrote.", show_default=False)
    ],
    secondary: Annotated[
        str, typer.Argument(metavar="SEC", help="The secondary image of that result.", show_default=False)
    ],
    output: Annotated[
        str, typer.Option("--output", "-o", metavar="OUT.tif", help="GeoTIFF to write.", show_default=False)
    ],
    like: Annotated[
        str | None,
        typer.Option(
            "--like",
            metavar="REF",
            help="The reference image, whose georeferencing the output gets.",
            show_default="the path in the result",
        ),
    ] = None,
    resampling: Annotated[
        str, typer.Option("--resampling", metavar="KIND", help="nearest, bilinear, cubic or lanczos.")
    ] = "lanczos",
    scale: Annotated[
        str | None,
        typer.Option(
            "--scale",
            metavar="SCALE",
            help="What the samples are: amplitude, intensity or db.",
            show_default="as in the result",
        ),
    ] = None,
    nodata: NodataOption = None,
) -> None:
    """Resample the secondary onto the reference.

    The output holds linear amplitude, or complex samples where the secondary does, and NaN where there is no data.
    Exit code 3 means that the registration, and so the output, cannot be trusted.
    """
    check_output(
        output, "--output", suffixes=[".tif", ".tiff"], inputs=[result_file, secondary, *([like] if like else [])]
    )
    from featreg.io import as_image, write_geotiff
    from featreg.resample import TAPS
    from featreg.resample import warp as resample
    from featreg.types import Registration

    check_name(resampling, TAPS, "resampling")
    result = Registration.from_json(result_file)
    recorded = result.provenance.get("inputs") or {}
    known = recorded.get("secondary") or {}
    if scale is None and known.get("path") == secondary and known.get("scale") != "complex":
        scale = known.get("scale")
    image = as_image(secondary, nodata=nodata, scale=scale)
    size = (known.get("height"), known.get("width"))
    if None not in size and image.shape != size:
        raise InputError(f"{secondary}: {_size(image.shape)}, but the secondary of '{result_file}' was {_size(size)}")
    geolocation, shape = _grid(like, recorded.get("reference") or {}, result_file)
    progress(f"resampling '{secondary}'")
    aligned = resample(result, image, like=shape, resampling=resampling)
    write_geotiff(output, aligned, geolocation, nodata=None if image.is_complex else float("nan"))
    place = "georeferenced as the reference" if geolocation is not None else "without georeferencing"
    typer.echo(f"written: {output}, {_size(aligned.shape)}, {aligned.dtype}, {place}")
    raise typer.Exit(0 if result.status == "ok" else 3)


def _grid(
    like: str | None, recorded: dict[str, Any], result_file: str
) -> tuple[Geolocation | None, tuple[int, int] | None]:
    """Georeferencing and (H, W) of the reference, from `like` or the path in the result; None where not known."""
    from featreg.io import as_image

    size = (recorded.get("height"), recorded.get("width"))
    if like is not None:
        image = as_image(like)
        if None not in size and image.shape != size:
            raise InputError(
                f"--like '{like}': {_size(image.shape)}, but the reference of '{result_file}' was {_size(size)}"
            )
        return image.geolocation, image.shape
    path = recorded.get("path")
    if not isinstance(path, str) or not Path(path).is_file():
        return None, None
    try:
        image = as_image(path)
    except InputError:
        return None, None
    return (image.geolocation, None) if image.shape == size else (None, None)


def _size(shape: Any) -> str:
    return f"{shape[1]} x {shape[0]} pixels"
