"""How large the pixels of an image are, as its geolocation says it."""

from __future__ import annotations

import math

import numpy as np

from featreg.errors import InputError
from featreg.geolocation.projection import Projection
from featreg.geolocation.rpc import RpcSensor
from featreg.geolocation.sensor import metres, wrapped
from featreg.geolocation.sensors import sensor_from_dict
from featreg.types import FloatArray, Geolocation, PixelSize


def pixel_size(geolocation: Geolocation) -> PixelSize | None:
    """Return the size of an image's pixels; None where nothing tells it.

    The first of these that there is, as for `sensor_of`: of the sensor that a product states, that at its centre, and
    of an RPC, that at its offsets, in metres; of a geotransform with a coordinate system its own, in metres or degrees;
    of ground control points, the mean over them, in metres.
    """
    try:
        if geolocation.sensor is not None:
            sensor = sensor_from_dict(geolocation.sensor)
            return _checked(PixelSize(*sensor.pixel_size(sensor.level or 0.0), "metre"))
        if geolocation.rpcs is not None:
            return _on_ground(*_of_rpc(RpcSensor(geolocation.rpcs)))
        if geolocation.transform is not None and geolocation.crs:
            return _of_transform(geolocation.transform, geolocation.crs)
        if geolocation.gcps is not None and geolocation.crs and len(geolocation.gcps) > 2:
            return _on_ground(*_of_gcps(geolocation.gcps, geolocation.crs))
    except (InputError, np.linalg.LinAlgError):
        pass  # whoever needs the geolocation says what is wrong with it
    return None


def _of_transform(transform: tuple[float, ...], crs: str) -> PixelSize | None:
    from rasterio.crs import CRS
    from rasterio.errors import CRSError

    a, b, _, d, e, _ = transform
    try:
        known = CRS.from_user_input(crs)
        unit, factor = ("degree", 1.0) if known.is_geographic else ("metre", known.linear_units_factor[1])
    except CRSError:
        return None
    return _checked(PixelSize(math.hypot(a, d) * factor, math.hypot(b, e) * factor, unit))


def _of_rpc(sensor: RpcSensor) -> tuple[FloatArray, float]:
    """(2, 2) degrees of longitude and latitude (rows) a pixel along x and y, and the latitude."""
    r = sensor.rpcs
    slopes = np.empty((2, 2))
    for row, name in enumerate(("samp", "line")):
        top, bottom = r[f"{name}_num_coeff"], r[f"{name}_den_coeff"]
        for column, ground in enumerate(("long", "lat")):
            # The terms of first degree alone have a slope where all normalised coordinates are 0.
            slope = (top[column + 1] * bottom[0] - top[0] * bottom[column + 1]) / (bottom[0] ** 2 or math.nan)
            slopes[row, column] = slope * r[f"{name}_scale"] / r[f"{ground}_scale"]
    return np.asarray(np.linalg.inv(slopes), np.float64), float(r["lat_off"])


def _of_gcps(gcps: FloatArray, crs: str) -> tuple[FloatArray, float]:
    """As `_of_rpc`, by least squares."""
    points = np.asarray(gcps, np.float64)
    lonlat = Projection(crs).to_lonlat(points[:, 2:4])
    away = np.column_stack([wrapped(lonlat[:, 0] - lonlat[0, 0]), lonlat[:, 1] - lonlat[0, 1]])
    design = np.column_stack([np.ones(len(points)), points[:, :2] - points[:, :2].mean(axis=0)])
    solution, _, rank, _ = np.linalg.lstsq(design, away)
    slopes = np.asarray(solution[1:].T, np.float64) if rank == 3 else np.full((2, 2), np.nan)
    return slopes, float(lonlat[:, 1].mean())


def _on_ground(degrees: FloatArray, latitude: float) -> PixelSize | None:
    x, y = np.hypot(*metres(degrees.T, latitude).T).tolist()
    return _checked(PixelSize(x, y, "metre"))


def _checked(size: PixelSize) -> PixelSize | None:
    return size if 0 < size.x < math.inf and 0 < size.y < math.inf else None
