"""QGIS georeferencer points (``.points``): the source image is the secondary, the map is that of the reference.

Source coordinates have the first pixel's centre at (0.5, -0.5): rows count upwards from the top edge. Of a secondary
with a geotransform they are its map coordinates, as QGIS (3.26) has it. Where nothing says where the reference lies the
map is the reference's own pixels in the same convention, and no CRS is named.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from featreg.errors import InputError
from featreg.exports.columns import lines_of, matches_of_array, numbers
from featreg.exports.content import Content, ground_of
from featreg.geolocation.geotransform import on_map
from featreg.types import FloatArray, Matches

PIXEL_OFFSET = 0.5
HEADER = "mapX,mapY,sourceX,sourceY,enable,dX,dY,residual"
#: QGIS wrote pixelX, pixelY before version 3.26.
COLUMNS = (("mapX", "mapY", "sourceX", "sourceY"), ("mapX", "mapY", "pixelX", "pixelY"))


def write(content: Content, path: Path) -> None:
    """Write all points enabled, with their residuals in pixels."""
    where = content.secondary.geolocation
    if where is not None and where.transform is not None:
        source = on_map(where.transform, content.matches.secondary_xy)
    else:
        source = (content.matches.secondary_xy + PIXEL_OFFSET) * (1, -1)
    ground = ground_of(content.reference, content.matches.reference_xy, content.model)
    place = (content.matches.reference_xy + PIXEL_OFFSET) * (1, -1) if ground is None else ground.xyz[:, :2]
    offset = np.nan_to_num(content.offset)
    # QGIS takes dY = -(y of its transform - y of the point) in what it holds for pixels: rows that count upwards from
    # the top edge, but downwards of an image that has a geotransform of its own.
    down = -1 if where is not None and where.transform is not None else 1
    lines = [HEADER]
    if ground is not None and ground.crs:
        lines.insert(0, f"#CRS: {_wkt(ground.crs)}")
    for (mx, my), (sx, sy), (dx, dy) in zip(place.tolist(), source.tolist(), offset.tolist(), strict=True):
        lines.append(f"{mx!r},{my!r},{sx!r},{sy!r},1,{dx:.6g},{down * dy:.6g},{np.hypot(dx, dy):.6g}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def read(path: Path, reference: str | Path | None, secondary: str | Path | None) -> Matches:
    """Read the enabled points; those in map coordinates need the image whose geotransform takes them to pixels."""
    lines = lines_of(path)
    crs = next((line[5:].strip() for line in lines if line.upper().startswith("#CRS:")), "")
    rows = list(csv.reader(line for line in lines if not line.startswith("#")))
    if not rows:
        raise InputError("is empty; a header mapX,mapY,sourceX,sourceY,enable is needed")
    names = next((names for names in COLUMNS if all(n in rows[0] for n in names)), None)
    if names is None:
        raise InputError(f"the header must name {', '.join(COLUMNS[0])}, got {', '.join(rows[0])}")
    on = rows[0].index("enable") if "enable" in rows[0] else None
    kept = [row for row in rows[1:] if on is None or row[on].strip() not in ("0", "false")]
    values = numbers([[row[rows[0].index(n)] for n in names] for row in kept]).reshape(-1, 4)
    to = _side(values[:, :2], "mapX, mapY", "reference", reference, crs, on_map=bool(crs))
    source = _side(values[:, 2:], "sourceX, sourceY", "secondary", secondary, crs, on_map=False)
    return matches_of_array(np.hstack([to, source]))


def _side(at: FloatArray, names: str, role: str, image: str | Path | None, crs: str, *, on_map: bool) -> FloatArray:
    """Pixels of an image from the georeferencer's coordinates; `on_map` where these are surely no pixels."""
    # The georeferencer counts rows upwards from the top edge, so they are negative.
    pixels = at * (1, -1) - PIXEL_OFFSET
    if image is None:
        if on_map:
            raise InputError(f"{names} are map coordinates (it has a CRS line); give the {role} image")
        if (pixels < -1).any():
            raise InputError(f"{names} are no pixels (some lie left of or above the image); give the {role} image")
        return pixels
    from featreg.io.raster_source import located_source

    source = located_source(image)
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

    def inside(xy: FloatArray) -> int:
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


def _wkt(crs: str) -> str:
    from rasterio.crs import CRS

    return str(CRS.from_user_input(crs).to_wkt()).replace("\n", " ")
