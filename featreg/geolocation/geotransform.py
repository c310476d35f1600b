"""Images on an affine grid of a map projection."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from featreg.errors import InputError
from featreg.geolocation.projection import Projection
from featreg.geolocation.sensor import Sensor
from featreg.types import FloatArray

#: What is left by terrain correction and orbit, px, where a file does not say.
UNKNOWN_PX = 5.0


@dataclass(frozen=True, eq=False)
class GeotransformSensor(Sensor):
    """A terrain-corrected or geocoded image: heights do not move its pixels.

    Parameters
    ----------
    transform : GDAL's affine (a, b, c, d, e, f) from pixel corners to `crs`
    crs : coordinate system, WKT or authority code
    shape : (H, W) of the image

    Raises
    ------
    InputError
        The transform cannot be inverted, or the coordinate system is unknown.
    """

    transform: tuple[float, float, float, float, float, float]
    crs: str
    shape: tuple[int, int]

    def __post_init__(self) -> None:
        values = np.array(self.transform, np.float64)
        if values.shape != (6,) or not np.isfinite(values).all() or values[0] * values[4] == values[1] * values[3]:
            raise InputError(f"a geotransform must be six numbers of an invertible map, got {self.transform}")
        object.__setattr__(self, "transform", tuple(values.tolist()))
        object.__setattr__(self, "shape", tuple(int(n) for n in self.shape))
        object.__setattr__(self, "_projection", Projection(self.crs))

    def image_to_ground(self, xy: FloatArray, heights: ArrayLike) -> FloatArray:
        a, b, c, d, e, f = self.transform
        x, y = (np.asarray(xy, np.float64) + 0.5).T
        return self._map.to_lonlat(np.column_stack([a * x + b * y + c, d * x + e * y + f]))

    def ground_to_image(self, lonlat: FloatArray, heights: ArrayLike) -> FloatArray:
        a, b, c, d, e, f = self.transform
        xy = self._map.from_lonlat(np.asarray(lonlat, np.float64))
        x, y = self.centre
        east, north = self._map.near(xy, a * (x + 0.5) + b * (y + 0.5) + c).T
        u, v, det = east - c, north - f, a * e - b * d
        return np.column_stack([(e * u - b * v) / det, (a * v - d * u) / det]) - 0.5

    @property
    def uncertainty_px(self) -> float:
        return UNKNOWN_PX

    @property
    def centre(self) -> tuple[float, float]:
        return (self.shape[1] - 1) / 2, (self.shape[0] - 1) / 2

    def to_dict(self) -> dict[str, Any]:
        return {"type": "geotransform", "transform": list(self.transform), "crs": self.crs, "shape": list(self.shape)}

    @property
    def _map(self) -> Projection:
        projection: Projection = self.__dict__["_projection"]
        return projection


def on_map(transform: tuple[float, ...], xy: FloatArray) -> FloatArray:
    """Return the map coordinates (M, 2) of points of an image with this geotransform (GDAL's, from pixel corners)."""
    a, b, c, d, e, f = transform
    x, y = (xy + 0.5).T
    return np.column_stack([a * x + b * y + c, d * x + e * y + f])
