"""The formats tie points can be exported to; one module each, with a function ``write(content, path)``."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from featreg.errors import InputError, ParameterError, suggest
from featreg.exports.content import content_of
from featreg.io.writers import replacing
from featreg.products.grid import inputs_of
from featreg.results.json_file import tie_point_file
from featreg.results.registration import Registration


@dataclass(frozen=True)
class Format:
    """A format: how its files may end, what it is, and the pixel coordinates of the first pixel's centre."""

    suffixes: tuple[str, ...]
    summary: str
    first_pixel: str


FORMATS = {
    "csv": Format((".csv",), "table with every column of the result", "(0, 0)"),
    "parquet": Format((".parquet",), "the same table, typed", "(0, 0)"),
    "gdal": Format((".vrt", ".tif", ".tiff", ".txt"), "ground control points of the secondary", "(0.5, 0.5)"),
    "qgis": Format((".points",), "georeferencer points", "(0.5, -0.5)"),
    "envi": Format((".pts",), "image-to-image control points", "(1.5, 1.5)"),
    "colmap": Format((".db",), "database of images, keypoints and matches", "(0.5, 0.5)"),
    "rpc": Format(("_rpc.txt", ".rpb"), "the secondary's RPC corrected by a model rpc-bias", "(0, 0)"),
}


def export(
    registration: Registration | str | Path,
    path: str | Path,
    *,
    to: str,
    stage: str = "inliers",
    reference: str | Path | None = None,
    secondary: str | Path | None = None,
) -> int:
    """Write the tie points of a result for another program, in that program's pixel convention.

    Parameters
    ----------
    registration : the result, or its JSON file
    path : file to write, replaced if it exists; it appears whole or not at all
    to : "csv", "parquet", "gdal" (suffix .vrt, .tif or .txt), "qgis", "envi", "colmap" or "rpc"
    stage : "inliers", the name of a filter, or "all"
    reference, secondary : the images' files, where they are no longer where the result says

    Returns
    -------
    int
        Tie points written; 0 is no error.

    Raises
    ------
    ParameterError
        An unknown format or stage, or a suffix that the format does not have.
    InputError
        The file cannot be written, would replace an input, or needs an image that is not at hand.
    """
    path = Path(path)
    if to not in FORMATS:
        raise ParameterError(f"unknown format '{to}', {suggest(to, FORMATS)}")
    suffixes = FORMATS[to].suffixes
    if not path.name.lower().endswith(suffixes):
        raise ParameterError(f"{path}: the format '{to}' needs a name that ends in {' or '.join(suffixes)}")
    inputs: list[str | Path] = []
    if isinstance(registration, str | Path):
        inputs = [registration, tie_point_file(Path(registration))]
        registration = Registration.from_json(registration)
    content = content_of(registration, stage, reference, secondary)
    inputs += [*inputs_of(registration), content.reference.path, content.secondary.path]
    with replacing(path, inputs=inputs) as temporary:
        import_module(f"featreg.exports.{to}").write(content, temporary)
        if not temporary.is_file():
            raise InputError(f"{path}: nothing was written")
    return len(content.matches)
