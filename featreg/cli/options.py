"""What the commands share: options, `--set key=value`, checks of output paths, threads, progress."""

from __future__ import annotations

import dataclasses
import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import typer

from featreg.cli import completion
from featreg.errors import InputError, ParameterError, suggest
from featreg.pipeline.keywords import BY_NAME
from featreg.runtime.files import folder_of, is_stream
from featreg.runtime.progress import ProgressBar

COMPILING = "compiling kernels, the first time only (about half a minute)"
#: In place of a file's name: what would be written goes to the standard output.
STDOUT = "-"
WORDS = {"true": True, "false": False, "none": None, "inf": float("inf"), "-inf": float("-inf"), "nan": float("nan")}


def whole_number(least: int) -> Callable[[Any], int]:
    """Return a reader of whole numbers from `least` on, whose complaint says what was given."""

    def read(text: Any) -> int:
        try:
            value = int(str(text))
        except ValueError:
            value = least - 1
        if value < least:
            raise typer.BadParameter(f"a whole number >= {least} is needed, got '{text}'")
        return value

    return read


def number(text: Any) -> float:
    """Read a number."""
    try:
        return float(text)
    except ValueError as error:
        raise typer.BadParameter(f"a number is needed, got '{text}'") from error


def distance(text: Any) -> float:
    """Read a number of pixels greater than 0."""
    value = number(text)
    if not 0 < value < float("inf"):
        raise typer.BadParameter(f"a number of pixels > 0 is needed, got '{text}'")
    return value


NodataOption: TypeAlias = Annotated[
    float | None,
    typer.Option(
        "--nodata",
        parser=number,
        metavar="VALUE",
        help="Value of pixels without data.",
        show_default="what the file says",
    ),
]


BandOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--band",
        metavar="BAND",
        help="Which band of a file of several: its name (VV), its number, iq for complex samples of two, rgb.",
        show_default="the only one",
    ),
]


CalibrateOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--calibrate",
        metavar="QUANTITY",
        help="Read samples of a product as amplitudes of sigma0, beta0 or gamma0, by its own metadata.",
        show_default="as they are",
        autocompletion=completion.words("sigma0", "beta0", "gamma0"),
    ),
]


