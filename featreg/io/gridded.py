"""Variables on grids, as HDF5 and netCDF files hold them: images with coordinate vectors and a coordinate system."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.io.cf_places import (
    direction,
    number_of,
    numbers_of,
    text_of,
    unwritten,
    valid_ends,
)
from featreg.io.gdal_errors import decoding
from featreg.io.gridded_places import Places, or_else
from featreg.io.reader import Band, Raster
from featreg.io.scales import scale_in_words
from featreg.io.variable import Variable
from featreg.io.window import Window
from featreg.types import BoolArray, Geolocation

logger = logging.getLogger("featreg.io")


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
        self._places = Places(called, variables)
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
                    gain=or_else(number_of(attributes.get("scale_factor")), 1.0),
                    offset=or_else(number_of(attributes.get("add_offset")), 0.0),
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
            located = self._places.located(self._images[band], self.bands[band].shape, self._turns[band])
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


def _dtype_name(variable: Variable) -> str:
    if variable.parts:
        return "complex64"
    return variable.dtype.name.replace("int", "uint") if variable.unsigned else variable.dtype.name


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


def missing(path: Any, extra: str, library: str, what: str, error: ImportError) -> InputError:
    """What to say where a library of an extra is not installed."""
    message = f"{path}: is {what}, which needs {library}; install it with: pip install 'featreg[{extra}]'"
    made = InputError(message)
    made.__cause__ = error
    return made
