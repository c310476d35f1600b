"""DataArrays of xarray as readers and scenes: bands, coordinate system, nodata value and windows, never all at once.

What rioxarray and the CF conventions write is read as it stands in attributes and coordinates; xarray itself is not
imported. Samples of dask are computed window by window.
"""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, Protocol, TypeGuard

import numpy as np

from featreg.errors import InputError
from featreg.io.arrays import plain_array
from featreg.io.bands import BandLike, choose, name_of, read_choice
from featreg.io.gridded import within_range
from featreg.io.reader import Band, Raster
from featreg.io.scales import scale_in_words
from featreg.io.window import Window
from featreg.types import BoolArray, FloatArray, Geolocation

#: Dimensions along rows and along columns, the pairs tried in order.
GRIDS = (("y", "x"), ("latitude", "longitude"), ("lat", "lon"), ("northing", "easting"), ("line", "sample"),
         ("azimuth", "range"), ("azimuth_time", "slant_range_time"), ("row", "col"))  # fmt: skip
#: What a DataArray is called in results, as every array.
NAME = "array"
#: Where a coordinate system stands when nothing names it.
SYSTEMS = ("spatial_ref", "crs")
#: Coordinates that lie off an even grid by less than this share of a step are on it.
EVEN = 1e-3

logger = logging.getLogger("featreg.io")


class DataArrayLike(Protocol):
    """A DataArray, as far as it can be told without xarray."""

    @property
    def dims(self) -> Any: ...
    @property
    def coords(self) -> Any: ...
    @property
    def attrs(self) -> Any: ...
    @property
    def sizes(self) -> Any: ...


def is_data_array(source: Any) -> TypeGuard[DataArrayLike]:
    """Whether something is a DataArray; xarray is not imported to find out."""
    module = sys.modules.get("xarray")
    return module is not None and isinstance(source, module.DataArray)


