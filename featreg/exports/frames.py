"""The layers as data frames of geopandas, which the extra `vectors` installs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from featreg.errors import InputError
from featreg.exports.layers import Layers
from featreg.types import FloatArray

CURE = "pip install 'featreg[vectors]'"


def import_geopandas(suffix: str) -> Any:
    """Return the module `geopandas`.

    Raises
    ------
    InputError
        It, or what it writes with, cannot be imported.
    """
    try:
        import geopandas
        import pyogrio  # noqa: F401  # what writes a GeoPackage
    except (ImportError, OSError) as error:
        raise InputError(f"{suffix} needs geopandas and pyogrio ({error}); {CURE}") from error
    return geopandas


def shapes(kind: str, values: FloatArray | list[FloatArray]) -> Any:
    """Return N points, lines or polygons of shapely; None where a corner is not known."""
    import shapely

    make: Any = {"Point": shapely.points, "LineString": shapely.linestrings, "Polygon": shapely.polygons}[kind]
    made = np.full(len(values), None, object)
    for k, value in enumerate(values):
        if np.isfinite(value).all():
            made[k] = make(value)
    return made


def frame(geopandas: Any, layers: Layers, columns: Mapping[str, Any], geometry: Any) -> Any:
    """Return a data frame of one layer in the layers' coordinate system."""
    return geopandas.GeoDataFrame(dict(columns), geometry=geopandas.GeoSeries(geometry, crs=layers.crs or None))


def tie_point_columns(layers: Layers) -> dict[str, Any]:
    """The attributes of the tie points, with the row of the table under `row`."""
    return {"row": np.arange(len(layers.points)), **layers.columns}


def arrow_columns(layers: Layers) -> dict[str, Any]:
    """The attributes of arrows and ellipses: which tie point, what placed them, and how good it is."""
    count = len(layers.points)
    kept = {name: layers.columns[name] for name in ("residual", "inlier")}
    return {"row": np.arange(count), "placed_by": np.full(count, layers.arrows_by, object), **kept}
