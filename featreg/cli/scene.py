"""What `featreg match` adds for images that are worked on in blocks: options, progress, the dask client."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer

from featreg.cli.options import check_folder, number, whole_number
from featreg.errors import InputError, ParameterError

if TYPE_CHECKING:
    from featreg.types import Image

#: A file this large may hold more pixels than are matched at once.
LARGE_BYTES = 4_000_000
#: Least longer side of the overview of a large image in a picture, px; a panel has 900.
DRAWN = 1000
#: Seconds to wait for a dask scheduler.
PATIENCE = 10

BlockOption: TypeAlias = Annotated[
    int | None,
    typer.Option(
        "--block",
        parser=whole_number(1),
        metavar="PX",
        help="Work in blocks of about this many pixels a side.",
        show_default="600 for images of more than 4 million pixels",
    ),
]
WholeOption: TypeAlias = Annotated[
    bool, typer.Option("--whole", help="Work on the whole images at once, whatever their size.")
]
SchedulerOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="ADDRESS",
        help="Run the blocks on the dask cluster of this scheduler, as tcp://host:8786.",
        show_default=False,
    ),
]
DemOption: TypeAlias = Annotated[
    str | None,
    typer.Option("--dem", metavar="FILE", help="Elevation model of the ground, for blocks.", show_default=False),
]
HeightOption: TypeAlias = Annotated[
    float | None,
    typer.Option(
        "--height",
        parser=number,
        metavar="M",
        help="Height of the ground above the ellipsoid in metres, for blocks.",
        show_default="0",
    ),
]
ResumeOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--resume",
        metavar="DIR",
        help="Keep finished blocks in this folder, and use those that are there.",
        show_default=False,
    ),
]


def check_block_options(
    block: int | None, whole: bool, workers: int | None, scheduler: str | None, dem: str | None, height: float | None,
    resume: str | None,
) -> None:  # fmt: skip
    """Raise where two options contradict each other, or a folder cannot be used."""
    given = {"--block": block, "--scheduler": scheduler, "--dem": dem, "--height": height, "--resume": resume}
    used = [name for name, value in given.items() if value is not None]
    if whole and used:
        raise ParameterError(f"--whole works on the whole images, {used[0]} is for blocks: leave one of them out")
    if dem is not None and height is not None:
        raise ParameterError("--dem and --height both say how high the ground is: leave one of them out")
    if scheduler is not None and workers is not None:
        raise ParameterError("--scheduler brings its own workers: leave --workers out")
    if dem is not None and not Path(dem).is_file():
        raise InputError(f"--dem '{dem}': no such file; give an elevation model")
    if resume is not None:
        if Path(resume).exists() and not Path(resume).is_dir():
            raise InputError(f"--resume '{resume}' is a file, a folder is needed")
        check_folder(Path(resume) if Path(resume).is_dir() else Path(resume).parent, f"--resume '{resume}'")


def may_be_blocks(whole: bool, used: Sequence[Any], files: Sequence[str]) -> bool:
    """Whether the images may be worked on in blocks, told before anything is imported that could read them."""
    if whole:
        return False
    return any(value is not None for value in used) or any(_size(file) > LARGE_BYTES for file in files)


def _size(file: str) -> int:
    try:
        return os.path.getsize(file)
    except OSError:
        return 0


@contextmanager
def cluster(address: str | None) -> Iterator[Any]:
    """A dask client of the scheduler at an address; None where none is asked for."""
    if address is None:
        yield None
        return
    try:
        from distributed import Client
    except ImportError as error:
        raise ParameterError("--scheduler needs dask: pip install 'featreg[dask]'") from error
    try:
        client: Any = Client(address, timeout=PATIENCE, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError, TypeError) as error:
        why = " ".join(str(error).split())[:160]
        raise InputError(f"--scheduler '{address}': no dask scheduler answers there ({why})") from error
    with client:
        if not client.nthreads():
            raise InputError(f"--scheduler '{address}': has no workers yet; start some with 'dask worker {address}'")
        yield client


def image_to_draw(file: str, mask: str | None, nodata: complex | None, scale: str | None) -> tuple[Image, int]:
    """An image for a picture, large ones reduced, and how many pixels of the file, along a side, are one of its."""
    from featreg.io import as_image
    from featreg.io.raster_source import open_source, pixel_count
    from featreg.matching import MOST_PIXELS

    if pixel_count(file) <= MOST_PIXELS:
        return as_image(file, mask=mask, nodata=nodata, scale=scale), 1
    source = open_source(file, mask=mask, nodata=nodata, scale=scale)
    factor = max(1, min(max(source.shape) // DRAWN, min(source.shape)))
    return source.overview(factor), factor


@contextmanager
def kept_when_interrupted(resume: str | None) -> Iterator[None]:
    """Say how to go on after Ctrl-C."""
    try:
        yield
    except KeyboardInterrupt:
        if resume is not None:
            typer.echo(f"interrupted; the finished blocks are kept: --resume '{resume}' goes on from there", err=True)
        raise


def block_progress() -> Callable[[int, int], None] | None:
    """A callback that keeps one line with blocks, rate and time left, or None when nobody looks at stderr."""
    if not sys.stderr.isatty():
        return None
    start: list[tuple[float, int]] = []

    def show(done: int, total: int) -> None:
        now = time.monotonic()
        if not start:
            start.append((now, done))
        elapsed, fresh = now - start[0][0], done - start[0][1]
        text = f"blocks: {done} of {total}"
        if fresh > 0 and elapsed > 0:
            rate = fresh / elapsed
            text += f", {rate:.1f} a second, {(total - done) / rate:.0f} s left"
        typer.echo(f"\r{text:<60}", err=True, nl=done == total)

    return show
