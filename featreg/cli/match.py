"""`featreg match`: one pair of images."""

from __future__ import annotations

import math
import os
from typing import TYPE_CHECKING, Annotated, Any

import typer

from featreg.cli.block_options import BlockOptions, block_progress, image_to_draw, kept_when_interrupted, may_be_blocks
from featreg.cli.option_sets import takes
from featreg.cli.options import (
    MethodOptions,
    announce_compiling,
    check_output,
    distance,
    parse_settings,
    progress,
    whole_number,
)
from featreg.errors import InputError, ParameterError
from featreg.pipeline.keywords import KEYWORDS, bands_of
from featreg.runtime.threads import limited_threads

if TYPE_CHECKING:
    from featreg.results.registration import Registration

RADIUS = 20.0


@takes
def match(
    reference: Annotated[str, typer.Argument(metavar="REF", help="Reference image.", show_default=False)],
    secondary: Annotated[str, typer.Argument(metavar="SEC", help="Secondary image.", show_default=False)],
    method: Annotated[
        str | None,
        typer.Option(
            "--method",
            metavar="NAME",
            help="One of `featreg list method`.",
            show_default="auto: sar-orb, else sar-dense; with --set, sar-orb",
        ),
    ] = None,
    *,
    common: MethodOptions,
    blocks: BlockOptions,
    focus: Annotated[
        str | None,
        typer.Option(
            "--focus",
            metavar="METHOD",
            help="Autofocus of complex images first (azimuth down the columns): auto, mea, pmea, mca, pga or legendre.",
            show_default=False,
        ),
    ] = None,
    initial: Annotated[
        str | None,
        typer.Option(
            "--initial", metavar="RESULT.json", help="An earlier result to search around.", show_default=False
        ),
    ] = None,
    prior: Annotated[
        str | None,
        typer.Option(
            "--prior",
            metavar="none|geolocation|RESULT.json",
            help="none leaves aside where the files say they lie, geolocation fails where they do not; a result is "
            "searched around, 35 px far.",
            show_default="what the files say",
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
            help="Worker processes where it is done in blocks, else most threads of all libraries.",
            show_default="every processor, or as they choose",
        ),
    ] = None,
) -> None:
    """Register one SAR image to another.

    Finds tie points, fits a geometric model and judges whether it can be trusted.

    Images are files, product folders, archives or datasets (file.h5:/name) of some twenty formats, see docs/formats.md.
    Exit code 3 means that the result, which is
    still written, cannot be trusted. Large images are worked on in blocks, which can be spread over processes or a
    cluster and kept in a folder, so that a run that was stopped goes on where it was.
    """
    given = (reference, secondary, initial, prior, mask_reference, mask_secondary, blocks.dem)
    inputs = [file for file in given if file is not None]
    check_output(json_file, "--json", inputs=inputs)
    check_output(plot, "--plot", suffixes=[".png"], inputs=inputs)
    settings = parse_settings(common.settings, (keyword.name for keyword in KEYWORDS if keyword.option))
    if initial is None and prior is None and search_radius is not None:
        raise ParameterError("--search-radius needs --initial RESULT.json, the result around which to search")
    blocks.check(workers)
    in_blocks = may_be_blocks(blocks, [reference, secondary])
    if in_blocks:
        from featreg.runtime.workers import keep_freed_memory

        keep_freed_memory()
    with kept_when_interrupted(blocks.resume), limited_threads(workers, 1 if in_blocks else None):
        from featreg.matching import match as register
        from featreg.pipeline.assembly import DEFAULT_METHOD
        from featreg.results.registration import Registration

        if initial is not None:
            search_radius = RADIUS if search_radius is None else search_radius
        announce_compiling()
        progress(f"registering '{secondary}' to '{reference}'")
        result = register(
            reference,
            secondary,
            # What --set names is a part or a parameter of one method.
            method=method or (DEFAULT_METHOD if settings else "auto"),
            seed=common.seed,
            initial=None if initial is None else _known_model(Registration.from_json(initial), initial),
            search_radius=search_radius,
            prior=prior,
            reference_mask=mask_reference,
            secondary_mask=mask_secondary,
            focus=focus,
            workers=workers,
            progress=block_progress() if in_blocks else None,
            **common.keywords(),
            **blocks.keywords(),
            **settings,
        )
        written = []
        if json_file is not None:
            result.to_json(json_file)
            written.append(json_file)
        if plot is not None:
            from featreg.pictures.drawing import draw_registration

            reading: Any = {"nodata": common.nodata, "scale": common.scale}
            bands = bands_of(common.keywords())
            here, factor = image_to_draw(reference, mask=mask_reference, band=bands[0], **reading)
            there, far_factor = image_to_draw(secondary, mask=mask_secondary, band=bands[1], **reading)
            draw_registration(here, there, result, plot, factors=(factor, far_factor))
            written.append(plot)
    # What goes to standard output itself may be read by a machine.
    typer.echo(summary(result, written), err=json_file is not None and _is_stdout(json_file))
    raise typer.Exit(0 if result.status == "ok" else 3)


