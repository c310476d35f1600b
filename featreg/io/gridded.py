"""Variables on grids, as HDF5 and netCDF files hold them: images with coordinate vectors and a coordinate system."""

from __future__ import annotations

import logging
import posixpath
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.io.cf_places import (
    ALONG_X,
    ALONG_Y,
    LATITUDE,
    LONGITUDE,
    direction,
    factor_of,
    number_of,
    numbers_of,
    system_by_parameters,
    text_of,
    turns,
    unwritten,
    valid_ends,
)
from featreg.io.gdal_errors import decoding
from featreg.io.reader import Band, Raster
from featreg.io.scales import scale_in_words
from featreg.io.window import Window
from featreg.types import BoolArray, FloatArray, Geolocation

#: Where a coordinate system stands.
SYSTEMS = ("spatial_ref", "crs", "projection", "grid_mapping", "polar_stereographic", "transverse_mercator")
#: Coordinates count as evenly spaced where none lies farther off than this share of a step.
EVEN = 0.05
#: Coordinates of an axis at most.
LONGEST = 1 << 24
#: Nodes along each axis taken from longitudes and latitudes of every pixel.
NODES = 9

logger = logging.getLogger("featreg.io")


@dataclass(frozen=True, eq=False)
class Variable:
    """A named array of a file.

    Parameters
    ----------
    name : its full path
    shape, dtype : of the array; a compound of two numbers counts as complex
    attributes : by name
    read : called with a slice for each axis
    dimensions : full paths of the coordinate variables of its axes, "" where there is none
    fill : the value that stands where nothing was written, if the file knows one
    """

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    attributes: Mapping[str, Any]
    read: Callable[[tuple[Any, ...]], NDArray[Any]]
    dimensions: Sequence[str] = field(default=())
    fill: float | None = None

    @cached_property
    def parts(self) -> tuple[str, str] | None:
        """The names of real and imaginary part where samples are kept as a pair of numbers."""
        names = [name.lower() for name in self.dtype.names or ()]
        if names in (["r", "i"], ["real", "imag"], ["re", "im"]):
            return self.dtype.names[0], self.dtype.names[1]  # type: ignore[index]  # there are names where `names` is not empty
        return None

    @property
    def unsigned(self) -> bool:
        """Whether signed numbers stand for unsigned ones, which netCDF's classic format lacks."""
        return self.dtype.kind == "i" and text_of(self.attributes.get("_Unsigned")).lower() == "true"

    @property
    def is_image(self) -> bool:
        """Whether it has two axes, others of length 1 before them apart."""
        flat = len(self.shape) >= 2 and all(n == 1 for n in self.shape[:-2]) and min(self.shape[-2:]) > 1
        return flat and (self.parts is not None or self.dtype.kind in "uifc")

    def samples(self, rows: slice, cols: slice) -> NDArray[Any]:
        raw = self.read((*(0 for _ in self.shape[:-2]), rows, cols))
        raw = raw.reshape(raw.shape[-2:])
        if self.parts is None and self.unsigned:
            return raw.astype(raw.dtype.newbyteorder("=")).view(raw.dtype.name.replace("int", "uint"))
        if self.parts is None:
            return raw.astype(raw.dtype.newbyteorder("="), copy=False)
        out = np.empty(raw.shape, np.complex64)
        out.real, out.imag = raw[self.parts[0]], raw[self.parts[1]]
        return out


