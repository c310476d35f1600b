"""Tie points in files of featreg and of other programs, read into featreg's own pixel convention.

The writers are in `featreg.exports`; both sides take the pixel conventions from here.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.types import Matches

#: What to add to a point of featreg (first pixel's centre at 0) to get that of another program.
PIXEL_OFFSETS: Mapping[str, float] = {"csv": 0.0, "parquet": 0.0, "gdal": 0.5, "qgis": 0.5, "envi": 1.5, "colmap": 0.5}
COLUMNS = ("reference_x", "reference_y", "secondary_x", "secondary_y")
#: QGIS wrote pixelX, pixelY before version 3.26.
QGIS_COLUMNS = (("mapX", "mapY", "sourceX", "sourceY"), ("mapX", "mapY", "pixelX", "pixelY"))


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
    readers: dict[str, Callable[[], Matches]] = {
        ".points": lambda: _qgis(path, reference, secondary),
        ".pts": lambda: _envi(path),
        ".csv": lambda: _text(path),
        ".txt": lambda: _text(path),
        ".parquet": lambda: _parquet(path),
        ".npy": lambda: _bare(np.load(path, allow_pickle=False)),
    }
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"tie points '{path}' must be a {', '.join(readers)} file")
    try:
        return reader()
    except InputError as error:
        raise InputError(f"tie points '{path}': {error}") from error
    except OSError as error:
        raise InputError(f"tie points '{path}' cannot be read: {error.strerror or error}") from error
    except (ValueError, TypeError, LookupError, EOFError) as error:
        why = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"tie points '{path}' cannot be read: {why}") from error


def _lines(path: Path) -> list[str]:
    return [line.strip() for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip()]


def _numbers(rows: Sequence[Sequence[str]]) -> NDArray[np.float64]:
    for number, row in enumerate(rows, 1):
        if len(row) != len(rows[0]):
            raise InputError(f"row {number} has {len(row)} columns, the first has {len(rows[0])}")
    return np.array([[float(cell) if cell.strip() else np.nan for cell in row] for row in rows], np.float64)


def _bare(values: Any) -> Matches:
    array = np.asarray(values, np.float64)
    if array.ndim != 2 or array.shape[1] != 4:
        raise InputError(f"(M, 4) columns {', '.join(COLUMNS)} are needed, got shape {array.shape}")
    return Matches(array[:, :2], array[:, 2:], np.full(len(array), np.nan))


def _named(columns: Mapping[str, NDArray[np.float64]]) -> Matches:
    missing = [name for name in COLUMNS if name not in columns]
    if missing:
        raise InputError(f"the columns {', '.join(COLUMNS)} are needed, {', '.join(missing)} not found")
    x, y, u, v = (columns[name] for name in COLUMNS)
    score = columns.get("score", np.full(len(x), np.nan))
    covariance = None
    if all(name in columns for name in ("cov_xx", "cov_xy", "cov_yy")):
        xx, xy, yy = (columns[name] for name in ("cov_xx", "cov_xy", "cov_yy"))
        covariance = np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], -2)
    return Matches(np.column_stack([x, y]), np.column_stack([u, v]), score, covariance)


def _text(path: Path) -> Matches:
    lines = [line.split("#")[0].strip() for line in _lines(path)]
    cells = [
        [c.strip() for c in re.split(r"[,;]" if re.search("[,;]", line) else r"\s+", line)] for line in lines if line
    ]
    if not cells:
        raise InputError("is empty")
    if any(re.search("[A-Za-z_]{3}", cell) and cell.lower() not in ("nan", "inf") for cell in cells[0]):
        if not cells[1:]:
            return _named({name: np.zeros(0) for name in cells[0]})
        wanted = [
            i for i, name in enumerate(cells[0]) if name in COLUMNS or name in ("score", "cov_xx", "cov_xy", "cov_yy")
        ]
        values = _numbers([[row[i] for i in wanted] for row in cells[1:]])
        return _named({cells[0][i]: values[:, k] for k, i in enumerate(wanted)})
    return _bare(_numbers(cells))


def _parquet(path: Path) -> Matches:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.ParquetFile(io.BytesIO(path.read_bytes())).read()
    except pa.ArrowException as error:
        raise InputError(f"is not a whole Parquet file: {error}") from error
    wanted = (*COLUMNS, "score", "cov_xx", "cov_xy", "cov_yy")
    names = [name for name in table.column_names if name in wanted]
    return _named({name: np.asarray(table[name].to_numpy(), np.float64) for name in names})


def _envi(path: Path) -> Matches:
    lines = _lines(path)
    comments = " ".join(line for line in lines if line.startswith(";")).lower()
    if "image to map" in comments or "map (x,y)" in comments:
        raise InputError("holds ENVI map coordinates; image to image points (base x, y, warp x, y) are needed")
    rows = [re.split(r"[,\s]+", line) for line in lines if not line.startswith(";")]
    values = _numbers(rows).reshape(len(rows), -1) if rows else np.zeros((0, 4))
    return _bare(values[:, :4] - PIXEL_OFFSETS["envi"])


def _qgis(path: Path, reference: str | Path | None, secondary: str | Path | None) -> Matches:
    lines = _lines(path)
    crs = next((line[5:].strip() for line in lines if line.upper().startswith("#CRS:")), "")
    rows = list(csv.reader(line for line in lines if not line.startswith("#")))
    if not rows:
        raise InputError("is empty; a header mapX,mapY,sourceX,sourceY,enable is needed")
    names = next((names for names in QGIS_COLUMNS if all(n in rows[0] for n in names)), None)
    if names is None:
        raise InputError(f"the header must name {', '.join(QGIS_COLUMNS[0])}, got {', '.join(rows[0])}")
    on = rows[0].index("enable") if "enable" in rows[0] else None
    kept = [row for row in rows[1:] if on is None or row[on].strip() not in ("0", "false")]
    values = _numbers([[row[rows[0].index(n)] for n in names] for row in kept]).reshape(-1, 4)
    to = _side(values[:, :2], "mapX, mapY", "reference", reference, crs, on_map=bool(crs))
    return _bare(np.hstack([to, _side(values[:, 2:], "sourceX, sourceY", "secondary", secondary, crs, on_map=False)]))


def _side(
    at: NDArray[np.float64], names: str, role: str, image: str | Path | None, crs: str, *, on_map: bool
) -> NDArray[np.float64]:
    """Pixels of an image from the georeferencer's coordinates; `on_map` where these are surely no pixels."""
    # The georeferencer counts rows upwards from the top edge, so they are negative.
    pixels = at * (1, -1) - PIXEL_OFFSETS["qgis"]
    if image is None:
        if on_map:
            raise InputError(f"{names} are map coordinates (it has a CRS line); give the {role} image")
        if (pixels < -1).any():
            raise InputError(f"{names} are no pixels (some lie left of or above the image); give the {role} image")
        return pixels
    from featreg.io.raster_source import RasterSource

    source = RasterSource(str(image), band=1)
    place = source.geolocation
    if place is None or place.transform is None:
        if on_map:
            raise InputError(f"{image}: has no geotransform, so map coordinates say nothing about its pixels")
        return pixels
    if on_map and place.crs:
        _check_crs(crs, place.crs, image)
    a, b, c, d, e, f = place.transform
    ground = np.asarray(np.linalg.solve(np.array([[a, b], [d, e]]), (at - (c, f)).T).T - 0.5)
    if on_map:
        return ground

    def inside(xy: NDArray[np.float64]) -> int:
        height, width = source.shape
        return int(((xy > -1) & (xy < (width, height))).all(axis=1).sum())

    # Marked points of two plain images are pixels even where the images lie on a map; QGIS would name a CRS.
    return ground if inside(ground) > inside(pixels) - bool(crs) else pixels


def _check_crs(given: str, wanted: str, image: str | Path) -> None:
    import rasterio.crs

    try:
        same = rasterio.crs.CRS.from_user_input(given) == rasterio.crs.CRS.from_user_input(wanted)
    except rasterio.errors.CRSError as error:
        raise InputError(f"its CRS line cannot be read ({error})") from error
    if not same:
        raise InputError(f"its coordinate system is not that of {image}; mark the points in the reference's")
