"""GDAL ground control points of the secondary: a VRT, a GeoTIFF, or a text file of ``-gcp`` options.

Pixel and line have the first pixel's centre at (0.5, 0.5). Ground coordinates are the reference's; where nothing says
where it lies they are its pixels, X = pixel and Y = -line, so that ``gdalwarp -te 0 -H W 0 -tr 1 1`` gives its grid.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from featreg.errors import InputError
from featreg.exports.content import Content, ground_of
from featreg.io.gdal_errors import quiet
from featreg.types import FloatArray

PIXEL_OFFSET = 0.5
#: What else of a VRT says where it lies: GDAL looks at a geotransform before control points.
PLACING = ("SRS", "GeoTransform", "GCPList")
PLACING_DOMAINS = ("RPC", "GEOLOCATION")
#: Farthest that a control point that was read back may lie from where it was written, px.
READ_BACK_PX = 1e-3


def write(content: Content, path: Path) -> None:
    """Write by suffix: ``.vrt`` refers to the secondary's file, ``.tif`` copies it, ``.txt`` is for ``--optfile``.

    The control points are all that says where the image lies: the secondary's own georeferencing is left out.

    Raises
    ------
    InputError
        The secondary's file is not at hand (``.vrt`` and ``.tif`` need it), or GDAL does not read them back.
    """
    pixel, line = (content.matches.secondary_xy + PIXEL_OFFSET).T
    ground = ground_of(content.reference, content.matches.reference_xy, content.model)
    xyz: FloatArray
    if ground is None:
        flat = (content.matches.reference_xy + PIXEL_OFFSET) * (1, -1)
        xyz, crs = np.column_stack([flat, np.zeros(len(flat))]), ""
    else:
        xyz, crs = ground.xyz, ground.crs
    rows = np.column_stack([pixel, line, xyz])
    if path.suffix.lower() == ".txt":
        path.write_text("".join("-gcp " + " ".join(map(repr, row)) + "\n" for row in rows.tolist()), encoding="utf-8")
    else:
        _write_raster(content, path, rows, crs)


def _write_raster(content: Content, path: Path, rows: FloatArray, crs: str) -> None:
    import rasterio
    from rasterio.control import GroundControlPoint
    from rasterio.crs import CRS
    from rasterio.shutil import copy

    source = Path(content.secondary.path)
    if not source.is_file():
        raise InputError(f"GCPs in a {path.suffix} need the secondary's file, '{source}' is not there; give it")
    if not str(source.resolve()).isprintable():
        raise InputError(
            f"{str(source)!a}: its name holds what GDAL's VRT cannot (control characters, no UTF-8); rename it, or "
            "write a .txt"
        )
    points: list[Any] = [
        GroundControlPoint(row=line, col=pixel, x=x, y=y, z=z, id=str(k))
        for k, (pixel, line, x, y, z) in enumerate(rows.tolist(), 1)
    ]
    vrt = path if path.suffix.lower() == ".vrt" else path.with_name("gcps.vrt")
    with quiet():
        # GDAL writes the reference to the source into the VRT; only the control points are ours.
        copy(str(source.resolve()), str(vrt), driver="VRT")
        _without_place(vrt)
        with rasterio.open(vrt, "r+") as dataset:
            dataset.gcps = (points, CRS.from_user_input(crs) if crs else CRS())
        if vrt != path:
            copy(str(vrt), str(path), driver="GTiff", tiled="YES", compress="DEFLATE", bigtiff="IF_SAFER")
            vrt.unlink()
        _read_back(path, rows)


def _without_place(vrt: Path) -> None:
    try:
        tree = ElementTree.parse(vrt)
    except ElementTree.ParseError as error:
        raise OSError(f"GDAL's VRT of the secondary cannot be read back: {error}") from error
    root = tree.getroot()
    for element in list(root):
        if element.tag in PLACING or element.get("domain") in PLACING_DOMAINS:
            root.remove(element)
    tree.write(vrt, encoding="utf-8")


def _read_back(path: Path, rows: FloatArray) -> None:
    """Raise where GDAL does not see these control points, and them alone."""
    import rasterio

    # Whatever GDAL keeps beside the file does not come along with it.
    path.with_name(f"{path.name}.aux.xml").unlink(missing_ok=True)
    with rasterio.open(path.absolute()) as dataset:
        found, _ = dataset.gcps
        alone = dataset.transform.is_identity and not dataset.rpcs
    if len(found) != len(rows):
        raise InputError(
            f"{path.name}: GDAL reads {len(found)} of {len(rows)} control points back (a GeoTIFF holds 10922); write a "
            ".vrt or .txt, or fewer tie points"
        )
    at = np.array([(g.col, g.row) for g in found]).reshape(-1, 2)
    if not alone or (len(rows) and np.abs(at - rows[:, :2]).max() > READ_BACK_PX):
        raise InputError(f"{path.name}: GDAL does not read the control points back as they were written; write a .txt")
