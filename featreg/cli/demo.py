"""`featreg demo`: on a simulated pair with known truth, register, compare with OpenCV, draw, write."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from featreg.cli.checking import check_folder
from featreg.cli.progress import COMPILING, progress
from featreg.cli.simulate import write_images, write_truth

if TYPE_CHECKING:
    from featreg.results.registration import Registration
    from featreg.study.table import Table

METHODS = ("sar-orb", "orb", "akaze")
SHAPE = (600, 600)


@dataclass(frozen=True, eq=False)
class Demonstration:
    """What a demonstration made.

    Parameters
    ----------
    registration : of the first method
    table : the comparison of all methods against the truth
    files : (path, what it holds)
    """

    registration: Registration
    table: Table
    files: Sequence[tuple[Path, str]]


def demo(
    out: Annotated[
        str,
        typer.Option("--output", "-o", "--out", metavar="DIR", help="Folder for images, pictures and results."),
    ] = "featreg-demo",
) -> None:
    """Try everything on a simulated pair.

    Simulates two SAR images with known truth, registers them, compares the method with two of OpenCV and draws the
    result.
    """
    folder = Path(out)
    check_folder(folder if folder.exists() else folder.absolute().parent, f"--out '{out}'")
    from featreg.warming import ready

    if not ready():
        typer.echo(f"{COMPILING} ...", err=True)
    made = demonstrate(folder, progress=progress)
    typer.echo("Two simulated SAR images of 600 x 600 pixels, 4 looks, turned by 6 degrees, scaled by 1.02:\n")
    typer.echo(made.table.to_markdown())
    typer.echo("Files:")
    for path, what in made.files:
        typer.echo(f"  {path!s:<36} {what}")
    reference, secondary, truth = (folder / name for name in ("reference.tif", "secondary.tif", "truth.json"))
    typer.echo("\nTry next:")
    typer.echo(f"  featreg match {reference} {secondary} --plot mine.png")
    typer.echo(f"  featreg compare {reference} {secondary} --methods sar-orb,sift --truth {truth}")
    if made.table.failed:
        raise typer.Exit(4)
    raise typer.Exit(0 if made.registration.status == "ok" else 3)


def demonstrate(
    folder: str | Path,
    *,
    shape: tuple[int, int] = SHAPE,
    seed: int = 0,
    methods: Sequence[str] = METHODS,
    progress: Callable[[str], None] | None = None,
) -> Demonstration:
    """Simulate a SAR pair, register it, compare methods against the exact truth, and write everything to a folder.

    Parameters
    ----------
    folder : made if it is missing; files of an earlier demonstration are replaced
    shape : (H, W) of both images
    seed : of the simulation and of the methods
    methods : the first one makes the registration that is drawn
    progress : called with a few words before each step

    Returns
    -------
    `Demonstration`

    Raises
    ------
    InputError
        The folder cannot be written.
    """
    from featreg.io import as_image
    from featreg.matching import match
    from featreg.pictures.drawing import draw_registration
    from featreg.pictures.panels import display
    from featreg.runtime.files import write_atomic
    from featreg.simulate import sar_pair
    from featreg.study.comparison import compare

    say = progress or (lambda text: None)
    folder = Path(folder)
    say(f"simulating two SAR images of {shape[1]} x {shape[0]} pixels")
    pair = sar_pair(shape, seed=seed)
    files = []
    write_images(folder, {"reference.tif": pair.reference, "secondary.tif": pair.secondary})
    for role, array in (("reference", pair.reference), ("secondary", pair.secondary)):
        write_atomic(folder / f"{role}.png", _png(display(as_image(array))))
        files += [(folder / f"{role}.tif", f"{role} image, float32 amplitude"), (folder / f"{role}.png", "to look at")]
    write_truth(folder, {"matrix": pair.truth.tolist()})
    files.append((folder / "truth.json", "exact truth, reference -> secondary"))

    paths = folder / "reference.tif", folder / "secondary.tif"
    say(f"registering with {methods[0]}")
    registration = match(*paths, method=methods[0], seed=seed)
    registration.to_json(folder / "result.json")
    draw_registration(as_image(paths[0]), as_image(paths[1]), registration, folder / "registration.png")
    files.append((folder / "result.json", f"result of {methods[0]}: model, tie points, gates"))
    files.append((folder / "registration.png", "tie points, checkerboard and overlay"))

    say(f"comparing {', '.join(methods)}, each run twice and timed once")
    table = compare([(*paths, folder / "truth.json")], methods, seed=seed)
    table.to_markdown(folder / "comparison.md")
    files.append((folder / "comparison.md", "the table"))
    return Demonstration(registration, table, files)


def _png(gray: object) -> bytes:
    import cv2

    _, content = cv2.imencode(".png", gray)  # type: ignore[call-overload]  # any array
    encoded: bytes = content.tobytes()
    return encoded
