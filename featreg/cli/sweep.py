"""`featreg sweep`: one method over a grid of its parameters."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from featreg.cli import study
from featreg.cli.options import (
    OWN_OPTIONS,
    FeaturesOption,
    ModelOption,
    NodataOption,
    RefineOption,
    ScaleOption,
    SeedOption,
    SetOption,
    parse_settings,
    parse_value,
)
from featreg.cli.study import (
    FormatOption,
    IsolateOption,
    LimitOption,
    MetricsOption,
    OutOption,
    RepeatsOption,
    ReportOption,
    ResumeOption,
    SaveOption,
    ThresholdOption,
    TimesOption,
    TruthOption,
    WorkersOption,
)
from featreg.errors import ParameterError

#: Parameters of every method, which may be swept though they have options of their own.
SWEPT = ("n_features", "model", "refine")


def sweep(
    images: Annotated[
        list[str],
        typer.Argument(
            metavar="REF SEC | FOLDER",
            help="Pairs of images, one after the other, or a folder of images named in pairs.",
            show_default=False,
        ),
    ],
    grid: Annotated[
        list[str],
        typer.Option(
            "--grid",
            metavar="KEY=A,B,C",
            help="Values of one parameter, as in fsc.threshold=1,2,3; given for several, every combination is run.",
            show_default=False,
        ),
    ],
    method: Annotated[
        str, typer.Option("--method", metavar="NAME", help="A name from `featreg list method`.")
    ] = "sar-orb",
    truth: TruthOption = None,
    model: ModelOption = None,
    settings: SetOption = None,
    seed: SeedOption = 0,
    repeats: RepeatsOption = 1,
    n_features: FeaturesOption = None,
    refine: RefineOption = None,
    scale: ScaleOption = None,
    nodata: NodataOption = None,
    threshold: ThresholdOption = 1.5,
    metrics: MetricsOption = None,
    workers: WorkersOption = 1,
    times: TimesOption = None,
    time_limit: LimitOption = None,
    isolate: IsolateOption = True,
    resume: ResumeOption = None,
    layout_format: FormatOption = "md",
    out: OutOption = None,
    report: ReportOption = None,
    save: SaveOption = None,
) -> None:
    """Print a table of one method over a grid of parameters.

    Exit code 4 means that a combination failed with an error on a pair; its row says which.
    """
    output = study.Output(layout_format, None, out, report, save, resume)
    output.check()
    from featreg.study.experiment import Experiment
    from featreg.study.protocol import Protocol

    points = parse_grid(grid)
    parameters = parse_settings(settings)
    for key in points:
        if key in parameters or {"n_features": n_features, "model": model, "refine": refine}.get(key) is not None:
            raise ParameterError(f"'{key}' is swept, so it cannot be set as well")
    found = Experiment(
        study.pairs_of(images, truth or []),
        [method],
        parameters,
        points,
        seeds=range(seed, seed + repeats),
        protocol=Protocol(
            threshold=threshold,
            n_features=n_features,
            model=model,
            refine=refine,
            scale=scale,
            nodata=nodata,
            time_limit=time_limit,
            timing=workers == 1 if times is None else times,
        ),
        metrics=study.metrics_of(metrics, None),
    )
    study.run(found, output, "sweeping", workers=workers, isolate=isolate)


def parse_grid(given: list[str]) -> dict[str, list[Any]]:
    """Parameter -> values of `--grid key=a,b,c` options.

    Raises
    ------
    ParameterError
        No "=", no value, a value or a parameter twice, or one that is no parameter of a method.
    """
    found: dict[str, list[Any]] = {}
    for text in given:
        key, sign, values = (part.strip() for part in text.partition("="))
        listed = [parse_value(value.strip()) for value in values.split(",") if value.strip()]
        if not sign or not key or not listed:
            raise ParameterError(f"--grid takes KEY=A,B,C, as in --grid fsc.threshold=1,2,3, got '{text}'")
        if key in OWN_OPTIONS and key not in SWEPT:
            raise ParameterError(f"'{key}' cannot be swept: it is no parameter of a method")
        if key in found:
            raise ParameterError(f"--grid {key} is given twice")
        if len({repr(value) for value in listed}) < len(listed):
            raise ParameterError(f"--grid {key} holds a value twice: '{values}'")
        found[key] = listed
    return found