def _is_stdout(path: str) -> bool:
    try:
        return os.path.samestat(os.stat(path), os.fstat(1)) and not os.path.isfile(path)
    except OSError:
        return False


def summary(result: Registration, written: list[str]) -> str:
    """Return what a person wants to know of a result, in a few lines."""
    import numpy as np

    from featreg.study.evaluation import computing_time

    provenance = result.provenance
    verdict = "ok" if result.status == "ok" else f"unreliable: {result.reason}"
    lines = [verdict, f"  method      {provenance['method']}, seed {provenance['seed']}"]
    tried = [f"{one['method']} {one['status']}" for one in provenance.get("choice", {}).get("tried", ())]
    lines += [f"  tried       {', '.join(tried)}"] if tried else []
    if result.model:
        trust = "" if result.status == "ok" else " (not to be trusted)"
        lines.append(f"  model       {_describe(result)}{trust}")
    putative = int(result.putative.sum())
    chain = [f"{putative} putative", *(f"{int(mask.sum())} after {name}" for name, mask in result.stages.items())]
    lines.append(f"  tie points  {int(result.inliers.sum())} final: {', '.join(chain)}")
    if result.model and result.inliers.any():
        rmse = float(np.sqrt(np.mean(result.residuals()[result.inliers] ** 2)))
        lines.append(f"  residuals   RMSE {rmse:.2f} px over the final tie points")
    blocks = provenance.get("blocks")
    accuracy = provenance.get("accuracy", {})
    if "blocks_px" in accuracy:
        held_out, local = result.gates["held_out_rmse"].value, accuracy["blocks_px"]
        text = "" if held_out is None else f"RMSE {held_out:.2f} px over tie points held out of the fit, "
        local = f"median {local['median']:.2f}, 95 % {local['percentile95']:.2f}, worst {local['worst']:.2f} px"
        lines.append(f"  accuracy    {text}by block {local}")
    if blocks:
        counts = ", ".join(f"{blocks[name]} {name}" for name in ("computed", "reused", "skipped", "failed"))
        lines.append(f"  blocks      {blocks['total']} of about {blocks['size']} px: {counts}")
    stages = ", ".join(f"{name} {seconds:.2f}" for name, seconds in result.timings.items())
    lines.append(f"  seconds     {computing_time(result.timings):.2f}: {stages}")
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
    height, width = (1, 1) if result.reference is None else result.reference.shape
    centre = np.array([[(width - 1) / 2, (height - 1) / 2]])
    linear = decompose(local_linear(model, centre)[0])
    dx, dy = (model(centre) - centre)[0]
    errors = result.standard_errors
    if errors:
        sx, sy = errors["shift_se_px"]
        return (
            f"{model_name(type(model))}: rotation {linear.rotation_deg:+.3f} +- {errors['rotation_deg_se']:.3f} deg "
            f"counter-clockwise, shift ({dx:+.2f} +- {sx:.2f}, {dy:+.2f} +- {sy:.2f}) px (right, down), "
            "with standard errors, at the image centre"
        )
    # Behind a mirror there is no rotation.
    turned = math.isfinite(linear.rotation_deg)
    turn = f"rotation {linear.rotation_deg:+.3f} deg counter-clockwise" if turned else "mirrored"
    return (
        f"{model_name(type(model))}: {turn}, "
        f"scale {linear.scale:.5f}, shift ({dx:+.2f}, {dy:+.2f}) px (right, down), all at the image centre"
    )


def _known_model(result: Registration, path: str) -> Any:
    from featreg.interfaces import FailedFit

    if isinstance(result.model, FailedFit):
        raise InputError(f"--initial '{path}' holds no model ({result.model.reason}), give a result that has one")
    return result.model
