"""`featreg stack`: many images on one grid."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from featreg.cli import completion
from featreg.cli.block_options import ClusterOptions
from featreg.cli.checking import check_folder, check_output, whole_number
from featreg.cli.option_sets import takes
from featreg.cli.options import MethodOptions
from featreg.cli.progress import announce_compiling, counter, saying_when_interrupted
from featreg.cli.settings import parse_settings
from featreg.errors import InputError, ParameterError
from featreg.pipeline.keywords import KEYWORDS
from featreg.presets import DEFAULT_METHOD
from featreg.runtime.files import write_atomic
from featreg.runtime.threads import limited_threads


@dataclass(frozen=True)
class PairsOptions(ClusterOptions):
    """Where the pairs are matched, and where what is finished is kept."""

    resume: Annotated[
        str | None,
        typer.Option(
            "--resume", metavar="DIR", help="Folder in which finished pairs are kept.", show_default="DIR/pairs"
        ),
    ] = None


def pairs_of(text: Any) -> Any:
    """Read "all", "chain" or a whole number."""
    if text in ("all", "chain"):
        return text
    try:
        return whole_number(1)(text)
    except typer.BadParameter:
        raise typer.BadParameter(f"all, chain or a whole number >= 1 is needed, got '{text}'") from None


@takes
def stack(
    images: Annotated[
        list[str], typer.Argument(metavar="IMAGE...", help="Images in the order of time.", show_default=False)
    ],
    output: Annotated[
        str,
        typer.Option(
            "--output", "-o", metavar="DIR", help="Folder for stack.json, stack.csv and stack.png.", show_default=False
        ),
    ],
    reference: Annotated[
        str,
        typer.Option(
            "--reference",
            metavar="auto|FILE",
            help="The image whose grid is taken; auto: the one that its pairs determine best.",
            show_default="the first image",
        ),
    ] = "",
    pairs: Annotated[
        Any,
        typer.Option(
            "--pairs",
            parser=pairs_of,
            metavar="all|chain|K",
            help="Pairs that are matched; K: each image with the next K.",
            show_default="with the next two and the reference",
        ),
    ] = None,
    dates: Annotated[
        str | None,
        typer.Option(
            "--dates",
            metavar="DAY,DAY,...",
            help="A day (YYYYMMDD) for each image, by which the pairs are chosen.",
            show_default="those in the files' names",
        ),
    ] = None,
    method: Annotated[
        str,
        typer.Option(
            "--method",
            metavar="NAME",
            help="One of `featreg list method`.",
            show_default="auto; sar-orb with --set",
            autocompletion=completion.methods,
        ),
    ] = "",
    *,
    common: MethodOptions,
    add: Annotated[
        bool,
        typer.Option("--add", help="Add the images to the stack that DIR holds, with its reference and its options."),
    ] = False,
    warp: Annotated[bool, typer.Option("--warp", help="Also write all images on the grid of the reference.")] = False,
    cube: Annotated[
        str | None,
        typer.Option("--cube", metavar="FILE.nc", help="Also write them as one NetCDF cube.", show_default=False),
    ] = None,
    pieces: PairsOptions,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers", parser=whole_number(1), metavar="N", help="Worker processes.", show_default="every processor"
        ),
    ] = None,
) -> None:
    """Register many images of one place to one grid.

    Matches a graph of pairs, adjusts all models together, throws out pairs that the others contradict, and says where
    the position jumps over time. Exit code 3 means that an image had to be left out.
    """
    folder = Path(output)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--output '{output}' is a file, a folder is needed")
    check_folder(folder if folder.is_dir() else folder.parent, f"--output '{output}'")
    pieces.check(workers)
    if add and (reference or pairs is not None):
        raise ParameterError("--add keeps the reference and the pairs of the stack: leave --reference and --pairs out")
    days: list[Any] | None = None if dates is None else [day.strip() for day in dates.split(",")]
    if add and days is not None and len(days) != len(images):
        raise ParameterError(f"--dates gives {len(days)} days for {len(images)} images, one for each is needed")
    check_output(cube, "--cube", suffixes=[".nc", ".zarr"], inputs=images)
    settings = parse_settings(common.settings, (keyword.name for keyword in KEYWORDS if keyword.option))
    given = {k: v for k, v in {**common.keywords(), **settings}.items() if v is not None}
    changed = [*given, *(["method"] if method else []), *(["seed"] if common.seed else [])]
    if add and changed:
        raise ParameterError(f"--add keeps the options of the stack: leave {', '.join(sorted(changed))} out")
    resume = str(folder / "pairs") if pieces.resume is None else pieces.resume
    kept = f"the finished pairs are kept in '{resume}': the same command goes on from there"
    with saying_when_interrupted(kept), limited_threads(workers, 1):
        announce_compiling()
        from featreg.pictures.stack import draw_stack
        from featreg.stacks.registering import register_stack
        from featreg.stacks.stack import Stack

        folder.mkdir(exist_ok=True)
        how: dict[str, Any] = {
            "workers": workers,
            "scheduler": pieces.scheduler,
            "resume": resume,
            "progress": counter("pairs"),
        }
        if add:
            made = Stack.from_json(folder / "stack.json")
            for image, day in zip(images, len(images) * [None] if days is None else days, strict=True):
                made = made.add(image, date=day, **how)
        else:
            made = register_stack(
                images,
                reference=_number(reference, images),
                pairs=pairs,
                dates=days,
                # `auto` tries whole methods, whose parts no setting names.
                method=method or (DEFAULT_METHOD if settings else "auto"),
                seed=common.seed,
                **given,
                **how,
            )
        made.to_json(folder / "stack.json")
        write_atomic(folder / "stack.csv", _csv(made.rows()).encode(errors="backslashreplace"))
        draw_stack(made, folder / "stack.png")
        if warp:
            made.warp(folder / "aligned")
        if cube is not None:
            made.to_file(cube)
    typer.echo(made.explain())
    raise typer.Exit(0 if all(status == "ok" for status in made.status) else 3)


def _csv(rows: list[dict[str, Any]]) -> str:
    """A table of which what is not known is empty."""
    out = io.StringIO()
    writer = csv.DictWriter(out, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: "" if value != value else value for name, value in row.items()} for row in rows)
    return out.getvalue()


def _number(reference: str, images: list[str]) -> int | str:
    if reference in ("", "auto"):
        return reference or 0
    for number, image in enumerate(images):
        if image == reference or (
            Path(image).exists() and Path(reference).exists() and Path(image).samefile(reference)
        ):
            return number
    raise ParameterError(f"--reference '{reference}' is none of the images; give one of them, or auto")
