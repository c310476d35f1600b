"""Where the variables of a file lie: by coordinate vectors and a coordinate system, or longitudes and latitudes."""

from __future__ import annotations

import logging
import posixpath
from collections.abc import Mapping, Sequence

import numpy as np

from featreg.io.cf_places import (
    ALONG_X,
    ALONG_Y,
    LATITUDE,
    LONGITUDE,
    factor_of,
    number_of,
    system_by_parameters,
    text_of,
    turns,
)
from featreg.io.variable import Variable
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


class Places:
    """What the variables of a file say of where they lie.

    Parameters
    ----------
    called : what the file is called in messages
    variables : by full path
    """

    def __init__(self, called: str, variables: Mapping[str, Variable]) -> None:
        self.called, self._variables = called, variables

    def located(self, image: Variable, shape: tuple[int, int], turned: bool) -> Geolocation | None:
        """Return where an image of shape (H, W) lies, or None where nothing says it; `turned`: its axes are x, y."""
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
                    values = values * or_else(gain, 1.0) + or_else(offset, 0.0)
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


def or_else(value: float | None, other: float) -> float:
    """Return a number, or another where there is none."""
    return other if value is None else value