class GriddedReader:
    """The images among the variables of a file.

    Parameters
    ----------
    called : what the file is called in messages
    driver : "HDF5" or "netCDF"
    variables : by full path
    close : what closes the file
    turned : whether the axes of all variables are stored as columns, rows, as MATLAB does; what lies along y and x by
        its coordinates is turned one by one
    """

    whole = False

    def __init__(
        self,
        called: str,
        driver: str,
        variables: Mapping[str, Variable],
        close: Callable[[], None],
        turned: bool = False,
        sensor: Callable[[str], Mapping[str, Any] | None] = lambda name: None,
    ) -> None:
        self._sensor = sensor
        self.called, self.driver, self._variables, self._close, self._turned = called, driver, variables, close, turned
        self.files: Sequence[str] = [called]
        self._images = [variable for variable in variables.values() if variable.is_image]
        self._turns = [turned or self._directions(variable) == ("x", "y") for variable in self._images]

    def _directions(self, image: Variable) -> tuple[str, str]:
        """Along which axis of a map each of the two last axes of a variable runs, as its coordinates say it."""
        if len(image.dimensions) != len(image.shape):
            return "", ""
        named = [self._variables.get(path) for path in image.dimensions[-2:]]
        first, second = ("" if one is None else direction(one.name, one.attributes) for one in named)
        return first, second

    @cached_property
    def bands(self) -> Sequence[Band]:
        found = []
        for variable, turned in zip(self._images, self._turns, strict=True):
            height, width = variable.shape[-2:][:: -1 if turned else 1]
            attributes = variable.attributes
            words = [text_of(attributes.get(name)) for name in ("units", "long_name", "standard_name", "description")]
            found.append(
                Band(
                    variable.name.lstrip("/"),
                    (height, width),
                    _dtype_name(variable),
                    "coordinate" if direction(variable.name, attributes) else "",
                    said=scale_in_words(variable.name.rpartition("/")[2], *words),
                    nodata=_hole(variable),
                    gain=_or(number_of(attributes.get("scale_factor")), 1.0),
                    offset=_or(number_of(attributes.get("add_offset")), 0.0),
                )
            )
        return found

    def read(self, band: int, window: Window | None = None) -> Raster:
        known = self.bands[band]
        window = window or Window(0, 0, known.shape[1], known.shape[0])
        rows, cols = slice(window.y, window.y + window.height), slice(window.x, window.x + window.width)
        with decoding(self.called, self.driver):
            variable, turned = self._images[band], self._turns[band]
            samples = variable.samples(*((cols, rows) if turned else (rows, cols)))
            samples = np.ascontiguousarray(samples.T) if turned else samples
        shown = within_range(samples, variable.attributes, variable.dtype, variable.unsigned)
        return Raster(samples, known.dtype, shown, known.nodata, known.gain, known.offset, said=known.said)

    def close(self) -> None:
        self._close()

    def geolocation(self, band: int) -> Geolocation | None:
        """From the orbit and timing that a product states, coordinate vectors and a coordinate system, or longitude and
        latitude of every pixel.
        """
        if self._turned:
            return None
        with decoding(self.called, self.driver):
            located = self._located(self._images[band], self.bands[band].shape, self._turns[band])
            try:
                sensor = self._sensor(self._images[band].name)
            except InputError as error:
                logger.warning("%s: %s", self.called, error)
                return located
            if sensor is None:
                return located
            if tuple(sensor["shape"]) != self.bands[band].shape:
                logger.warning(
                    "%s: the metadata of the product describe an image of another size and are left out", self.called
                )
                return located
            return replace(located or Geolocation(), sensor=sensor)

    def _located(self, image: Variable, shape: tuple[int, int], turned: bool) -> Geolocation | None:
        along_x, along_y = (-2, -1) if turned else (-1, -2)
        for names_x, names_y, degrees in ((ALONG_X, ALONG_Y, False), (LONGITUDE, LATITUDE, True)):
            x = self._vector(image, names_x, along_x, shape[1])
            y = self._vector(image, names_y, along_y, shape[0])
            if x is None or y is None:
                continue
            mapping = self._mapping(image)
            known = {} if mapping is None else mapping.attributes
            crs = None if mapping is None else self._system_of(mapping)
            factors = [1.0 if degrees else factor_of(unit, crs, known) for _, unit in (x, y)]
            if None in factors:
                logger.warning(
                    "%s: the coordinates of %s are angles and nothing says from what height, so where it lies is left "
                    "out",
                    self.called,
                    image.name,
                )
                return None
            east, north = (
                (turns(values) if degrees and axis == 0 else values) * (factors[axis] or 1.0)
                for axis, (values, _) in enumerate((x, y))
            )
            dx, dy = _even(east), _even(north)
            if dx is None or dy is None:
                logger.warning(
                    "%s: the coordinates of %s are not evenly spaced, so where it lies is left out",
                    self.called, image.name,
                )  # fmt: skip
                return None
            corner = float(east[0]) - dx / 2, float(north[0]) - dy / 2
            crs = crs or ("EPSG:4326" if degrees else None)
            return Geolocation(transform=(dx, 0.0, corner[0], 0.0, dy, corner[1]), crs=crs)
        return None if turned else self._by_pixels(image)

    def _vector(self, image: Variable, names: Sequence[str], axis: int, length: int) -> tuple[FloatArray, str] | None:
        """Coordinates along an axis and their unit: of its dimension, or of a variable of a known name beside or above.

        A dimension's counts where its own name or its standard name says what it is.
        """
        candidates = []
        if len(image.dimensions) == len(image.shape) and (named := image.dimensions[axis]):
            standard = (
                text_of(self._variables[named].attributes.get("standard_name")) if named in self._variables else ""
            )
            candidates += [named] if {named.rpartition("/")[2].lower(), standard.lower()} & set(names) else []
        for folder in _folders(image.name):
            candidates += [path for path in self._in(folder) if path.rpartition("/")[2].lower() in names]
        for path in candidates:
            variable = self._variables.get(path)
            if variable is None or variable.shape != (length,) or not 1 < length <= LONGEST:
                continue
            if variable.dtype.kind in "uif":
                values = np.asarray(variable.read((slice(None),)), np.float64)
                gain, offset = (number_of(variable.attributes.get(n)) for n in ("scale_factor", "add_offset"))
                with np.errstate(all="ignore"):
                    values = values * _or(gain, 1.0) + _or(offset, 0.0)
                if np.isfinite(values).all():
                    return values, text_of(variable.attributes.get("units"))
        return None

    def _in(self, folder: str) -> list[str]:
        return [path for path in self._variables if posixpath.dirname(path) == folder]

    def _mapping(self, image: Variable) -> Variable | None:
        """The variable that holds the coordinate system: the grid mapping that is named, or one of a usual name."""
        named = text_of(image.attributes.get("grid_mapping")).partition(":")[0].strip()
        wanted = [named.rpartition("/")[2].lower()] if named else list(SYSTEMS)
        found = [
            self._variables[path]
            for folder in _folders(image.name)
            for path in self._in(folder)
            if path.rpartition("/")[2].lower() in wanted
        ]
        return next((one for one in found if self._says_system(one)), found[0] if found else None)

    def _says_system(self, variable: Variable) -> bool:
        return bool(text_of(variable.attributes.get("grid_mapping_name"))) or self._system_of(variable) is not None

    def _system_of(self, variable: Variable) -> str | None:
        from rasterio.crs import CRS
        from rasterio.errors import CRSError

        said = [text_of(variable.attributes.get(name)) for name in ("crs_wkt", "spatial_ref", "proj4", "proj4_string")]
        code = number_of(variable.attributes.get("epsg_code", variable.attributes.get("epsg")))
        if code is None and not any(said) and variable.shape in ((), (1,)) and variable.dtype.kind in "iu":
            value = int(np.asarray(variable.read(tuple(slice(None) for _ in variable.shape))).ravel()[0])
            code = value if 1024 <= value <= 32767 else None
        tried = [*said, "" if code is None else f"EPSG:{int(code)}"]
        if text_of(variable.attributes.get("grid_mapping_name")) == "latitude_longitude":
            tried.append("EPSG:4326")
        for text in tried:
            if text:
                try:
                    return str(CRS.from_user_input(text).to_wkt())
                except (CRSError, ValueError):
                    continue
        described = system_by_parameters(self.called, variable.attributes)
        return None if described is None else str(CRS.from_user_input(described).to_wkt())

    def _by_pixels(self, image: Variable) -> Geolocation | None:
        height, width = image.shape[-2:]
        found = []
        for names in (LONGITUDE, LATITUDE):
            paths = [p for folder in _folders(image.name) for p in self._in(folder)]
            found.append(
                next(
                    (
                        self._variables[p]
                        for p in paths
                        if p.rpartition("/")[2].lower() in names
                        and self._variables[p].shape == (height, width)
                        and self._variables[p].dtype.kind == "f"
                    ),
                    None,
                )
            )
        lon, lat = found
        if lon is None or lat is None:
            return None
        rows, cols = (np.unique(np.linspace(0, n - 1, NODES).astype(int)) for n in (height, width))
        points = []
        for row in rows.tolist():
            east, north = (np.asarray(v.read((row, slice(None))), np.float64).ravel()[cols] for v in (lon, lat))
            points += [(c, row, e, n, 0.0) for c, e, n in zip(cols.tolist(), east, north, strict=True)]
        gcps = np.array(points, np.float64)
        good: BoolArray = np.isfinite(gcps).all(axis=1) & (np.abs(gcps[:, 2]) <= 360) & (np.abs(gcps[:, 3]) <= 90)
        return Geolocation(crs="EPSG:4326", gcps=gcps[good]) if good.sum() > 3 else None


