"""`featreg simulate`: images with exactly known geometry: a pair, a scene with RPCs and terrain, a stack of dates."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from featreg.cli import completion
from featreg.cli.checking import check_folder, check_name, number, whole_number
from featreg.cli.progress import counter, progress
from featreg.errors import InputError, ParameterError

if TYPE_CHECKING:
    from featreg.types import FloatArray

KINDS = ("pair", "scene", "stack")
#: Option -> kinds that it says something of, and the keyword there.
MEANT_FOR = {
    "rotation": (("pair", "stack"), "rotation_deg"),
    "zoom": (("pair",), "scale"),
    "shift": (("pair",), "shift"),
    "change": (("pair", "scene"), "change"),
    "relief": (("scene",), "relief"),
    "count": (("stack",), "count"),
    "drift": (("stack",), "drift"),
}
#: Digits of a date in the name of its file.
DIGITS = 3


def size(text: Any) -> tuple[int, int]:
    """Read N or WIDTHxHEIGHT in pixels as (rows, columns)."""
    found = re.fullmatch(r"(\d+)(?:[xX,](\d+))?", str(text).strip())
    if found is None:
        raise typer.BadParameter(f"a number of pixels, or two as 800x600 (columns x rows), is needed, got '{text}'")
    return int(found[2] or found[1]), int(found[1])


def displacement(text: Any) -> tuple[float, float]:
    """Read X,Y in pixels."""
    parts = str(text).split(",")
    if len(parts) != 2:
        raise typer.BadParameter(f"two numbers of pixels as X,Y are needed, got '{text}'")
    return number(parts[0]), number(parts[1])


def simulate(
    kind: Annotated[
        str,
        typer.Argument(
            metavar="KIND",
            help="pair: two dates of one landscape; scene: two satellite scenes with RPCs, terrain and elevation "
            "model; stack: many dates that drift.",
            show_default=False,
            autocompletion=completion.words(*KINDS),
        ),
    ],
    output: Annotated[
        str,
        typer.Option("--output", "-o", metavar="DIR", help="Folder for images and truth.", show_default=False),
    ],
    shape: Annotated[
        Any,
        typer.Option(
            "--size", parser=size, metavar="N|WxH", help="Pixels of each image.", show_default="600, scenes 2000"
        ),
    ] = None,
    looks: Annotated[
        float, typer.Option("--looks", parser=number, metavar="L", help="Independent looks; inf: no speckle.")
    ] = 4.0,
    rotation: Annotated[
        float | None,
        typer.Option(
            "--rotation",
            parser=number,
            metavar="DEG",
            help="Of the secondary, counter-clockwise; of a stack, standard deviation of the dates.",
            show_default="6, stacks 0.02",
        ),
    ] = None,
    zoom: Annotated[
        float | None,
        typer.Option(
            "--zoom",
            parser=number,
            metavar="FACTOR",
            help="Size in the secondary of a pixel of the reference.",
            show_default="1.02",
        ),
    ] = None,
    shift: Annotated[
        Any,
        typer.Option(
            "--shift", parser=displacement, metavar="X,Y", help="Of the image centre, px.", show_default="12,-7"
        ),
    ] = None,
    change: Annotated[
        float | None,
        typer.Option(
            "--change",
            parser=number,
            metavar="SHARE",
            help="Share of fields and buildings that differ between the dates.",
            show_default="0.05",
        ),
    ] = None,
    relief: Annotated[
        float | None,
        typer.Option(
            "--relief", parser=number, metavar="M", help="Metres from valley to hill, of a scene.", show_default="150"
        ),
    ] = None,
    count: Annotated[
        int | None,
        typer.Option("--count", parser=whole_number(2), metavar="N", help="Dates of a stack.", show_default="8"),
    ] = None,
    drift: Annotated[
        float | None,
        typer.Option(
            "--drift",
            parser=number,
            metavar="PX",
            help="Standard deviation of the step from date to date, of a stack.",
            show_default="0.25",
        ),
    ] = None,
    seed: Annotated[
        int, typer.Option("--seed", parser=whole_number(0), metavar="N", help="Equal seeds give equal files.")
    ] = 0,
) -> None:
    """Simulate SAR images with exactly known truth.

    Writes float32 GeoTIFFs (scenes: uint16 with RPCs and an elevation model) and a truth.json for
    `featreg compare --truth`, or, of a stack, with the matrix of every date.
    """
    check_name(kind, KINDS, "kind")
    given = {
        "rotation": rotation, "zoom": zoom, "shift": shift, "change": change, "relief": relief, "count": count,
        "drift": drift,
    }  # fmt: skip
    keywords: dict[str, Any] = {"looks": _whole(looks), "seed": seed}
    for option, value in given.items():
        kinds, keyword = MEANT_FOR[option]
        if value is not None and kind not in kinds:
            raise ParameterError(f"--{option} is for {' and '.join(kinds)}, not for '{kind}': leave it out")
        keywords |= {} if value is None else {keyword: value}
    folder = Path(output)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--output '{output}' is a file, a folder is needed")
    check_folder(folder if folder.is_dir() else folder.absolute().parent, f"--output '{output}'")
    made = {"pair": _pair, "scene": _scene, "stack": _stack}[kind](folder, shape, keywords)
    for line in made:
        typer.echo(line)


def _whole(value: float) -> float | int:
    return int(value) if value.is_integer() else value


def _pair(folder: Path, shape: tuple[int, int] | None, keywords: dict[str, Any]) -> Sequence[str]:
    from featreg.simulate import sar_pair

    pair = sar_pair(shape or (600, 600), progress=counter("images"), **keywords)
    write_images(folder, {"reference.tif": pair.reference, "secondary.tif": pair.secondary})
    write_truth(folder, {"matrix": pair.truth.tolist()})
    return _said(folder, "reference.tif, secondary.tif, truth.json", "reference.tif", "secondary.tif")


def _stack(folder: Path, shape: tuple[int, int] | None, keywords: dict[str, Any]) -> Sequence[str]:
    from featreg.simulate import sar_series

    series = sar_series(shape=shape or (600, 600), progress=counter("dates"), **keywords)
    names = [f"date_{i:0{DIGITS}d}.tif" for i in range(len(series.images))]
    write_images(folder, dict(zip(names, series.images, strict=True)))
    truths: Sequence[FloatArray] = series.truths
    write_truth(folder, {"matrices": {name: t.tolist() for name, t in zip(names, truths, strict=True)}})
    return [
        f"written: {folder}, {names[0]} to {names[-1]}, truth.json (first image -> image)",
        f"try next: featreg stack {_typed(folder)}/date_*.tif -o {_typed(folder / 'stack')}",
    ]


def _scene(folder: Path, shape: tuple[int, int] | None, keywords: dict[str, Any]) -> Sequence[str]:
    from featreg.simulate.scene import simulate_scene

    bars: dict[str, Callable[[int, int], None] | None] = {}

    def show(file: str, done: int, total: int) -> None:
        if file not in bars:
            bars[file] = counter(f"painting {file}")
        bar = bars[file]
        if bar is not None:
            bar(done, total)

    progress("simulating orbits, terrain and RPCs")
    simulate_scene(folder, shape or (2000, 2000), progress=show, **keywords)
    lines = _said(folder, "reference.tif, secondary.tif, dem.tif, truth.json", "reference.tif", "secondary.tif")
    return [*lines[:-1], f"{lines[-1]} --dem {_typed(folder / 'dem.tif')} --model rpc-bias"]


def _said(folder: Path, files: str, reference: str, secondary: str) -> list[str]:
    images = " ".join(_typed(folder / name) for name in (reference, secondary))
    return [f"written: {folder}, {files}", f"try next: featreg match {images}"]


def _typed(path: Path) -> str:
    """A path as it is typed into a shell."""
    return shlex.quote(str(path))


def write_images(folder: Path, images: dict[str, Any]) -> None:
    """Write arrays as GeoTIFFs into a folder, which is made where it is missing."""
    from featreg.io import write_geotiff

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make the folder '{folder}': {error.strerror}") from error
    for name, array in images.items():
        write_geotiff(folder / name, array)


def write_truth(folder: Path, truth: dict[str, Any]) -> None:
    """Write what is exactly known as truth.json."""
    from featreg.runtime.files import write_atomic

    write_atomic(folder / "truth.json", f"{json.dumps(truth, indent=2)}\n".encode())
