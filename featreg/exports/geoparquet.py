"""GeoParquet: one row per tie point with the geometries `geometry` (a point), `arrow` and `ellipse`."""

from __future__ import annotations

from pathlib import Path

from featreg.exports.content import Content
from featreg.exports.frames import arrow_columns, frame, import_geopandas, shapes, tie_point_columns
from featreg.exports.layers import layers_of


def write(content: Content, path: Path) -> None:
    """Write one row per tie point in the reference's coordinate system; an unknown arrow or ellipse is null.

    Raises
    ------
    InputError
        geopandas is not installed.
    """
    geopandas = import_geopandas(".parquet")
    layers = layers_of(content)
    columns = {**arrow_columns(layers), **tie_point_columns(layers)}
    table = frame(geopandas, layers, columns, shapes("Point", layers.points))
    for name, kind, values in (("arrow", "LineString", layers.arrows), ("ellipse", "Polygon", layers.ellipses)):
        table[name] = geopandas.GeoSeries(shapes(kind, values), crs=layers.crs or None)
    table.to_parquet(path, index=False, compression="zstd")
