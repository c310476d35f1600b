"""Options of work in blocks, and pictures of what is too large for one."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from featreg.cli.checking import check_folder, number, whole_number
from featreg.cli.progress import saying_when_interrupted
from featreg.errors import InputError, ParameterError

if TYPE_CHECKING:
    from featreg.types import Image

#: A file this large may hold more pixels than are matched at once.
LARGE_BYTES = 4_000_000
#: Least longer side of the overview of a large image in a picture, px; a panel has 900.
DRAWN = 1000


def check_resume(resume: str | None) -> None:
    """Raise where what is finished could not be kept in the folder of `--resume`."""
    if resume is None:
        return
    folder = Path(resume)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--resume '{folder}' is a file, a folder is needed")
    check_folder(folder if folder.is_dir() else folder.absolute().parent, f"--resume '{folder}'")


@dataclass(frozen=True)
class ClusterOptions:
    """Where work of many parts is run, and where what is finished is kept."""

    scheduler: Annotated[
        str | None,
        typer.Option(
            "--scheduler",
            metavar="ADDRESS",
            help="Run the blocks on the dask cluster of this scheduler, as tcp://host:8786.",
            show_default=False,
        ),
    ] = None
    resume: Annotated[
        str | None,
        typer.Option(
            "--resume",
            metavar="DIR",
            help="Keep finished blocks in this folder, and use those that are there.",
            show_default=False,
        ),
    ] = None

    def check(self, workers: int | None) -> None:
        """Raise where two options contradict each other, or a folder cannot be used."""
        if self.scheduler is not None and workers is not None:
            raise ParameterError("--scheduler brings its own workers: leave --workers out")
        check_resume(self.resume)


@dataclass(frozen=True)
class SceneOptions:
    """Whether to work in blocks, and how the blocks of the secondary are found."""

    block: Annotated[
        int | None,
        typer.Option(
            "--block",
            parser=whole_number(1),
            metavar="PX",
            help="Work in blocks of about this many pixels a side.",
            show_default="600 to 1000 for images of more than 4 million pixels",
        ),
    ] = None
    whole: Annotated[bool, typer.Option("--whole", help="Work on the whole images at once, whatever their size.")] = (
        False
    )
    dem: Annotated[
        str | None,
        typer.Option("--dem", metavar="FILE", help="Elevation model of the ground, for blocks.", show_default=False),
    ] = None
    height: Annotated[
        float | None,
        typer.Option(
            "--height",
            parser=number,
            metavar="M",
            help="Height of the ground above the ellipsoid in metres, for blocks.",
            show_default="0",
        ),
    ] = None
    split: Annotated[
        str | None,
        typer.Option(
            "--split",
            metavar="prior|proportional",
            help="How the secondary is divided in blocks: each where the prior puts it, or into equal parts.",
            show_default="prior",
        ),
    ] = None

    def check_ground(self) -> None:
        """Raise where two options contradict each other, or there is no elevation model of that name."""
        used = [f"--{name}" for name in ("block", "dem", "height", "split") if getattr(self, name) is not None]
        if self.whole and used:
            raise ParameterError(f"--whole works on the whole images, {used[0]} is for blocks: leave one of them out")
        if self.dem is not None and self.height is not None:
            raise ParameterError("--dem and --height both say how high the ground is: leave one of them out")
        if self.dem is not None and not Path(self.dem).is_file():
            raise InputError(f"--dem '{self.dem}': no such file; give an elevation model")

    def ground(self) -> dict[str, Any]:
        """As keywords of `featreg.match` and of a protocol alike."""
        given = {name: getattr(self, name) for name in ("dem", "height", "split")}
        return {**given, "block": False if self.whole else self.block}


@dataclass(frozen=True)
class BlockOptions(ClusterOptions, SceneOptions):
    """How and whether to work in blocks."""

    def check(self, workers: int | None) -> None:
        """Raise where two options contradict each other, or a folder cannot be used."""
        self.check_ground()
        super().check(workers)

    def keywords(self) -> dict[str, Any]:
        """As keywords of `featreg.match`."""
        return {**self.ground(), "scheduler": self.scheduler, "resume": self.resume}


def may_be_blocks(options: BlockOptions, files: Sequence[str]) -> bool:
    """Whether the images may be worked on in blocks, told before anything is imported that could read them."""
    if options.whole:
        return False
    asked = any(value is not None for value in (options.block, options.dem, options.height, options.split))
    return asked or any(_size(file) > LARGE_BYTES for file in files)


def _size(file: str) -> float:
    """Bytes of a file; of a product's folder and of what lies elsewhere, that it may be large."""
    from featreg.io.source_names import parse_source

    path = parse_source(file).path
    try:
        return math.inf if path is None or path.is_dir() else os.path.getsize(path)
    except OSError:
        return 0


def image_to_draw(file: str, **reading: Any) -> tuple[Image, int]:
    """An image for a picture, large ones reduced, and how many pixels of the file, along a side, are one of its.

    `reading` are keywords of `featreg.as_image`.
    """
    from featreg.io.images import small_image
    from featreg.io.raster_source import open_source
    from featreg.matching import MOST_PIXELS

    image = small_image(file, MOST_PIXELS, **reading)
    if image is not None:
        return image, 1
    source = open_source(file, **reading)
    factor = max(1, min(max(source.shape) // DRAWN, min(source.shape)))
    return source.overview(factor), factor


def kept_when_interrupted(resume: str | None) -> AbstractContextManager[None]:
    """Let Ctrl-C say how to go on from the blocks that are kept."""
    kept = f"the finished blocks are kept: --resume '{resume}' goes on from there"
    return saying_when_interrupted(None if resume is None else kept)
