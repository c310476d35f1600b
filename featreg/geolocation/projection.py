"""Map coordinates of a coordinate system to longitude and latitude on WGS84, and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from featreg.errors import InputError
from featreg.types import FloatArray

WGS84 = "EPSG:4326"


@dataclass(frozen=True)
class Projection:
    """A coordinate system, by its WKT or authority code; plain longitude and latitude cost nothing.

    Raises
    ------
    InputError
        The coordinate system is unknown.
    """

    crs: str

    def __post_init__(self) -> None:
        from rasterio.crs import CRS
        from rasterio.errors import CRSError

        try:
            known = CRS.from_user_input(self.crs)
        except CRSError as error:
            raise InputError(f"unknown coordinate system {self.crs!r:.80}") from error
        geographic = bool(known.is_geographic)
        same = geographic and (known == CRS.from_epsg(4326) or known.to_epsg() == 4326)
        object.__setattr__(self, "_plain", same)

    @property
    def is_plain(self) -> bool:
        """Whether map coordinates are longitude and latitude on WGS84 themselves."""
        return bool(self.__dict__["_plain"])

    def to_lonlat(self, xy: FloatArray) -> FloatArray:
        """Return (N, 2) longitude and latitude in degrees of (N, 2) map coordinates; NaN where there are none."""
        return np.array(xy, np.float64) if self.is_plain else _through(self.crs, WGS84, xy)

    def from_lonlat(self, lonlat: FloatArray) -> FloatArray:
        """Return (N, 2) map coordinates of (N, 2) longitude and latitude in degrees; NaN where there are none."""
        return np.array(lonlat, np.float64) if self.is_plain else _through(WGS84, self.crs, lonlat)


def _through(source: str, target: str, xy: FloatArray) -> FloatArray:
    from rasterio.warp import transform

    out = np.full((len(xy), 2), np.nan)
    good = np.isfinite(xy).all(axis=1)
    if good.any():
        found = transform(source, target, xy[good, 0].tolist(), xy[good, 1].tolist())
        out[good] = np.column_stack(found[:2])
    out[~np.isfinite(out).all(axis=1)] = np.nan
    return out
