"""Heights of a digital elevation model, read tile by tile."""

from __future__ import annotations

import logging
import math
import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from featreg.errors import InputError
from featreg.geolocation.elevation_tiles import CellGrid, above_ellipsoid, read_grid, read_tile
from featreg.geolocation.heights import ConstantHeight, Heights
from featreg.geolocation.projection import FULL_TURN, near
from featreg.runtime.digests import digest_file
from featreg.types import BoolArray, FloatArray

#: Cells along each side of a tile, and tiles kept: at most 64 MB.
TILE = 512
KEPT = 60
#: Most tiles that are put together as one, 32 MB.
KEPT_PATCH = 16
#: Nodes along each side of a tile on which the geoid is asked for, which bends by centimetres between them.
GEOID_NODES = 9

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Patch:
    """A part of an elevation model in longitude and latitude, for compiled loops.

    Parameters
    ----------
    cells : (10,) float64, the map from longitude and latitude to columns and rows counted from the corner of the first
        cell, the width and height of the model, its middle longitude and a turn of longitude
    heights : (R, C) float64 metres above the ellipsoid
    left, top : column and row of the model at which they begin
    """

    cells: FloatArray
    heights: FloatArray
    left: int
    top: int


class _State:
    """What is read so far, shared by the threads of one process and never pickled."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.grid: CellGrid | None = None
        self.digest = ""
        self.tiles: OrderedDict[tuple[int, int], FloatArray] = OrderedDict()
        #: The last patch of several tiles, by the first and last of them.
        self.patch: tuple[tuple[int, int, int, int], FloatArray] | None = None
        self.starts: WeakKeyDictionary[Any, float] = WeakKeyDictionary()
        self.said: set[str] = set()


@dataclass(frozen=True)
class DemHeights(Heights):
    """A digital elevation model in any raster file and coordinate system.

    Parameters
    ----------
    path : of the file; workers open it again by this name
    offset : metres added to every height; geoid minus ellipsoid where the model counts from the geoid
    digest : SHA-256 of the file when it must be the one that was used before, else empty

    Raises
    ------
    InputError
        At first use: the file cannot be read, has no coordinate system, or is not the one of `digest`.

    Notes
    -----
    Heights are bilinear between cell centres. Tiles of 512 x 512 cells are read when needed, so memory stays bounded
    and a height does not depend on what was asked before. A hole (nodata, NaN) is filled from the valid cells within
    100 cells of it, by inverse distance; what is left takes height 0 plus the offset, as sea has it. A height that no
    ground has is a hole too. Beyond the edge the height of the edge goes on: `covers` says where that is. Holes are
    logged once. Where the coordinate system says that the heights count from a geoid, PROJ's own grid of it takes them
    to the ellipsoid; where PROJ lacks it that is logged. A stated `offset` stands in place of both.
    """

    path: str
    offset: float = 0.0
    digest: str = ""
    _state: _State = field(default_factory=_State, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", str(self.path))
        if not math.isfinite(self.offset):
            raise InputError(f"the offset of an elevation model must be finite metres, got {self.offset}")
        object.__setattr__(self, "offset", float(self.offset))

    def __getstate__(self) -> dict[str, Any]:
        return {"path": self.path, "offset": self.offset, "digest": self.digest}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.__dict__["_state"] = _State()

    def at(self, lonlat: FloatArray) -> FloatArray:
        cells = self._cells(lonlat)
        out = np.full(len(cells), np.nan)
        rows = np.flatnonzero(np.isfinite(cells).all(axis=1))
        if not len(rows):
            return out
        height, width = self._grid.shape
        limit = np.array([width - 1, height - 1], np.float64)
        x, y = np.clip(cells[rows], 0, limit).T
        left, top = (np.minimum(np.floor(v), max(n - 2, 0)).astype(np.int64) for v, n in ((x, width), (y, height)))
        key = top // TILE * (width // TILE + 1) + left // TILE
        for one in np.unique(key):
            here = key == one
            i, j = int(left[here][0]) // TILE, int(top[here][0]) // TILE
            tile = self._tile(i, j)
            u, v = left[here] - i * TILE, top[here] - j * TILE
            s, t = x[here] - left[here], y[here] - top[here]
            right, below = np.minimum(u + 1, tile.shape[1] - 1), np.minimum(v + 1, tile.shape[0] - 1)
            upper = tile[v, u] * (1 - s) + tile[v, right] * s
            lower = tile[below, u] * (1 - s) + tile[below, right] * s
            out[rows[here]] = upper * (1 - t) + lower * t
        return out

    def covers(self, lonlat: FloatArray) -> BoolArray:
        """Return (N,) bool, True where the model has a cell."""
        return self._inside(self._cells(lonlat))

    @property
    def in_degrees(self) -> bool:
        """Whether the model counts in longitude and latitude on WGS84, so that it has patches."""
        projection = self._grid.projection
        return projection.is_plain and projection.turn > 0

    def patch(self, lonlat: FloatArray) -> Patch | None:
        """The tiles of (N, 2) longitudes and latitudes, and all between them, as one.

        None where they are more than `KEPT_PATCH`, or no point is finite.
        """
        grid, good = self._grid, lonlat[np.isfinite(lonlat).all(axis=1)]
        if not len(good):
            return None
        cells = self._cells(good)
        size = np.array(grid.shape[::-1])
        low, high = (np.clip(np.floor(end), 0, np.maximum(size - 2, 0)) for end in (cells.min(0), cells.max(0)))
        (left, top), (right, bottom) = (low // TILE).astype(int).tolist(), (high // TILE).astype(int).tolist()
        if (right - left + 1) * (bottom - top + 1) > KEPT_PATCH:
            return None
        to_cells = [*tuple(~grid.forward)[:6], *size.tolist(), grid.middle, grid.projection.turn]
        heights = self._joined(left, top, right, bottom)
        return Patch(np.array(to_cells, np.float64), heights, left * TILE, top * TILE)

    def _joined(self, left: int, top: int, right: int, bottom: int) -> FloatArray:
        """The heights of some tiles, the ends included, as one array."""
        if (left, top) == (right, bottom):
            return self._tile(left, top)
        state, ends = self._state, (left, top, right, bottom)
        with state.lock:
            if state.patch is None or state.patch[0] != ends:
                rows = ([self._tile(i, j)[:TILE, :TILE] for i in range(left, right)] for j in range(top, bottom + 1))
                last = (self._tile(right, j) for j in range(top, bottom + 1))
                bands = [np.hstack([*row, end[:TILE]]) for row, end in zip(rows, last, strict=True)]
                below = [self._tile(i, bottom)[TILE:, :TILE] for i in range(left, right)]
                bands.append(np.hstack([*below, self._tile(right, bottom)[TILE:]]))
                state.patch = ends, np.vstack(bands)
            return state.patch[1]

    def start(self, sensor: Any, find: Callable[[], float]) -> float:
        """The height at which searches along a sensor's lines of sight begin: what `find` gives, asked once."""
        state = self._state
        with state.lock:
            try:
                known = state.starts.get(sensor)
            except TypeError:
                # A sensor of another package need not be one that a table can hold.
                return find()
            if known is None:
                known = state.starts[sensor] = find()
            return known

    def to_dict(self) -> dict[str, Any]:
        return {"type": "dem", "path": self.path, "offset": self.offset, "digest": self.digest or self._digest()}

    def bounds(self) -> tuple[float, float, float, float]:
        """West, south, east and north ends in degrees."""
        grid = self._grid
        h, w = grid.shape
        rim = np.array([grid.at(w * s, h * t) for s in np.linspace(0, 1, 9) for t in np.linspace(0, 1, 9)])
        lon, lat = grid.projection.to_lonlat(rim).T
        lon = near(lon, float(lon[40]), FULL_TURN)
        return float(np.nanmin(lon)), float(np.nanmin(lat)), float(np.nanmax(lon)), float(np.nanmax(lat))

    def _cells(self, lonlat: FloatArray) -> FloatArray:
        """(N, 2) column and row, the centre of the first cell at (0, 0)."""
        grid = self._grid
        xy = grid.projection.from_lonlat(np.asarray(lonlat, np.float64))
        xy = grid.projection.near(xy, grid.middle)
        a, b, c, d, e, f = tuple(~grid.forward)[:6]
        return np.column_stack([a * xy[:, 0] + b * xy[:, 1] + c, d * xy[:, 0] + e * xy[:, 1] + f]) - 0.5

    def _inside(self, cells: FloatArray) -> BoolArray:
        height, width = self._grid.shape
        return np.asarray(((cells >= -0.5) & (cells <= np.array([width, height]) - 0.5)).all(axis=1))

    @property
    def _grid(self) -> CellGrid:
        state = self._state
        with state.lock:
            if state.grid is None:
                if self.digest and self._digest() != self.digest:
                    raise InputError(
                        f"{self.path}: is not the elevation model that was used before (its digest differs)"
                    )
                state.grid = self._open(read_grid)
            return state.grid

    def _tile(self, i: int, j: int) -> FloatArray:
        """The tile that starts at column i * TILE and row j * TILE, with one more cell to the right and below."""
        state = self._state
        with state.lock:
            found = state.tiles.pop((i, j), None)
            if found is None:
                read = self._open(lambda dataset: read_tile(dataset, i * TILE, j * TILE, TILE))
                found = read.heights + (self.offset or self._geoid(i * TILE, j * TILE, read.heights.shape))
                if read.holes:
                    sea = f"; {read.alone} lie deep inside and take the sea level" if read.alone else ""
                    odd = f"; {read.impossible} hold no possible height, such as {read.example:g}"
                    self._say_once(
                        f"has holes, filled from the cells around ({read.holes} in the first such tile"
                        f"{odd if read.impossible else ''}{sea})"
                    )
            state.tiles[i, j] = found
            while len(state.tiles) > KEPT:
                state.tiles.popitem(last=False)
            return found

    def _open(self, read: Any) -> Any:
        import rasterio

        from featreg.io.gdal_errors import quiet, reason

        if not Path(self.path).exists():
            raise InputError(f"{self.path}: no such elevation model; give the path of an existing raster file")
        try:
            with quiet(), rasterio.open(Path(self.path).absolute()) as dataset:
                return read(dataset)
        except InputError as error:
            raise InputError(f"{self.path}: {error}") from error
        except (rasterio.errors.RasterioError, OSError, ValueError) as error:
            raise InputError(f"{self.path}: cannot be read as an elevation model ({reason(error)})") from error

    def _digest(self) -> str:
        state = self._state
        with state.lock:
            if not state.digest:
                try:
                    state.digest = digest_file(self.path)
                except OSError as error:
                    raise InputError(f"{self.path}: cannot be read as an elevation model ({error.strerror})") from error
            return state.digest

    def _geoid(self, column: int, row: int, shape: tuple[int, int]) -> FloatArray | float:
        """Metres from the ellipsoid to the surface that the heights of a tile count from; 0 where that is not known."""
        grid = self._grid
        if not grid.vertical:
            return 0.0
        x, y = (np.linspace(first, first + n - 1, GEOID_NODES) for first, n in ((column, shape[1]), (row, shape[0])))
        nodes = np.array([grid.at(u + 0.5, v + 0.5) for v in y for u in x])
        lifted = above_ellipsoid(grid.vertical, nodes).reshape(GEOID_NODES, GEOID_NODES)
        # PROJ leaves the heights as they are where it lacks the grid; no geoid is 0 at every node.
        if not np.isfinite(lifted).all() or not lifted.any():
            self._say_once(
                "counts its heights from a geoid, as its coordinate system says, whose grid PROJ lacks here: they are "
                "taken as above the ellipsoid, up to 100 m off; install the grid (projsync, PROJ_NETWORK=ON) or give "
                "a model above the ellipsoid"
            )
            return 0.0
        rows = np.arange(row, row + shape[0])
        along = np.array([np.interp(np.arange(column, column + shape[1]), x, line) for line in lifted])
        at = np.clip(np.searchsorted(y, rows, side="right") - 1, 0, GEOID_NODES - 2)
        part = ((rows - y[at]) / np.maximum(y[at + 1] - y[at], 1e-9))[:, None]
        return np.asarray(along[at] * (1 - part) + along[at + 1] * part)

    def _say_once(self, what: str) -> None:
        # The first tile with something to say speaks for all that have the same.
        kind = what.partition(",")[0]
        if kind not in self._state.said:
            self._state.said.add(kind)
            logger.warning("elevation model %s: %s", self.path, what)


def heights_from_dict(values: Mapping[str, Any]) -> Heights:
    """Return the heights that `Heights.to_dict` wrote.

    Raises
    ------
    InputError
        The type is unknown or the values do not make such heights.
    """
    given = dict(values)
    kind = given.pop("type", None)
    try:
        if kind == "constant":
            return ConstantHeight(**given)
        if kind == "dem":
            return DemHeights(**given)
    except TypeError as error:
        raise InputError(f"no heights of type '{kind}' have the values {sorted(given)}: {error}") from error
    raise InputError(f"the type of heights must be 'constant' or 'dem', got {kind!r}")
