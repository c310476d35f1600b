"""GeoPackage: the layers `tie_points`, `arrows`, `ellipses` and `footprints` in the reference's coordinate system."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from featreg.exports.content import Content
from featreg.exports.frames import arrow_columns, frame, import_geopandas, shapes, tie_point_columns
from featreg.exports.layers import layers_of


def write(content: Content, path: Path) -> None:
    """Write the layers; one without anything in it is there all the same.

    Raises
    ------
    InputError
        geopandas is not installed.
    """
    geopandas = import_geopandas(".gpkg")
    layers = layers_of(content)
    facts = [facts for facts, _ in layers.outlines]
    outlines = {name: np.array([one[name] for one in facts], object) for name in (facts[0] if facts else ())}
    rings = [ring for _, ring in layers.outlines]
    found: dict[str, tuple[dict[str, Any], str, Any]] = {
        "tie_points": (tie_point_columns(layers), "Point", layers.points),
        "arrows": (arrow_columns(layers), "LineString", layers.arrows),
        "ellipses": (arrow_columns(layers), "Polygon", layers.ellipses),
        "footprints": (outlines, "Polygon", rings),
    }
    for name, (columns, kind, values) in found.items():
        made = shapes(kind, values)
        there = np.flatnonzero([shape is not None for shape in made])
        rows = {column: value[there] for column, value in columns.items()}
        table = frame(geopandas, layers, rows, made[there])
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "'crs' was not provided")  # that of pixels is none
            # Each further layer goes into the file that the first one made.
            table.to_file(path, layer=name, driver="GPKG", engine="pyogrio", geometry_type=kind, index=False)
