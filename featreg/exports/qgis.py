"""QGIS georeferencer points (``.points``): the source image is the secondary, the map is that of the reference.

Source coordinates have the first pixel's centre at (0.5, -0.5): rows count upwards from the top edge. Of a secondary
with a geotransform they are its map coordinates, as QGIS (3.26) has it. Where nothing says where the reference lies the
map is the reference's own pixels in the same convention, and no CRS is named.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from featreg.exports.content import Content, ground_of, on_map
from featreg.exports.reading import PIXEL_OFFSETS

HEADER = "mapX,mapY,sourceX,sourceY,enable,dX,dY,residual"


def write(content: Content, path: Path) -> None:
    """Write all points enabled, with their residuals in pixels."""
    half = PIXEL_OFFSETS["qgis"]
    where = content.secondary.geolocation
    if where is not None and where.transform is not None:
        source = on_map(where.transform, content.matches.secondary_xy)
    else:
        source = (content.matches.secondary_xy + half) * (1, -1)
    ground = ground_of(content.reference, content.matches.reference_xy, content.model)
    place = (content.matches.reference_xy + half) * (1, -1) if ground is None else ground.xyz[:, :2]
    offset = np.nan_to_num(content.offset)
    lines = [HEADER]
    if ground is not None and ground.crs:
        lines.insert(0, f"#CRS: {_wkt(ground.crs)}")
    for (mx, my), (sx, sy), (dx, dy) in zip(place.tolist(), source.tolist(), offset.tolist(), strict=True):
        lines.append(f"{mx!r},{my!r},{sx!r},{sy!r},1,{dx:.6g},{-dy:.6g},{np.hypot(dx, dy):.6g}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _wkt(crs: str) -> str:
    from rasterio.crs import CRS

    return str(CRS.from_user_input(crs).to_wkt()).replace("\n", " ")
