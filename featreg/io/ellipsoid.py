"""The WGS84 ellipsoid: longitude, latitude and height to Earth-fixed coordinates, and back."""

from __future__ import annotations

import numpy as np

from featreg.types import FloatArray

#: Semi-major axis in metres, flattening, first eccentricity squared.
AXIS, FLATTENING = 6378137.0, 1 / 298.257223563
ECCENTRICITY2 = FLATTENING * (2 - FLATTENING)


def earth_fixed(lonlat: FloatArray, heights: FloatArray) -> FloatArray:
    """(N, 3) metres of (N, 2) longitude and latitude in degrees and (N,) heights above the ellipsoid."""
    lon, lat = np.radians(np.asarray(lonlat, np.float64)).T
    normal = AXIS / np.sqrt(1.0 - ECCENTRICITY2 * np.sin(lat) ** 2)
    flat = (normal + heights) * np.cos(lat)
    upright = (normal * (1.0 - ECCENTRICITY2) + heights) * np.sin(lat)
    return np.column_stack([flat * np.cos(lon), flat * np.sin(lon), upright])


def geodetic(points: FloatArray) -> FloatArray:
    """(N, 3) longitude and latitude in degrees and height in metres of (N, 3) Earth-fixed points."""
    x, y, z = np.asarray(points, np.float64).T
    distance = np.hypot(x, y)
    latitude = np.arctan2(z, distance * (1 - ECCENTRICITY2))
    for _ in range(6):
        normal = AXIS / np.sqrt(1 - ECCENTRICITY2 * np.sin(latitude) ** 2)
        latitude = np.arctan2(z + ECCENTRICITY2 * normal * np.sin(latitude), distance)
    normal = AXIS / np.sqrt(1 - ECCENTRICITY2 * np.sin(latitude) ** 2)
    height = distance * np.cos(latitude) + z * np.sin(latitude) - AXIS**2 / normal
    return np.column_stack([np.degrees(np.arctan2(y, x)), np.degrees(latitude), height])