def _dtype_name(variable: Variable) -> str:
    if variable.parts:
        return "complex64"
    return variable.dtype.name.replace("int", "uint") if variable.unsigned else variable.dtype.name


def _folders(name: str) -> list[str]:
    """The group of a variable and those above it."""
    found = [posixpath.dirname(name)]
    while found[-1] not in ("/", ""):
        found.append(posixpath.dirname(found[-1]))
    return found


def _even(values: FloatArray) -> float | None:
    step = float(values[-1] - values[0]) / (len(values) - 1)
    off = np.abs(values - (values[0] + step * np.arange(len(values))))
    return step if step and float(off.max()) <= EVEN * abs(step) else None


def _first(attributes: Mapping[str, Any], *names: str) -> float | None:
    return next((n for name in names if (n := number_of(attributes.get(name))) is not None), None)


def within_range(
    samples: NDArray[Any], attributes: Mapping[str, Any], dtype: np.dtype[Any], unsigned: bool = False
) -> BoolArray | None:
    """Return which samples the conventions of netCDF take for data; None where nothing but a fill value is stated.

    Besides `_FillValue` these know `missing_value`, one or several, and `valid_min`, `valid_max` or `valid_range`; all
    are compared with the samples as they are stored, before scale and offset; see `valid_ends`.
    """
    turn = 256.0**dtype.itemsize if unsigned else 0.0
    low, high = valid_ends(attributes, samples, turn)
    missing = [value + turn if value < 0 else value for value in numbers_of(attributes.get("missing_value"))]
    if samples.dtype.kind == "c" or (low is None and high is None and not missing):
        return None
    shown = np.ones(samples.shape, np.bool_)
    if low is not None:
        shown &= ~(samples < low)
    if high is not None:
        shown &= ~(samples > high)
    for value in missing:
        # Written as the samples are: 1e20 of a double is another number than that of a float.
        with np.errstate(over="ignore", invalid="ignore"):
            shown &= samples != (np.float64(value).astype(samples.dtype) if samples.dtype.kind == "f" else value)
    return shown


def _hole(variable: Variable) -> float | None:
    """The value of samples that are not data, as the samples are read."""
    value = _first(variable.attributes, "_FillValue", "missing_value", "nodata")
    if value is None and variable.fill is not None and variable.fill == unwritten(variable.dtype):
        return variable.fill
    return value + 256.0**variable.dtype.itemsize if value is not None and value < 0 and variable.unsigned else value


def _or(value: float | None, other: float) -> float:
    return other if value is None else value


def missing(path: Any, extra: str, library: str, what: str, error: ImportError) -> InputError:
    """What to say where a library of an extra is not installed."""
    message = f"{path}: is {what}, which needs {library}; install it with: pip install 'featreg[{extra}]'"
    made = InputError(message)
    made.__cause__ = error
    return made
