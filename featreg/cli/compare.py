"""`featreg compare`: several methods on one or more pairs, as a table."""

from __future__ import annotations

import dataclasses
import logging
from typing import TYPE_CHECKING, Annotated, Any

import typer

from featreg.cli import comparison_options, completion
from featreg.cli.block_options import SceneOptions
from featreg.cli.comparison_options import OutputOptions, RunOptions
from featreg.cli.option_sets import offered, takes
from featreg.cli.options import MethodOptions
from featreg.cli.settings import parse_settings
from featreg.errors import FeatregError, ParameterError

if TYPE_CHECKING:
    from featreg.study.experiment import Experiment

ALL = "all"
logger = logging.getLogger(__name__)


@takes
def compare(
    context: typer.Context,
    images: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="REF SEC | FOLDER",
            help="Pairs of images, one after the other, or a folder of images named in pairs (port_1.tif and "
            "port_2.tif, port_before.png and port_after.png, with port_truth.csv).",
            show_default=False,
        ),
    ] = None,
    methods: Annotated[
        str | None,
        typer.Option(
            "--methods",
            metavar="A,B,C",
            help="Names from `featreg list method`, or all.",
            show_default=False,
            autocompletion=completion.several_methods,
        ),
    ] = None,
    experiment: Annotated[
        str | None,
        typer.Option(
            "--experiment",
            metavar="FILE",
            help="Run what a .yaml or .toml file says, instead of images, methods and protocol here.",
            show_default=False,
        ),
    ] = None,
    layout: Annotated[
        str | None,
        typer.Option(
            "--layout",
            metavar="NAME",
            help="table2 or table3: the columns of these tables of the SAR-ORB paper.",
            show_default=False,
            autocompletion=completion.words("table2", "table3"),
        ),
    ] = None,
    *,
    method: MethodOptions,
    scene: SceneOptions,
    how: RunOptions,
    output: OutputOptions,
) -> None:
    """Print a table of methods on image pairs.

    Exit code 4 means that a method failed with an error on a pair; its row says which.
    """
    output.check(layout)
    if experiment is not None:
        _refuse_beside_file(context)
        found = _from_file(experiment, how.metrics, layout, how.times)
    else:
        if methods is None:
            raise ParameterError("missing option '--methods'; see 'featreg compare --help'")
        from featreg.study.experiment import Experiment

        named = {"method"} | offered(MethodOptions, SceneOptions, RunOptions, OutputOptions)
        parameters = parse_settings(method.settings, named)
        names = _names(methods)
        found = Experiment(
            comparison_options.pairs_of(images or [], how.truth or []),
            _usable(parameters) if names == [ALL] else names,
            parameters,
            seeds=how.seeds(method),
            protocol=how.protocol(method, scene),
            metrics=comparison_options.metrics_of(how.metrics, layout),
        )
    comparison_options.run(found, how, output, "comparing", layout)


def _names(methods: str) -> list[str]:
    return comparison_options.words(methods, "--methods", "sar-orb,orb")


def _usable(parameters: dict[str, Any]) -> list[str]:
    """Every method that can be used here with these parameters; a warning names the others."""
    from featreg.matching import check_keywords
    from featreg.registry import available

    found = []
    for name in available("method"):
        try:
            check_keywords({"method": name, **parameters})
        except FeatregError as error:
            logger.warning("method %s is left out: %s", name, error)
        else:
            found.append(name)
    if not found:
        raise ParameterError("no method takes these parameters; name one with --methods to see why")
    return found


def _refuse_beside_file(context: typer.Context) -> None:
    """The file says what is matched and how it is scored: an option that says it too could contradict it."""
    own = {"experiment", "metrics", "workers", "times", "isolate", "resume", "layout_format", "layout", "out", "report",
           "save"}  # fmt: skip
    for parameter in context.command.params:
        source = context.get_parameter_source(parameter.name or "")
        if parameter.name not in own and source is not None and source.name == "COMMANDLINE":
            given = parameter.opts[0] if parameter.opts[0].startswith("-") else "images"
            raise ParameterError(f"{given} cannot be given with --experiment: write it into the file")


def _from_file(path: str, metrics: str | None, layout: str | None, times: bool | None) -> Experiment:
    from featreg.study.experiment import Experiment

    found = Experiment.from_file(path)
    names = list(found.metrics if metrics is None else ())
    if metrics is not None or layout is not None:
        more = comparison_options.metrics_of(metrics, layout)
        kept = [*names, *(n for n in more if n not in names)] if metrics is None or metrics.startswith("+") else more
        found = dataclasses.replace(found, metrics=tuple(kept))
    if times is not None:
        found = dataclasses.replace(found, protocol=dataclasses.replace(found.protocol, timing=times))
    return found
