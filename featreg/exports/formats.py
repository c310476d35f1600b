"""Tie points in files of featreg and of other programs: the table of formats, and how they are written and read.

A format is a module with ``write(content, path)``, ``read(path)`` or both, and its pixel convention.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import NamedTuple

from featreg.errors import InputError, ParameterError, suggest
from featreg.exports import colmap, csv, envi, gdal, geojson, geoparquet, gpkg, npy, parquet, qgis, rpc
from featreg.exports.content import Content, content_of
from featreg.io.writers import replacing
from featreg.products.grid import inputs_of
from featreg.results.json_file import tie_point_file
from featreg.results.registration import Registration
from featreg.types import Matches


class Format(NamedTuple):
    """How the files of a format may end, and what writes them."""

    suffixes: tuple[str, ...]
    write: Callable[[Content, Path], None]


FORMATS: Mapping[str, Format] = {
    "csv": Format((".csv",), csv.write),
    "parquet": Format((".parquet",), parquet.write),
    "gdal": Format((".vrt", ".tif", ".tiff", ".txt"), gdal.write),
    "qgis": Format((".points",), qgis.write),
    "envi": Format((".pts",), envi.write),
    "colmap": Format((".db",), colmap.write),
    "rpc": Format(("_rpc.txt", ".rpb"), rpc.write),
    "geojson": Format((".geojson", ".json"), geojson.write),
    "gpkg": Format((".gpkg",), gpkg.write),
    "geoparquet": Format((".parquet", ".geoparquet"), geoparquet.write),
}


#: Formats whose files hold no tie points.
WITHOUT_POINTS = ("rpc",)


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
    to : "csv", "parquet", "gdal" (suffix .vrt, .tif or .txt), "qgis", "envi", "colmap", "rpc", or with arrows, error
        ellipses and the images' outlines "geojson", "gpkg" or "geoparquet" (the latter two: ``featreg[vectors]``)
    stage : "inliers", the name of a filter, or "all"
    reference, secondary : the images' files, where they are no longer where the result says

    Returns
    -------
    int
        Tie points written; 0 is no error, and what a format without them gives.

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
    suffixes, write = FORMATS[to]
    if not path.name.lower().endswith(suffixes):
        raise ParameterError(f"{path}: the format '{to}' needs a name that ends in {' or '.join(suffixes)}")
    inputs: list[str | Path] = []
    if isinstance(registration, str | Path):
        inputs = [registration, tie_point_file(Path(registration))]
        registration = Registration.from_json(registration)
    content = content_of(registration, stage, reference, secondary)
    inputs += [*inputs_of(registration), content.reference.path, content.secondary.path]
    with replacing(path, inputs=inputs) as temporary:
        write(content, temporary)
        if not temporary.is_file():
            raise InputError(f"{path}: nothing was written")
    return 0 if to in WITHOUT_POINTS else len(content.matches)


def read_tie_points(
    path: str | Path, *, reference: str | Path | None = None, secondary: str | Path | None = None
) -> Matches:
    """Read marked or exported tie points.

    Parameters
    ----------
    path : ``.points`` (QGIS georeferencer: the source image is the secondary), ``.pts`` (ENVI, image to image: base is
        the reference, warp the secondary), ``.csv`` or ``.txt`` (columns reference_x, reference_y, secondary_x,
        secondary_y and, where there are, score, cov_xx, cov_xy, cov_yy; or four bare columns in that order),
        ``.parquet`` (the same columns), ``.npy`` (M, 4)
    reference, secondary : for ``.points`` in map coordinates, the images whose geotransforms take them to pixels: QGIS
        counts the pixels of an image that has none, and writes map coordinates of one that has

    Returns
    -------
    Matches
        (x, y) with the centre of the first pixel at (0, 0), float64; score NaN where the file has none.

    Raises
    ------
    InputError
        The file cannot be read, is of another kind, holds something that is no number, or map coordinates without an
        image that has a geotransform (the reference: in the same coordinate system).
    """
    path = Path(path)
    readers: dict[str, Callable[[Path], Matches]] = {
        ".points": partial(qgis.read, reference=reference, secondary=secondary),
        ".pts": envi.read,
        ".csv": csv.read,
        ".txt": csv.read,
        ".parquet": parquet.read,
        ".npy": npy.read,
    }
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"tie points '{path}' must be a {', '.join(readers)} file")
    try:
        return reader(path)
    except InputError as error:
        raise InputError(f"tie points '{path}': {error}") from error
    except OSError as error:
        raise InputError(f"tie points '{path}' cannot be read: {error.strerror or error}") from error
    except (ValueError, TypeError, LookupError, EOFError, ArithmeticError) as error:
        why = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"tie points '{path}' cannot be read: {why}") from error
