"""The sensor of an image: what its product states, else its RPC, its geotransform, its ground control points."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from featreg.errors import InputError
from featreg.geolocation.corrected import CorrectedSensor
from featreg.geolocation.gcps import GcpSensor
from featreg.geolocation.geotransform import GeotransformSensor
from featreg.geolocation.range_doppler import RangeDopplerSensor
from featreg.geolocation.rpc import RpcSensor
from featreg.geolocation.sensor import Sensor
from featreg.geolocation.sicd import SicdSensor
from featreg.geolocation.sidd import SiddSensor
from featreg.types import Geolocation

#: Whence the height of the ground comes where nobody states it.
STATED: Mapping[type[Sensor], str] = {
    RpcSensor: "height offset of the RPC",
    GcpSensor: "mean height of the ground control points",
    SicdSensor: "scene centre point of the SICD",
    SiddSensor: "surface of the SIDD",
}


def sensor_of(geolocation: Geolocation | None, shape: tuple[int, int], name: str) -> Sensor:
    """Return the sensor model of an image.

    Parameters
    ----------
    geolocation : what the file says of where the image lies, or None
    shape : (H, W)
    name : of the file, for the errors

    Raises
    ------
    InputError
        There is none, or it is broken; the text names the file.
    """
    found = geolocation or Geolocation()
    try:
        if found.sensor is not None:
            return sensor_from_dict(found.sensor)
        if found.rpcs is not None:
            return RpcSensor(found.rpcs)
        if found.transform is not None and found.crs:
            return GeotransformSensor(found.transform, found.crs, shape)
        if found.gcps is not None and found.crs:
            return GcpSensor(found.gcps, found.crs)
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
    half = ""
    if found.transform is not None or found.gcps is not None:
        what = "geotransform has" if found.transform is not None else "ground control points have"
        half = f" (its {what} no coordinate system)"
    raise InputError(
        f"{name}: nothing says where the image lies{half}; RPC coefficients, a geotransform or ground control points "
        "with a coordinate system are needed"
    )


def ground_level(*sensors: Sensor) -> tuple[float, str]:
    """Return metres above the ellipsoid to take for the ground where nobody states it, and where they come from.

    That which the first sensor states that states any: the offset of rational polynomials, which hold around their own
    height only, the median of a geolocation grid, the scene centre point, the mean of control points; else 0.
    """
    for sensor in sensors:
        if sensor.level is not None:
            return sensor.level, STATED.get(type(sensor), "the metadata of the product")
    return 0.0, "none stated: the ellipsoid"


def sensor_from_dict(values: Mapping[str, Any]) -> Sensor:
    """Return the sensor that `Sensor.to_dict` wrote.

    Raises
    ------
    InputError
        The type is unknown or the values do not make such a sensor.
    """
    given = dict(values)
    kind = given.pop("type", None)
    try:
        if kind == "rpc":
            return RpcSensor(given)
        if kind == "geotransform":
            return GeotransformSensor(**given)
        if kind == "gcps":
            return GcpSensor(**given)
        if kind == "corrected":
            return CorrectedSensor(sensor_from_dict(given["sensor"]), given["bias"])
        if kind == "sicd":
            return SicdSensor(**given)
        if kind == "sidd":
            return SiddSensor(**given)
        if kind == "range-doppler":
            return RangeDopplerSensor(**given)
    except InputError:
        raise
    except (TypeError, LookupError, ValueError, ArithmeticError) as error:
        raise InputError(f"no sensor of type '{kind}' has the values {sorted(given)}: {error}") from error
    raise InputError(
        f"a sensor's type must be 'sicd', 'sidd', 'range-doppler', 'rpc', 'geotransform', 'gcps' or 'corrected', got "
        f"{kind!r}"
    )