@dataclass(frozen=True)
class ReadingOptions:
    """How the two images of a pair are read."""

    scale: Annotated[
        str | None,
        typer.Option(
            "--scale",
            metavar="SCALE",
            help="What the samples are: amplitude, intensity or db.",
            show_default="told from the samples",
            autocompletion=completion.scales,
        ),
    ] = None
    calibrate: CalibrateOption = None
    nodata: NodataOption = None
    band: BandOption = None
    reference_band: Annotated[
        str | None,
        typer.Option("--reference-band", metavar="BAND", help="That of the reference.", show_default="--band"),
    ] = None
    secondary_band: Annotated[
        str | None,
        typer.Option("--secondary-band", metavar="BAND", help="That of the secondary.", show_default="--band"),
    ] = None

    def reading(self) -> dict[str, Any]:
        """As keywords."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(ReadingOptions)}


@dataclass(frozen=True)
class MaskOptions:
    """Which pixels of a pair are data."""

    mask_reference: Annotated[
        str | None,
        typer.Option(
            "--mask-reference", metavar="FILE", help="Image of the same size, 0 = no data.", show_default=False
        ),
    ] = None
    mask_secondary: Annotated[
        str | None,
        typer.Option(
            "--mask-secondary", metavar="FILE", help="Image of the same size, 0 = no data.", show_default=False
        ),
    ] = None

    def keywords(self) -> dict[str, Any]:
        """As keywords."""
        return {"reference_mask": self.mask_reference, "secondary_mask": self.mask_secondary}


@dataclass(frozen=True)
class MethodOptions(ReadingOptions):
    """What `match`, `compare`, `sweep` and `stack` all say of a method and of how images are read."""

    model: Annotated[
        str | None,
        typer.Option(
            "--model",
            metavar="NAME",
            help="Geometric model: translation, rigid, similarity, affine, homography, polynomial2, polynomial3, "
            "residual-field or, for scenes with RPCs, rpc-bias.",
            show_default="affine",
            autocompletion=completion.models,
        ),
    ] = None
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Replace a part (detector=fast, filters=gms,fsc) or a parameter (fsc.threshold=2) of the method; may "
            "be repeated. `featreg list` names them all.",
            show_default=False,
            autocompletion=completion.settings,
        ),
    ] = None
    seed: Annotated[
        int,
        typer.Option(
            "--seed", parser=whole_number(0), metavar="N", help="Of everything random; equal seeds give equal results."
        ),
    ] = 0
    n_features: Annotated[
        int | None,
        typer.Option(
            "--n-features",
            parser=whole_number(1),
            metavar="N",
            help="Most features per image and most tie points; in blocks, of each block.",
            show_default="5000, in blocks 1000",
        ),
    ] = None
    locate: Annotated[
        bool | None,
        typer.Option(
            "--locate/--no-locate",
            help="Measure the positions of the matches again after the first model.",
            show_default="as the method has it",
        ),
    ] = None
    refine: Annotated[
        bool | None,
        typer.Option(
            "--refine/--no-refine",
            help="Sub-pixel tie points around the first model.",
            show_default="as the method has it",
        ),
    ] = None

    def keywords(self) -> dict[str, Any]:
        """Those that are keywords of `featreg.match` and of a protocol alike."""
        return {name: getattr(self, name) for name in ("model", "n_features", "locate", "refine")} | self.reading()


def parse_settings(given: Sequence[str] | None, offered: Iterable[str]) -> dict[str, Any]:
    """Return the keywords of `--set key=value` options; `offered` are those that the command has options for.

    A value is read as JSON where it is JSON (numbers, true, false, null, lists, quoted text), as a number, or as text;
    `filters` takes names with commas between them.

    Raises
    ------
    ParameterError
        No "=", the same key twice, a key that has an option of its own, or one that no text can stand for.
    """
    offered = set(offered)
    settings: dict[str, Any] = {}
    for text in given or ():
        key, sign, value = text.partition("=")
        key = key.strip()
        if not sign or not key:
            raise ParameterError(f"--set takes KEY=VALUE, as in --set fsc.threshold=2, got '{text}'")
        if key in offered:
            option = BY_NAME[key].option if key in BY_NAME else f"--{key.replace('_', '-')}"
            raise ParameterError(f"'{key}' has an option of its own: write {option} instead of --set {text}")
        if key in ("progress", "cancel"):
            raise ParameterError(f"'{key}' is for Python only: progress is shown on a terminal, Ctrl-C stops the work")
        if key in settings:
            raise ParameterError(f"--set {key} is given twice")
        settings[key] = parse_value(value.strip())
        if key == "filters" and not isinstance(settings[key], list):
            settings[key] = [name.strip() for name in value.split(",") if name.strip()]
    return settings


def parse_value(text: str) -> Any:
    """Return the number, bool, None, list or text that a value on the command line stands for."""
    if text.lower() in WORDS:
        return WORDS[text.lower()]
    for read in (json.loads, float):
        try:
            return read(text)
        except ValueError:
            continue
    return text


def check_output(
    path: str | None, what: str, *, suffixes: Sequence[str] = (), inputs: Iterable[str] = (), stdout: bool = False
) -> None:
    """Raise an `InputError` where a file could not be written, before any work is done for it.

    Parameters
    ----------
    path : None is no file, and right
    what : the option, for the message
    suffixes : how the name may end
    inputs : files that must not be overwritten
    stdout : whether "-" may stand for the standard output
    """
    if path is None or (stdout and path == STDOUT):
        return
    target = Path(path)
    if not path or path == "-":
        raise InputError(f"{what} needs the name of a file, got '{path}'")
    if target.is_dir():
        raise InputError(
            f"{what} '{path}' is a directory, give a file name such as '{target / ('out' + _first(suffixes))}'"
        )
    if suffixes and target.suffix.lower() not in suffixes:
        raise InputError(f"{what} '{path}' must end in {' or '.join(suffixes)}")
    if not is_stream(target):
        check_folder(folder_of(target), f"{what} '{path}'")
    if target.exists() and not os.access(target, os.W_OK):
        raise InputError(f"{what} '{path}' exists and may not be replaced, give another name")
    for given in inputs:
        if target.exists() and Path(given).exists() and target.samefile(given):
            raise InputError(f"{what} '{path}' would replace an input, give another name")


def check_folder(folder: Path, what: str) -> None:
    """Raise an `InputError` where no file can be made in a folder."""
    if not folder.exists():
        raise InputError(f"{what}: the folder '{folder}' does not exist, make it first")
    if not folder.is_dir():
        raise InputError(f"{what}: '{folder}' is a file, a folder is needed")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"{what}: the folder '{folder}' may not be written to, choose another")


def check_name(given: str, known: Iterable[str], what: str) -> None:
    """Raise a `ParameterError` that suggests the nearest name where `given` is none of those known."""
    names = list(known)
    if given not in names:
        raise ParameterError(f"unknown {what} '{given}', {suggest(given, names)}")


@contextmanager
def saying_when_interrupted(text: str | None) -> Iterator[None]:
    """Let Ctrl-C say how to go on from what is kept; None says nothing."""
    try:
        yield
    except KeyboardInterrupt as stop:
        if text is not None:
            stop.add_note(text)
        raise


def progress(text: str) -> None:
    """Say what is being done, on stderr and only when someone looks at it."""
    if sys.stderr.isatty():
        typer.echo(f"{text} ...", err=True)


def counter(text: str) -> Callable[[int, int], None] | None:
    """Return a callback that keeps a bar of progress up to date, or None when nobody looks at stderr."""
    return ProgressBar(text) if sys.stderr.isatty() else None


def announce_compiling() -> None:
    """Say that the first run takes longer, where someone looks and it will."""
    if sys.stderr.isatty():
        from featreg.warming import ready

        if not ready():
            progress(COMPILING)


def _first(suffixes: Sequence[str]) -> str:
    return suffixes[0] if suffixes else ".json"
