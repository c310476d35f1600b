"""`featreg sweep`: one method over a grid of its parameters."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from featreg.cli import comparison_options, completion
from featreg.cli.block_options import SceneOptions
from featreg.cli.comparison_options import OutputOptions, RunOptions
from featreg.cli.option_sets import offered, takes
from featreg.cli.options import MethodOptions
from featreg.cli.settings import parse_settings, parse_value
from featreg.errors import ParameterError
from featreg.pipeline.keywords import BY_NAME
from featreg.presets import DEFAULT_METHOD


@takes
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
        str,
        typer.Option(
            "--method", metavar="NAME", help="A name from `featreg list method`.", autocompletion=completion.methods
        ),
    ] = DEFAULT_METHOD,
    *,
    common: MethodOptions,
    scene: SceneOptions,
    how: RunOptions,
    output: OutputOptions,
) -> None:
    """Print a table of one method over a grid of parameters.

    Exit code 4 means that a combination failed with an error on a pair; its row says which.
    """
    output.check()
    from featreg.study.experiment import Experiment

    points = parse_grid(grid)
    named = {"method"} | offered(MethodOptions, SceneOptions, RunOptions, OutputOptions)
    parameters = parse_settings(common.settings, named)
    for key in points:
        if key in parameters or common.keywords().get(key) is not None:
            raise ParameterError(f"'{key}' is swept, so it cannot be set as well")
    found = Experiment(
        comparison_options.pairs_of(images, how.truth or []),
        [method],
        parameters,
        points,
        seeds=how.seeds(common),
        protocol=how.protocol(common, scene),
        metrics=comparison_options.metrics_of(how.metrics, None),
    )
    comparison_options.run(found, how, output, "sweeping")


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
        if key == "method" or (key in BY_NAME and BY_NAME[key].decides not in ("method", "part")):
            raise ParameterError(f"'{key}' cannot be swept: it is no parameter of a method")
        if key in found:
            raise ParameterError(f"--grid {key} is given twice")
        if len({repr(value) for value in listed}) < len(listed):
            raise ParameterError(f"--grid {key} holds a value twice: '{values}'")
        found[key] = listed
    return found
