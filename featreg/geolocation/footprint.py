"""The outline of an image, in its pixels and on the ground, and shapes cut at the date line."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.geolocation.heights import ConstantHeight, Heights
from featreg.geolocation.projection import FULL_TURN, near
from featreg.geolocation.sensors import ground_level, sensor_of
from featreg.geolocation.transfer import on_ground
from featreg.types import FloatArray, Geolocation

#: Corners of an outline along each side, so that it follows what bends between the corners of the image.
PER_SIDE = 16
#: Longitudes and latitudes are written to so many digits: 0.01 mm.
DIGITS = 10


def outline(shape: tuple[int, int], per_side: int = PER_SIDE) -> FloatArray:
    """Return the closed ring (4 per_side + 1, 2) around an image of (H, W), its first and last corner (-0.5, -0.5)."""
    height, width = shape
    t = np.arange(per_side) / per_side
    one, none = np.ones(per_side), np.zeros(per_side)
    x = np.concatenate([none, t, one, 1 - t, [0.0]])
    y = np.concatenate([t, one, 1 - t, none, [0.0]])
    return np.column_stack([x * width, y * height]) - 0.5


def footprint(
    geolocation: Geolocation | None, shape: tuple[int, int], name: str, heights: Heights | None = None
) -> FloatArray:
    """Return the outline of an image on the ground.

    Parameters
    ----------
    geolocation : where the image lies
    shape : (H, W)
    name : of the image, for the errors
    heights : of the ground; default: the height offset of an RPC, else 0

    Returns
    -------
    (K, 2) longitude and latitude in degrees on WGS84, a closed ring; longitudes go on beyond 180 degrees where it
    crosses the date line

    Raises
    ------
    InputError
        Nothing says where the image lies, or its rim does not lie on the ground.
    """
    sensor = sensor_of(geolocation, shape, name)
    ring, _ = on_ground(sensor, outline(shape), heights or ConstantHeight(ground_level(sensor)[0]))
    if not np.isfinite(ring).all():
        raise InputError(f"{name}: its rim does not lie on the ground, so it has no outline there")
    return unwrapped(ring)


def unwrapped(lonlat: FloatArray) -> FloatArray:
    """Return (K, 2) longitude and latitude with the longitudes on the turn of the first one."""
    return np.column_stack([near(lonlat[:, 0], float(lonlat[0, 0]), FULL_TURN), lonlat[:, 1]])


def geojson(lonlat: FloatArray, kind: str) -> dict[str, Any]:
    """Return a shape as a geometry of GeoJSON (RFC 7946): anticlockwise rings, cut where it crosses the date line.

    Parameters
    ----------
    lonlat : (2,) of a point, (K, 2) of a line or of a closed ring, degrees on WGS84
    kind : "Point", "LineString" or "Polygon"; what is cut becomes a Multi-one
    """
    if kind == "Point":
        return {"type": kind, "coordinates": _plain(lonlat)}
    shape = unwrapped(lonlat)
    if kind == "Polygon" and _area(shape) < 0:
        shape = shape[::-1]
    parts = []
    for turn in (-FULL_TURN, 0.0, FULL_TURN):
        part = _clipped(_clipped(shape, turn - FULL_TURN / 2, 1), turn + FULL_TURN / 2, -1)
        if len(part) > 1 and (kind == "LineString" or abs(_area(part)) > 0):
            if kind == "Polygon" and not np.array_equal(part[0], part[-1]):
                part = np.vstack([part, part[:1]])
            parts.append(_plain(part - (turn, 0.0)))
    rings = [[part] for part in parts] if kind == "Polygon" else parts
    if len(parts) == 1:
        return {"type": kind, "coordinates": rings[0]}
    return {"type": f"Multi{kind}", "coordinates": rings}


def _clipped(shape: FloatArray, meridian: float, side: int) -> FloatArray:
    """The part of a line or ring east (side 1) or west (-1) of a meridian, after Sutherland and Hodgman."""
    inside = side * (shape[:, 0] - meridian) >= 0
    if inside.all():
        return shape
    kept: list[Any] = []
    for k, here in enumerate(shape):
        if k and inside[k] != inside[k - 1]:
            before = shape[k - 1]
            share = (meridian - before[0]) / (here[0] - before[0])
            kept.append((meridian, before[1] + share * (here[1] - before[1])))
        if inside[k]:
            kept.append(tuple(here))
    return np.array(kept, np.float64).reshape(-1, 2)


def _area(ring: FloatArray) -> float:
    """Twice the area of a closed ring, positive where it runs anticlockwise."""
    x, y = (ring - ring[0]).T
    return float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))


def _plain(values: NDArray[Any]) -> Any:
    return np.round(values, DIGITS).tolist()
