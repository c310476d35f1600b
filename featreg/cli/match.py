"""`featreg match`: one pair of images, or a list of pairs."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from featreg.cli import completion
from featreg.cli.block_options import BlockOptions, image_to_draw, kept_when_interrupted, may_be_blocks
from featreg.cli.checking import STDOUT, check_output, distance, whole_number
from featreg.cli.match_summary import summary
from featreg.cli.option_sets import takes
from featreg.cli.options import MaskOptions, MethodOptions
from featreg.cli.progress import announce_compiling, counter, progress
from featreg.cli.settings import parse_settings
from featreg.errors import InputError, ParameterError
from featreg.io.source_names import parse_source
from featreg.pipeline.keywords import KEYWORDS, bands_of
from featreg.presets import DEFAULT_METHOD
from featreg.runtime.threads import limited_threads

if TYPE_CHECKING:
    from featreg.results.registration import Registration

RADIUS = 20.0


@takes
def match(
    reference: Annotated[
        str,
        typer.Argument(
            metavar="REF",
            help="Reference image; without SEC, a list of pairs (CSV: reference,secondary[,output]) or a folder of "
            "images named in pairs.",
            show_default=False,
        ),
    ],
    secondary: Annotated[str | None, typer.Argument(metavar="SEC", help="Secondary image.", show_default=False)] = None,
    method: Annotated[
        str | None,
        typer.Option(
            "--method",
            metavar="NAME",
            help="One of `featreg list method`.",
            show_default="auto: sar-orb, else sar-dense; with --set, sar-orb",
            autocompletion=completion.methods,
        ),
    ] = None,
    *,
    output: Annotated[
        str | None,
        typer.Option(
            "--output",
            "-o",
            "--json",
            metavar="FILE|DIR",
            help="Write the whole result as JSON, with - to standard output; of a list of pairs, the folder in which "
            "the results and a summary are written.",
            show_default="of a list, the folder in which it lies",
        ),
    ] = None,
    plot: Annotated[
        str | None,
        typer.Option(
            "--plot",
            metavar="FILE.png|DIR",
            help="Draw tie points and overlay; of a list of pairs, all into a folder.",
            show_default=False,
        ),
    ] = None,
    common: MethodOptions,
    masks: MaskOptions,
    focus: Annotated[
        str | None,
        typer.Option(
            "--focus",
            metavar="METHOD",
            help="Autofocus of complex images first (azimuth down the columns): auto, mea, pmea, mca, pga or legendre.",
            show_default=False,
            autocompletion=completion.focus_methods,
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
    blocks: BlockOptions,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers",
            parser=whole_number(1),
            metavar="N",
            help="Worker processes where it is done in blocks, else most threads (as with --whole).",
            show_default="every processor, or as they choose",
        ),
    ] = None,
) -> None:
    """Register one SAR image to another.

    Finds tie points, fits a geometric model and judges whether it can be trusted.

    Images are files (GeoTIFF, NITF, SICD, SAFE, CEOS, ENVI, HDF5, PNG and others; real or complex samples), product
    folders, archives or datasets (file.h5:/name): some twenty formats, see docs/formats.md. Exit code 3 means that the
    result, which is still written, cannot be trusted. Large images are worked on in blocks, which can be spread over
    processes or a cluster and kept in a folder, so that a run that was stopped goes on where it was.

    Of a list of pairs each gets a line, a result and a row of the summary; a pair that cannot be matched is a row with
    its reason and makes the exit code 4. Started again, it takes what is finished and unchanged from where it was
    written.
    """
    request = MatchRequest(method, common, masks, focus, initial, prior, search_radius, blocks, workers)
    request.check()
    if secondary is None:
        from featreg.cli.match_pairs import is_list, match_pairs

        if not is_list(reference):
            if parse_source(reference).path == Path(reference) and not Path(reference).exists():
                raise InputError(f"{reference}: no such file or folder; give two images, a list of pairs or a folder")
            raise ParameterError("missing argument 'SEC'; see 'featreg match --help'")
        raise typer.Exit(match_pairs(reference, output, plot, request))
    request.check_radius([])
    inputs = [file for file in (reference, secondary, *request.files) if file is not None]
    check_output(output, "--json", inputs=inputs, stdout=True)
    check_output(plot, "--plot", suffixes=[".png"], inputs=inputs)
    text = ""
    with kept_when_interrupted(blocks.resume), request.running([reference, secondary]) as in_blocks:
        announce_compiling()
        progress(f"registering '{secondary}' to '{reference}'")
        result = request.match(reference, secondary, progress=counter("blocks") if in_blocks else None)
        written = []
        if output == STDOUT:
            from featreg.results.json_file import registration_text

            text = registration_text(result)
        elif output is not None:
            result.to_json(output)
            written += [output, *_beside(result, output)]
        if plot is not None:
            request.draw(reference, secondary, result, plot)
            written.append(plot)
    # What goes to standard output itself may be read by a machine.
    said = summary(result, written)
    if text:
        typer.echo(said, err=True)
        typer.echo(text, nl=False)
    else:
        typer.echo(said, err=output is not None and _is_stdout(output))
    raise typer.Exit(0 if result.status == "ok" else 3)


@dataclass(frozen=True)
class MatchRequest:
    """How a pair is to be matched, whichever it is."""

    method: str | None
    common: MethodOptions
    masks: MaskOptions
    focus: str | None
    initial: str | None
    prior: str | None
    search_radius: float | None
    blocks: BlockOptions
    workers: int | None

    @property
    def files(self) -> tuple[str | None, ...]:
        """Files that are read beside the images."""
        return (self.initial, self.prior, self.masks.mask_reference, self.masks.mask_secondary, self.blocks.dem)

    @property
    def settings(self) -> dict[str, Any]:
        """Parts and parameters of the method."""
        return parse_settings(self.common.settings, (keyword.name for keyword in KEYWORDS if keyword.option))

    def check_radius(self, initials: Sequence[str]) -> None:
        """Raise where there is a radius and nothing around which to search; `initials` are those of the pairs."""
        if self.search_radius is not None and not (self.initial or self.prior or (initials and all(initials))):
            raise ParameterError("--search-radius needs --initial RESULT.json, the result around which to search")

    def check(self) -> None:
        """Raise where options contradict each other."""
        self.blocks.check(self.workers)
        # Before any work: a misspelt setting.
        _ = self.settings

    def keywords(self, initial: str | None = None) -> dict[str, Any]:
        """As keywords of `featreg.match`, how it is run apart; `initial` comes before that of all pairs."""
        known = self.initial if initial is None else initial
        # Of a list each pair may have a result around which to search.
        radius = None if known is None and self.prior is None else self.search_radius
        return {
            # What --set names is a part or a parameter of one method.
            "method": self.method or (DEFAULT_METHOD if self.settings else "auto"),
            "seed": self.common.seed,
            "initial": None if known is None else _known_model(known),
            "search_radius": RADIUS if known is not None and radius is None else radius,
            "prior": None if initial is not None else self.prior,
            "focus": self.focus,
            **self.masks.keywords(),
            **self.common.keywords(),
            **self.blocks.keywords(),
            **self.settings,
        }

    def match(self, reference: str, secondary: str, **more: Any) -> Registration:
        """Match a pair; `more` are keywords of `featreg.match` that come before those of all pairs."""
        from featreg.matching import match as register

        return register(reference, secondary, **{**self.keywords(), "workers": self.workers, **more})

    @contextmanager
    def running(self, files: Sequence[str]) -> Iterator[bool]:
        """Where to match: with as many threads as it shall have; it gives whether it may be in blocks."""
        in_blocks = may_be_blocks(self.blocks, files)
        if in_blocks:
            from featreg.runtime.workers import keep_freed_memory

            keep_freed_memory()
        with limited_threads(self.workers, 1 if in_blocks else None):
            yield in_blocks

    def draw(
        self, reference: str, secondary: str, result: Registration, path: str, masks: Mapping[str, Any] | None = None
    ) -> None:
        """Draw a result into a PNG file; `masks` are those of this pair, where it has its own."""
        from featreg.pictures.drawing import draw_registration

        reading: Any = {
            "nodata": self.common.nodata,
            "scale": self.common.scale,
            "calibrate": self.common.calibrate,
        }
        bands = bands_of(self.common.keywords())
        known = self.masks.keywords() if masks is None else masks
        here, factor = image_to_draw(reference, mask=known["reference_mask"], band=bands[0], **reading)
        there, far_factor = image_to_draw(secondary, mask=known["secondary_mask"], band=bands[1], **reading)
        draw_registration(here, there, result, path, factors=(factor, far_factor))


def _beside(result: Registration, path: str) -> list[str]:
    """The file of tie points that a result of very many has beside it."""
    from featreg.results.json_file import MAX_ROWS, tie_point_file

    beside = tie_point_file(Path(path))
    return [f"{beside} (its tie points)"] if len(result.matches) > MAX_ROWS and beside.is_file() else []


def _is_stdout(path: str) -> bool:
    try:
        return os.path.samestat(os.stat(path), os.fstat(1)) and not os.path.isfile(path)
    except OSError:
        return False


def _known_model(path: str) -> Any:
    from featreg.interfaces import FailedFit
    from featreg.results.registration import Registration

    result = Registration.from_json(path, tie_points=False)
    if isinstance(result.model, FailedFit):
        raise InputError(f"--initial '{path}' holds no model ({result.model.reason}), give a result that has one")
    return result.model
