"""GeoJSON (RFC 7946): tie points, arrows, error ellipses and outlines in one file, longitude and latitude on WGS84.

Every feature says in `layer` what it is: "tie_points", "arrows", "ellipses" or "footprints". What crosses the date line
is cut there.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from featreg.errors import InputError
from featreg.exports.content import Content
from featreg.exports.layers import layers_of
from featreg.geolocation.footprint import geojson
from featreg.geolocation.projection import WGS84, Projection
from featreg.results.json_file import plain
from featreg.types import FloatArray


def write(content: Content, path: Path) -> None:
    """Write one FeatureCollection; numbers that are not known are null.

    Raises
    ------
    InputError
        Nothing says where the reference lies: GeoJSON knows longitude and latitude only.
    """
    layers = layers_of(content)
    if not layers.crs and len(layers.points):
        raise InputError(
            f"{path.name}: GeoJSON holds longitude and latitude, and nothing says where the reference "
            f"'{content.reference.path}' lies; give a georeferenced reference, or write a .gpkg in its pixels"
        )
    outlines = layers.outlines if layers.crs else []
    to_lonlat = Projection(layers.crs or WGS84).to_lonlat
    names = list(layers.columns)
    rows = zip(*(plain(values) for values in layers.columns.values()), strict=True)
    attributes = [dict(zip(names, row, strict=True)) for row in rows]

    def features() -> Iterator[dict[str, Any]]:
        rings = [ring for _, ring in outlines]
        yield from _features("footprints", "Polygon", rings, to_lonlat, [facts for facts, _ in outlines])
        yield from _features("tie_points", "Point", layers.points[:, None], to_lonlat, attributes)
        placed = [{"row": k, "placed_by": layers.arrows_by, "residual": a["residual"], "inlier": a["inlier"]}
                  for k, a in enumerate(attributes)]  # fmt: skip
        yield from _features("arrows", "LineString", layers.arrows, to_lonlat, placed)
        yield from _features("ellipses", "Polygon", layers.ellipses, to_lonlat, placed)

    lines = ",\n".join(json.dumps(feature, ensure_ascii=False, allow_nan=False) for feature in features())
    head = json.dumps({"type": "FeatureCollection", "features": []})[:-2]
    path.write_text(f"{head}\n{lines}\n]}}\n", encoding="utf-8", errors="backslashreplace")


def _features(layer: str, kind: str, shapes: Any, to_lonlat: Any, attributes: list[dict[str, Any]]) -> Iterator[Any]:
    if not len(shapes):
        return
    ends = np.cumsum([len(shape) for shape in shapes])[:-1]
    lonlat: list[FloatArray] = np.split(to_lonlat(np.concatenate([np.asarray(shape) for shape in shapes])), ends)
    for shape, facts in zip(lonlat, attributes, strict=True):
        if np.isfinite(shape).all():
            geometry = geojson(shape[0] if kind == "Point" else shape, kind)
            yield {"type": "Feature", "geometry": geometry, "properties": {"layer": layer, **facts}}