class DataArrayReader:
    """A DataArray with the manners of an open file; bands are counted from 0.

    Raises
    ------
    InputError
        Its dimensions are no rows, columns and at most one more.
    """

    driver = "xarray"
    whole = False
    files: Sequence[str] = ()

    def __init__(self, array: Any) -> None:
        self.name = str(array.name) if array.name else "DataArray"
        rows, columns = _grid_dims(array, self.name)
        more = [dim for dim in array.dims if dim not in (rows, columns)]
        lengthy = [dim for dim in more if array.sizes[dim] != 1]
        if len(lengthy) > 1:
            raise InputError(
                f"{self.name}: has the dimensions {', '.join(map(str, array.dims))}; rows, columns and at most one of "
                f"bands are needed: select along {lengthy[0]} first"
            )
        self._dim = lengthy[0] if lengthy else None
        array = array.isel({dim: 0 for dim in more if dim != self._dim})
        order = (rows, columns) if self._dim is None else (self._dim, rows, columns)
        self.array, self.rows, self.columns = array.transpose(*order), rows, columns

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self.array.sizes[self.rows], self.array.sizes[self.columns]

    @cached_property
    def bands(self) -> Sequence[Band]:
        array, attributes = self.array, self.array.attrs
        count = 1 if self._dim is None else array.sizes[self._dim]
        labels: Sequence[Any] = [""] * count
        if self._dim is not None and self._dim in array.coords:
            labels = [str(value) for value in np.atleast_1d(array.coords[self._dim].values)]
        said = _each(attributes.get("long_name"), count)
        units = _each(attributes.get("units"), count)
        # Bare numbers are how a file counts its bands; what it calls them stands in long_name.
        names = [said[k] if said[k] and (not labels[k] or labels[k].isdigit()) else labels[k] for k in range(count)]
        gains, offsets = (_each(attributes.get(n), count, d) for n, d in (("scale_factor", 1.0), ("add_offset", 0.0)))
        words = [scale_in_words(said[k], units[k], str(array.name or ""), labels[k]) for k in range(count)]
        nodata = _number(attributes.get("_FillValue", attributes.get("missing_value", attributes.get("nodata"))))
        return [
            Band(names[k] if not names[k].isdigit() else "", self.shape, array.dtype.name, said=words[k],
                 nodata=nodata, gain=self._stated("scale_factor", gains[k]),
                 offset=self._stated("add_offset", offsets[k]))
            for k in range(count)
        ]  # fmt: skip

    def _stated(self, name: str, value: Any) -> float:
        """The finite number that an attribute holds."""
        try:
            number = float(value)
        except (TypeError, ValueError):
            number = np.nan
        if not np.isfinite(number):
            raise InputError(f"{self.name}: its attribute {name} must be a finite number, got {value!r:.60}")
        return number

    def geolocation(self, band: int) -> Geolocation | None:
        """Where the array lies, None where nothing says so."""
        return self._place

    @cached_property
    def _place(self) -> Geolocation | None:
        system = _system(self.array)
        crs = _wkt(next((str(system[n]) for n in ("crs_wkt", "spatial_ref") if system.get(n)), None), self.name)
        if system.get("gcps"):
            gcps = _gcps(system["gcps"], self.name)
            gcps[:, :2] -= self._cut()
            return Geolocation(crs=crs, gcps=gcps)
        transform = self._transform(system)
        if transform is None and crs:
            logger.warning("%s: has a coordinate system but no even coordinates: its place is not known", self.name)
        if transform is None or (not crs and (abs(transform[0]), transform[1], transform[3]) == (1.0, 0.0, 0.0)):
            # What has no place is counted in pixels.
            return None
        return Geolocation(transform, crs)

    def _cut(self) -> FloatArray:
        """(2,) px by which an array was cut at the left and at the top from the file in which its control points count.

        Coordinates that count pixels tell it, from 0 or as the middles 0.5, 1.5, ...; without any nothing does.
        """
        starts = np.zeros(2)
        for k, dim in enumerate((self.columns, self.rows)):
            axis = _axis(self.array, dim)
            if axis is not None and axis[1] == 1.0 and axis[0] % 1.0 in (0.0, 0.5):
                starts[k] = np.floor(axis[0])
        return starts

    def _transform(self, system: Mapping[str, Any]) -> tuple[float, float, float, float, float, float] | None:
        """The geotransform: that of its file, moved to what is left of it, else that of the coordinates."""
        stated = None
        if system.get("GeoTransform") is not None:
            given = system["GeoTransform"]
            try:
                c, a, b, f, d, e = (float(v) for v in (given.split() if isinstance(given, str) else given))
            except (TypeError, ValueError) as error:
                raise InputError(
                    f"{self.name}: its GeoTransform must be six numbers as GDAL writes them, got {given!r:.60}"
                ) from error
            stated = a, b, c, d, e, f
        x, y = (_axis(self.array, dim) for dim in (self.columns, self.rows))
        if x is None or y is None:
            there = all(dim not in self.array.coords for dim in (self.rows, self.columns))
            return stated if there else None
        if stated is not None and stated[1] == stated[3] == 0:
            a, _, c, _, e, f = stated
            left, top = (x[0] - c) / a - 0.5, (y[0] - f) / e - 0.5
            steps = abs(x[1] / a - 1) * len(self.array[self.columns]), abs(y[1] / e - 1) * len(self.array[self.rows])
            if max(steps) < EVEN and abs(left - round(left)) < EVEN and abs(top - round(top)) < EVEN:
                return a, 0.0, c + round(left) * a, 0.0, e, f + round(top) * e
        return x[1], 0.0, x[0] - x[1] / 2, 0.0, y[1], y[0] - y[1] / 2

    def read(self, band: int, window: Window | None = None) -> Raster:
        """The samples of a window inside the array, or of all of it; dask computes these alone."""
        known = self.bands[band]
        part = self.array if self._dim is None else self.array[band]
        if window is not None:
            part = part[window.y : window.y + window.height, window.x : window.x + window.width]
        try:
            samples, shown = plain_array(part)
        except Exception as error:  # whatever the graph of somebody's array raises
            raise InputError(f"{self.name}: its samples cannot be computed ({error})") from error
        packed = np.dtype(self.array.encoding.get("dtype", samples.dtype)).kind in "iu"
        if packed and samples.dtype == np.float32 and (known.gain, known.offset) != (1.0, 0.0):
            # Masked integers are unpacked as the integers of the file are.
            samples = samples.astype(np.float64)
        more = self._within_range(samples)
        if more is not None:
            shown = more if shown is None else shown & more
        return Raster(samples, known.dtype, shown, known.nodata, known.gain, known.offset, said=known.said)

    def _within_range(self, samples: Any) -> BoolArray | None:
        """Which samples the conventions of netCDF take for data; what xarray unpacked is compared unpacked."""
        attributes = dict(self.array.attrs)
        gain, offset = (self.array.encoding.get(name) for name in ("scale_factor", "add_offset"))
        if gain is not None or offset is not None:
            gain, offset = 1.0 if gain is None else float(gain), 0.0 if offset is None else float(offset)
            for name in ("valid_min", "valid_max", "valid_range"):
                if name in attributes:
                    attributes[name] = np.asarray(attributes[name], np.float64) * gain + offset
        return within_range(samples, attributes, samples.dtype)

    def close(self) -> None:
        """Nothing is open."""


