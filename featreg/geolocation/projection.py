"""Map coordinates of a coordinate system to longitude and latitude on WGS84, and back."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from featreg.errors import InputError
from featreg.types import FloatArray

WGS84 = "EPSG:4326"
FULL_TURN = 360.0


@dataclass(frozen=True)
class Projection:
    """A coordinate system, by its WKT or authority code; plain longitude and latitude cost nothing.

    Raises
    ------
    InputError
        The coordinate system is unknown, or no way leads from it to longitude and latitude, as from a local one of a
        site or an image.
    """

    crs: str

    def __post_init__(self) -> None:
        from rasterio import Env
        from rasterio.crs import CRS
        from rasterio.errors import CRSError

        # In an environment of rasterio's GDAL writes no lines of its own on stderr.
        with Env():
            try:
                known = CRS.from_user_input(self.crs)
                geographic = bool(known.is_geographic)
                same = geographic and (known == CRS.from_epsg(4326) or known.to_epsg() == 4326)
            except CRSError as error:
                check_proj()
                raise InputError(f"unknown coordinate system {self.crs!r:.80}") from error
        if not same and (why := _unreachable(self.crs)):
            check_proj()
            raise InputError(f"coordinate system {self.crs!r:.80} does not lead to longitude and latitude ({why:.120})")
        object.__setattr__(self, "_plain", same)
        object.__setattr__(self, "_turn", 2 * math.pi / known.units_factor[1] if geographic else 0.0)

    @property
    def is_plain(self) -> bool:
        """Whether map coordinates are longitude and latitude on WGS84 themselves."""
        return bool(self.__dict__["_plain"])

    def to_lonlat(self, xy: FloatArray) -> FloatArray:
        """Return (N, 2) longitude and latitude in degrees of (N, 2) map coordinates; NaN where there are none.

        Longitudes lie between -180 and 180 degrees, whatever turn the map coordinates count on.
        """
        lonlat = np.array(xy, np.float64) if self.is_plain else _through(self.crs, WGS84, xy)
        lonlat[:, 0] = near(lonlat[:, 0], 0.0, FULL_TURN)
        return lonlat

    @property
    def turn(self) -> float:
        """A whole turn of longitude in map coordinates; 0 where these are no longitudes."""
        return float(self.__dict__["_turn"])

    def near(self, xy: FloatArray, middle: float) -> FloatArray:
        """Map coordinates with longitudes on the turn that lies nearest to a middle; of a projection as they are."""
        return np.column_stack([near(xy[:, 0], middle, self.turn), xy[:, 1]]) if self.turn else xy

    def from_lonlat(self, lonlat: FloatArray) -> FloatArray:
        """Return (N, 2) map coordinates of (N, 2) longitude and latitude in degrees; NaN where there are none."""
        return np.array(lonlat, np.float64) if self.is_plain else _through(WGS84, self.crs, lonlat)


@lru_cache(maxsize=256)
def _unreachable(crs: str) -> str:
    """Why points of a coordinate system have no longitude and latitude; "" where they have."""
    from rasterio import Env

    try:
        with Env():
            _through(crs, WGS84, np.zeros((1, 2)))
    except Exception as error:  # GDAL's errors come in classes that rasterio does not publish
        return " ".join(str(error).split()) or type(error).__name__
    return ""


def near(longitudes: FloatArray, middle: float, turn: float) -> FloatArray:
    """Longitudes moved by whole turns to within half a turn of a middle; those that lie there stay as they are."""
    return np.asarray(longitudes - turn * np.round((longitudes - middle) / turn))


def check_proj() -> None:
    """Raise an `InputError` where PROJ finds no coordinate system: its data are missing or of another version."""
    from rasterio import Env
    from rasterio.crs import CRS
    from rasterio.errors import CRSError

    try:
        with Env():
            CRS.from_epsg(4326)
    except CRSError as error:
        raise InputError(
            f"PROJ cannot use its data ({' '.join(str(error).split())}); unset PROJ_DATA and PROJ_LIB, or point them "
            "at the data of the installed version"
        ) from error


def _through(source: str, target: str, xy: FloatArray) -> FloatArray:
    from rasterio.warp import transform

    out = np.full((len(xy), 2), np.nan)
    good = np.isfinite(xy).all(axis=1)
    if good.any():
        found = transform(source, target, xy[good, 0].tolist(), xy[good, 1].tolist())
        out[good] = np.column_stack(found[:2])
    out[~np.isfinite(out).all(axis=1)] = np.nan
    return out
