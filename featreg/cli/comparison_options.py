"""What `featreg compare` and `featreg sweep` share: options, running an experiment, printing its table."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from featreg.cli import completion
from featreg.cli.block_options import SceneOptions, check_resume
from featreg.cli.checking import check_name, check_output, number, whole_number
from featreg.cli.options import MethodOptions
from featreg.cli.progress import announce_compiling, counter, saying_when_interrupted
from featreg.cli.terminal import print_styled, terminal_width
from featreg.errors import FeatregError, InputError, ParameterError
from featreg.pipeline.keywords import bands_of

if TYPE_CHECKING:
    from featreg.study.experiment import Experiment
    from featreg.study.experiment_results import Study
    from featreg.study.protocol import Protocol
    from featreg.study.table import Table

FORMATS = ("text", "md", "csv", "latex", "json")
LAYOUTS = ("table2", "table3")
OUTPUTS = {".md": "to_markdown", ".csv": "to_csv", ".tex": "to_latex", ".json": "to_json", ".parquet": "to_parquet"}
EXPERIMENTS = (".yaml", ".yml", ".toml")

logger = logging.getLogger(__name__)


def seconds(text: Any) -> float:
    """Read a number of seconds greater than 0."""
    value = number(text)
    if not 0 < value < float("inf"):
        raise typer.BadParameter(f"a number of seconds > 0 is needed, got '{text}'")
    return value


@dataclass(frozen=True)
class RunOptions:
    """How methods are run and scored."""

    truth: Annotated[
        list[str] | None,
        typer.Option(
            "--truth",
            metavar="FILE",
            help="Where points really lie: a matrix, marked points, a flow or a result (.json, .txt, .csv, .npy, "
            ".points of QGIS, .pts of ENVI), 'identity' for images on one grid, or 'geolocation' (or "
            "geolocation:HEIGHT, geolocation:DEM) for what the files say of where they lie; once for all pairs, or "
            "once per pair.",
            show_default=False,
        ),
    ] = None
    repeats: Annotated[
        int,
        typer.Option("--repeats", parser=whole_number(1), metavar="N", help="Run with N seeds, from --seed on."),
    ] = 1
    threshold: Annotated[
        float,
        typer.Option("--threshold", parser=number, metavar="PX", help="Greatest distance of a correct match."),
    ] = 1.5
    metrics: Annotated[
        str | None,
        typer.Option(
            "--metrics",
            metavar="A,B,C",
            help="Columns of the table instead of the usual ones, or with a + in front beside them, as in "
            "+auc@3,recall,mma@3,act.detect.",
            show_default=False,
            autocompletion=completion.metrics,
        ),
    ] = None
    workers: Annotated[
        int,
        typer.Option(
            "--workers", parser=whole_number(1), metavar="N", help="Processes that match, of one thread each."
        ),
    ] = 1
    times: Annotated[
        bool | None,
        typer.Option(
            "--times/--no-times",
            help="Measure times, one run after the other.",
            show_default="only with one worker",
        ),
    ] = None
    time_limit: Annotated[
        float | None,
        typer.Option(
            "--time-limit",
            parser=seconds,
            metavar="S",
            help="Stop a method that takes longer on one pair; its row fails.",
            show_default="none",
        ),
    ] = None
    isolate: Annotated[
        bool,
        typer.Option(
            "--isolate/--no-isolate",
            help="Run methods in processes of their own, so that one that hangs or dies costs its own rows only.",
        ),
    ] = True

    def protocol(self, method: MethodOptions, scene: SceneOptions) -> Protocol:
        """The protocol that these options and those of the method state."""
        from featreg.study.protocol import Protocol

        scene.check_ground()
        timing = self.workers == 1 if self.times is None else self.times
        said = {**method.keywords(), **scene.ground()}
        return Protocol(threshold=self.threshold, time_limit=self.time_limit, timing=timing, **said)

    def seeds(self, method: MethodOptions) -> range:
        """The seeds of the repetitions."""
        return range(method.seed, method.seed + self.repeats)


def words(text: str | None, what: str, example: str) -> list[str]:
    """Names with commas between them.

    Raises
    ------
    ParameterError
        There is no name.
    """
    names = [name.strip() for name in (text or "").split(",") if name.strip()]
    if not names:
        raise ParameterError(f"{what} needs names with commas between them, as in {example}, got '{text}'")
    return names


def metrics_of(text: str | None, layout: str | None) -> tuple[str, ...]:
    """The columns that were asked for."""
    from featreg.study.layouts import NEEDS
    from featreg.study.metrics import STANDARD, check_metrics

    names: Sequence[str] = STANDARD
    if text is not None:
        more = words(text.removeprefix("+"), "--metrics", "ncm,auc@3")
        names = [*STANDARD, *more] if text.startswith("+") else more
    return check_metrics([*names, *(NEEDS[layout] if layout else ())])


def pairs_of(images: Sequence[str], truth: Sequence[str]) -> list[dict[str, Any]]:
    """The image pairs of a command line: REF SEC [REF SEC ...], or one folder of pairs."""
    from featreg.study.image_pairs import opens, pairs_in

    found: list[dict[str, Any]]
    if len(images) == 1 and Path(images[0]).is_dir():
        found = [dict(pair) for pair in pairs_in(images[0])]
    else:
        folder = next((image for image in images if Path(image).is_dir() and not opens(image)), None)
        if folder is not None:
            raise InputError(
                f"'{folder}' is a directory and no product: give one folder of pairs, or images REF SEC [REF SEC ...]"
            )
        if len(images) % 2 or not images:
            last = f": '{images[-1]}' has no partner" if images else ""
            raise InputError(f"images come in pairs REF SEC [REF SEC ...], got {len(images)}{last}")
        found = [{"reference": a, "secondary": b} for a, b in zip(images[::2], images[1::2], strict=True)]
    if len(truth) not in (0, 1, len(found)):
        raise InputError(
            f"--truth is given once for all pairs or once per pair, got {len(truth)} for {len(found)} pairs"
        )
    for i, pair in enumerate(found):
        if truth:
            pair["truth"] = truth[i] if len(truth) == len(found) else truth[0]
    return found


def check_images(experiment: Experiment) -> None:
    """Open every image once, so that a wrong name or scale shows before anything is matched.

    Raises
    ------
    InputError
        No pair can be read; where only some cannot, their rows say why.
    """
    from featreg.io.raster_source import open_source

    protocol = experiment.protocol
    bands = bands_of(protocol.keywords())
    pairs = experiment.resolved()
    errors: list[FeatregError] = []
    for pair in pairs:
        try:
            for image, band in zip((pair.reference, pair.secondary), bands, strict=True):
                open_source(
                    image, nodata=protocol.nodata, scale=protocol.scale, calibrate=protocol.calibrate, band=band
                )
        except InputError as error:
            errors.append(error)
    if len(errors) == len(pairs):
        raise errors[0]
    for text in map(str, errors):
        logger.warning("%s", text)


@dataclass(frozen=True)
class OutputOptions:
    """What is printed and written, and where results are kept."""

    layout_format: Annotated[
        str | None,
        typer.Option(
            "--format",
            metavar="FORMAT",
            help="What is printed: text, md, csv, latex or json.",
            show_default="text in a terminal, else md",
            autocompletion=completion.words(*FORMATS),
        ),
    ] = None
    out: Annotated[
        str | None,
        typer.Option(
            "--output",
            "-o",
            "--out",
            metavar="FILE",
            help="Write the table too: .md, .csv, .tex, .json or .parquet.",
            show_default=False,
        ),
    ] = None
    report: Annotated[
        str | None,
        typer.Option("--report", metavar="FILE.html", help="Write a page to look at the results.", show_default=False),
    ] = None
    save: Annotated[
        str | None,
        typer.Option(
            "--save",
            metavar="FILE",
            help="Write this experiment as .yaml or .toml, for --experiment.",
            show_default=False,
        ),
    ] = None
    resume: Annotated[
        str | None,
        typer.Option(
            "--resume",
            metavar="DIR",
            help="Keep results in a folder and take them from there where nothing has changed.",
            show_default=False,
        ),
    ] = None

    def check(self, layout: str | None = None) -> None:
        """Raise where something could not be written or printed, before any work is done for it."""
        if self.layout_format is not None:
            check_name(self.layout_format, FORMATS, "format")
        if layout is not None:
            check_name(layout, LAYOUTS, "layout")
            if self.layout_format == "json":
                raise ParameterError("--layout is for --format text, md, csv or latex; JSON holds everything")
        check_output(self.out, "--out", suffixes=tuple(OUTPUTS))
        if layout is not None and self.out is not None and Path(self.out).suffix.lower() in (".json", ".parquet"):
            raise ParameterError(f"--layout is for --out .md, .csv or .tex; '{self.out}' would hold everything")
        check_output(self.report, "--report", suffixes=(".html",))
        check_output(self.save, "--save", suffixes=EXPERIMENTS)
        check_resume(self.resume)

    def write(self, study: Study, layout: str | None = None) -> Table:
        """Print the table of a study and write what was asked for."""
        table = study.table()
        chosen_format = self.layout_format or ("text" if sys.stdout.isatty() else "md")
        if chosen_format == "json":
            typer.echo(table.to_json(), nl=False)
        elif chosen_format == "text":
            print_styled(table.styled_lines(layout, terminal_width()))
        else:
            printed = {"md": table.to_markdown, "csv": table.to_csv, "latex": table.to_latex}[chosen_format]
            typer.echo(printed(layout=layout), nl=False)
        if self.out is not None:
            suffix = Path(self.out).suffix.lower()
            # What is written is what is printed.
            chosen = {} if suffix in (".json", ".parquet") else {"layout": layout}
            getattr(table, OUTPUTS[suffix])(self.out, **chosen)
        if self.report is not None:
            from featreg.report.from_study import write_study_report

            write_study_report(self.report, study)
        return table


def run(
    experiment: Experiment, how: RunOptions, output: OutputOptions, text: str, layout: str | None = None
) -> NoReturn:
    """Run an experiment, print its table, write what was asked for, and leave with the exit code."""
    experiment.check()
    check_images(experiment)
    if output.save is not None:
        experiment.to_file(output.save)
    announce_compiling()
    kept = f"the finished results are kept: --resume '{output.resume}' goes on from there"
    with saying_when_interrupted(None if output.resume is None else kept):
        study = experiment.run(workers=how.workers, isolate=how.isolate, resume=output.resume, progress=counter(text))
    raise typer.Exit(4 if output.write(study, layout).failed else 0)