def read_data_array(array: Any, band: BandLike, most: float) -> Raster | None:
    """Read a DataArray of at most `most` pixels whole, as `featreg.io.opening.read_small_raster` does a file."""
    reader = DataArrayReader(array)
    choice = choose(reader.bands, band, reader.name)
    if reader.shape[0] * reader.shape[1] > most:
        return None
    called = name_of(reader.bands, choice)
    return replace(read_choice(reader, choice), geolocation=reader.geolocation(0), band=called)


def _grid_dims(array: Any, name: str) -> tuple[Any, Any]:
    for rows, columns in GRIDS:
        if rows in array.dims and columns in array.dims:
            return rows, columns
    if array.ndim >= 2:
        # What has no usual names is rows and columns in this order, as in an array of numpy.
        return array.dims[-2], array.dims[-1]
    raise InputError(f"{name}: has {array.ndim} dimensions, rows and columns are needed")


def _each(value: Any, count: int, default: Any = "") -> list[Any]:
    if value is None:
        return [default] * count
    values = list(value) if isinstance(value, tuple | list | np.ndarray) else [value]
    return values if len(values) == count else [values[0] if len(values) == 1 else default] * count


def _number(value: Any) -> Any:
    if value is None:
        return None
    try:
        number = np.asarray(value).reshape(-1)[0]
        return complex(number) if np.iscomplexobj(number) else float(number)
    except (TypeError, ValueError, IndexError):
        return None


def _system(array: Any) -> Mapping[str, Any]:
    """The attributes of the variable that holds the coordinate system (CF: grid mapping)."""
    named = array.encoding.get("grid_mapping") or array.attrs.get("grid_mapping")
    for name in (named, *SYSTEMS):
        if name and name in array.coords:
            found: Mapping[str, Any] = array.coords[name].attrs
            return found
    return {}


def _wkt(crs: str | None, name: str) -> str | None:
    """A coordinate system in the words in which a file's reader says it."""
    if not crs:
        return None
    from rasterio import Env
    from rasterio.crs import CRS
    from rasterio.errors import CRSError

    with Env():
        try:
            return str(CRS.from_user_input(crs).to_wkt())
        except CRSError as error:
            raise InputError(f"{name}: its coordinate system is not known ({crs!r:.60})") from error


def _axis(array: Any, dim: Any) -> tuple[float, float] | None:
    """First coordinate and step along a dimension; None where there are none, or no even ones."""
    if dim not in array.coords or array.coords[dim].ndim != 1 or array.coords[dim].dtype.kind not in "uif":
        return None
    values = np.asarray(array.coords[dim].values, np.float64)
    if len(values) < 2:
        return None
    step = (values[-1] - values[0]) / (len(values) - 1)
    even = values[0] + step * np.arange(len(values))
    if not step or not np.abs(values - even).max() <= EVEN * abs(step):
        return None
    return float(values[0]), float(step)


def _gcps(given: Any, name: str) -> FloatArray:
    """Ground control points as rioxarray keeps them: GeoJSON whose properties hold GDAL's row and column."""
    try:
        known = json.loads(given) if isinstance(given, str) else given
        rows = []
        for feature in known["features"]:
            x, y, *z = feature["geometry"]["coordinates"]
            at = feature["properties"]
            rows.append((at["col"] - 0.5, at["row"] - 0.5, x, y, z[0] if z else 0.0))
        return np.array(rows, np.float64).reshape(-1, 5)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise InputError(f"{name}: its ground control points cannot be read ({error})") from error
