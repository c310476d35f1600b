"""`featreg compare`: several methods on one or more pairs, as a table."""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from pathlib import Path
from typing import Annotated

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
    check_folder,
    check_name,
    counter,
    parse_settings,
    whole_number,
)
from featreg.errors import InputError, ParameterError

FORMATS = ("md", "csv", "latex", "json")


def compare(
    images: Annotated[
        list[str],
        typer.Argument(metavar="REF SEC", help="Pairs of images, one after the other.", show_default=False),
    ],
    methods: Annotated[
        str,
        typer.Option("--methods", metavar="A,B,C", help="Names from `featreg list method`.", show_default=False),
    ],
    truth: Annotated[
        list[str] | None,
        typer.Option(
            "--truth",
            metavar="FILE",
            help="Where points really lie: a matrix, marked points, a flow or a result (.json, .txt, .csv, .npy); once "
            "for all pairs, or once per pair.",
            show_default=False,
        ),
    ] = None,
    model: ModelOption = None,
    settings: SetOption = None,
    seed: SeedOption = 0,
    n_features: FeaturesOption = None,
    refine: RefineOption = None,
    scale: ScaleOption = None,
    nodata: NodataOption = None,
    workers: Annotated[
        int,
        typer.Option(
            "--workers", parser=whole_number(1), metavar="N", help="Processes that match, of one thread each."
        ),
    ] = 1,
    times: Annotated[
        bool | None,
        typer.Option(
            "--times/--no-times",
            help="Measure times, one run after the other.",
            show_default="only with one worker",
        ),
    ] = None,
    resume: Annotated[
        str | None,
        typer.Option(
            "--resume",
            metavar="DIR",
            help="Keep results in a folder and take them from there where nothing has changed.",
            show_default=False,
        ),
    ] = None,
    layout: Annotated[str, typer.Option("--format", metavar="FORMAT", help="md, csv, latex or json.")] = "md",
) -> None:
    """Print a table of methods on image pairs.

    Exit code 4 means that a method failed with an error on a pair; its row says which.
    """
    check_name(layout, FORMATS, "format")
    keywords = parse_settings(settings)
    names = [name.strip() for name in methods.split(",") if name.strip()]
    if not names:
        raise ParameterError(f"--methods needs names with commas between them, as in sar-orb,orb, got '{methods}'")
    pairs = _pairs(images, truth or [])
    if resume is not None:
        _check_resume(resume)
    from featreg.assembly import assemble
    from featreg.comparison import compare as run
    from featreg.io import as_image

    for name in names:
        assemble(name, model=model, refine=refine, n_features=n_features, **keywords)
    for path in dict.fromkeys(images):
        as_image(path, nodata=nodata, scale=scale)
    common = {"model": model, "refine": refine, "scale": scale, "nodata": nodata, **keywords}
    if n_features is not None:
        common["n_features"] = n_features
    announce_compiling()
    with _executor(workers) as executor:
        table = run(
            pairs,
            [{"method": name, **common} for name in names],
            executor=executor,
            seed=seed,
            timing=workers == 1 if times is None else times,
            cache=resume,
            progress=counter("comparing"),
        )
    printed = {"md": table.to_markdown, "csv": table.to_csv, "latex": table.to_latex, "json": table.to_json}[layout]
    typer.echo(printed(), nl=False)
    raise typer.Exit(4 if table.failed else 0)


def _pairs(images: list[str], truth: list[str]) -> list[tuple[str, str, str | None]]:
    if len(images) % 2:
        raise InputError(
            f"images come in pairs REF SEC [REF SEC ...], got {len(images)}: '{images[-1]}' has no partner"
        )
    count = len(images) // 2
    if len(truth) not in (0, 1, count):
        raise InputError(f"--truth is given once for all pairs or once per pair, got {len(truth)} for {count} pairs")
    known: list[str | None] = [*truth] if len(truth) == count else [truth[0] if truth else None] * count
    return list(zip(images[::2], images[1::2], known, strict=True))


def _check_resume(folder: str) -> None:
    path = Path(folder)
    if not path.exists():
        check_folder(path.absolute().parent, f"--resume '{folder}'")
    else:
        check_folder(path, f"--resume '{folder}'")


@contextlib.contextmanager
def _executor(workers: int) -> Iterator[Executor | None]:
    if workers == 1:
        yield None
        return
    # Fresh processes: forking one that has started threads can hang.
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), initializer=_leave_interrupts)
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _leave_interrupts() -> None:
    """Let the parent alone react to Ctrl-C, which the terminal sends to every process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
