"""What the conventions of CF say of where a grid lies: axes, their units, and coordinate systems by parameters."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from featreg.types import FloatArray

#: Names of coordinates along x and along y, in map units and in degrees.
ALONG_X, ALONG_Y = ("x", "xcoordinates", "easting", "eastings", "projection_x_coordinate"), (
    "y", "ycoordinates", "northing", "northings", "projection_y_coordinate",
)  # fmt: skip
LONGITUDE, LATITUDE = ("lon", "longitude", "long"), ("lat", "latitude")
#: Words for units of length, in metres, and of angles at a satellite, in radians.
METRES = {"km": 1e3, "kilometer": 1e3, "kilometre": 1e3, "kilometers": 1e3, "kilometres": 1e3}
RADIANS = {"rad": 1.0, "radian": 1.0, "radians": 1.0, "microradian": 1e-6, "microradians": 1e-6}
#: The value that netCDF puts where nothing was written, of each type that has one.
UNWRITTEN = {
    "float32": 9.969209968386869e36,
    "float64": 9.969209968386869e36,
    "int16": -32767.0,
    "int32": -2147483647.0,
}

logger = logging.getLogger("featreg.io")


def direction(name: str, attributes: Mapping[str, Any]) -> Literal["x", "y", ""]:
    """Along which axis of a map a coordinate variable runs, told by its standard name or its own; "" for neither."""
    words = (text_of(attributes.get("standard_name")).lower(), name.rpartition("/")[2].lower())
    if any(word in (*ALONG_X, *LONGITUDE) for word in words):
        return "x"
    return "y" if any(word in (*ALONG_Y, *LATITUDE) for word in words) else ""


def factor_of(unit: str, crs: str | None, mapping: Mapping[str, Any]) -> float | None:
    """What projected coordinates are multiplied by to be in units of their coordinate system; None if nothing tells.

    Parameters
    ----------
    unit : of the coordinates; without a known word they are in units of the coordinate system already
    crs : WKT of the coordinate system, metres where there is none
    mapping : attributes of the grid mapping: angles of a geostationary view need `perspective_point_height`
    """
    word = unit.strip().lower()
    if word in RADIANS:
        height = number_of(mapping.get("perspective_point_height"))
        return None if height is None else RADIANS[word] * height
    if word not in METRES or crs is None:
        return METRES.get(word, 1.0)
    from rasterio.crs import CRS

    known = CRS.from_wkt(crs)
    return METRES[word] / float(known.linear_units_factor[1]) if known.is_projected else 1.0


def system_by_parameters(path: str, mapping: Mapping[str, Any]) -> str | None:
    """WKT of the coordinate system that the parameters of a grid mapping describe; None where none does.

    Needs pyproj (the `hdf5` extra); without it a warning says so.
    """
    if not text_of(mapping.get("grid_mapping_name")):
        return None
    try:
        from pyproj import CRS
        from pyproj.exceptions import CRSError
    except ImportError:
        logger.warning(
            "%s: its coordinate system is given by parameters of CF, which need pyproj and are left out; install it "
            "with: pip install 'featreg[hdf5]'",
            path,
        )
        return None
    plain = {name: _plain(value) for name, value in mapping.items()}
    try:
        return CRS.from_cf({name: value for name, value in plain.items() if value is not None}).to_wkt()
    except (CRSError, KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        logger.warning(
            "%s: the parameters of its coordinate system cannot be read (%s) and are left out", path,
            " ".join(str(error).split())[:120],
        )  # fmt: skip
        return None


def _plain(value: Any) -> str | float | list[float] | None:
    if text := text_of(value):
        return text
    numbers = numbers_of(value)
    return numbers[0] if len(numbers) == 1 else numbers or None


def unwritten(dtype: np.dtype[Any]) -> float | None:
    """The value by which netCDF marks what was never written, of samples of a type; None of those without one."""
    return UNWRITTEN.get(dtype.name)


def valid_ends(
    attributes: Mapping[str, Any], samples: NDArray[Any], turn: float = 0.0
) -> tuple[float | None, float | None]:
    """The least and the greatest sample that `valid_range`, or `valid_min` and `valid_max`, let through.

    They are compared with samples as they are stored; fractions beside whole samples are in unpacked units, as the
    conventions have it for ends of another type than the samples. `turn` is added to stored ends below 0, where signed
    numbers stand for unsigned ones.
    """
    low, high = (number_of(attributes.get(f"valid_{end}")) for end in ("min", "max"))
    kinds = [np.asarray(attributes[n]).dtype.kind for n in ("valid_min", "valid_max", "valid_range") if n in attributes]
    ends = numbers_of(attributes.get("valid_range"))
    if len(ends) == 2:
        low, high = ends
    gain, offset = (number_of(attributes.get(name)) for name in ("scale_factor", "add_offset"))
    if samples.dtype.kind in "iu" and "f" in kinds and (gain or offset is not None):
        gain, offset = gain or 1.0, offset or 0.0
        low, high = (None if end is None else (end - offset) / gain for end in (low, high))
        return (high, low) if gain < 0 else (low, high)
    low, high = (end + turn if end is not None and end < 0 else end for end in (low, high))
    return low, high


def turns(longitudes: FloatArray) -> FloatArray:
    """Longitudes without the leap from 180 to -180 or from 360 to 0 degrees."""
    return np.unwrap(longitudes, period=360.0)


def numbers_of(value: Any) -> list[float]:
    """The numbers that an attribute holds, none where it holds something else."""
    try:
        found = np.asarray(value)
        return [float(v) for v in found.ravel()] if found.dtype.kind in "uif" and found.size <= 64 else []
    except (TypeError, ValueError):
        return []


def number_of(value: Any) -> float | None:
    """The one number that an attribute holds, else None."""
    numbers = numbers_of(value)
    return numbers[0] if len(numbers) == 1 else None


def text_of(value: Any) -> str:
    """The text that an attribute holds, else ""."""
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.ravel()[0]
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return value if isinstance(value, str) else ""
