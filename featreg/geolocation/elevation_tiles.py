"""What is read of the file of an elevation model: where its cells lie, and one tile of them with its holes filled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from featreg.errors import InputError
from featreg.geolocation.projection import Projection
from featreg.types import BoolArray, FloatArray

#: Holes are filled from valid cells at most this far away, in cells; larger ones hold the sea level.
REACH = 100
#: No ground lies outside these metres (the shore of the Dead Sea, Mount Everest): what does is a hole that nobody
#: declared, such as -32768, -9999 or 3.4e38, or the bottom of a sea.
POSSIBLE = (-600.0, 9500.0)


@dataclass(frozen=True, eq=False)
class CellGrid:
    """Where the cells of an elevation model lie: `forward` maps cell corners to the coordinate system."""

    shape: tuple[int, int]
    forward: Any
    projection: Projection
    vertical: str = ""

    @property
    def middle(self) -> float:
        """Longitude or easting in the middle of the model."""
        return self.at(self.shape[1] / 2, self.shape[0] / 2)[0]

    def at(self, column: float, row: float) -> tuple[float, float]:
        """Coordinates of a point counted from the corner of the first cell."""
        a, b, c, d, e, f = tuple(self.forward)[:6]
        return float(a * column + b * row + c), float(d * column + e * row + f)


def read_grid(dataset: Any) -> CellGrid:
    """Return where the cells of an open dataset lie.

    Raises
    ------
    InputError
        It has several bands or complex samples, or nothing says where it lies.
    """
    if dataset.count != 1:
        raise InputError(f"has {dataset.count} bands, an elevation model has one")
    if dataset.crs is None or dataset.transform.is_identity:
        raise InputError("has no geotransform with a coordinate system, an elevation model needs one")
    if "complex" in dataset.dtypes[0]:
        raise InputError(f"holds {dataset.dtypes[0]}, an elevation model holds metres")
    wkt = dataset.crs.to_wkt()
    vertical = wkt[max(wkt.rfind("VERT_CS"), wkt.rfind("VERTCRS"), 0) :]
    geoid = wkt.startswith(("COMPD_CS", "COMPOUNDCRS")) and "llipsoid" not in vertical
    return CellGrid((dataset.height, dataset.width), dataset.transform, Projection(wkt), wkt if geoid else "")


def above_ellipsoid(crs: str, xy: FloatArray) -> FloatArray:
    """Return (N,) metres above the ellipsoid of (N, 2) points of a coordinate system at its height 0."""
    from rasterio.warp import transform

    return np.array(transform(crs, "EPSG:4979", xy[:, 0].tolist(), xy[:, 1].tolist(), [0.0] * len(xy))[2])


@dataclass(frozen=True, eq=False)
class Tile:
    """What was read of a tile: `heights` without holes; how many cells were `holes`, how many of these held an
    `impossible` height, the first as `example`, and how many lie `alone`, without a neighbour in reach.
    """

    heights: FloatArray
    holes: int = 0
    impossible: int = 0
    example: float = 0.0
    alone: int = 0


def read_tile(dataset: Any, column: int, row: int, side: int) -> Tile:
    """Return the tile of `side` x `side` cells from a column and row on, with one more to the right and below."""
    from rasterio.windows import Window

    def window(margin: int) -> tuple[FloatArray, Any, int, int]:
        x0, y0 = max(column - margin, 0), max(row - margin, 0)
        x1 = min(column + side + 1 + margin, dataset.width)
        y1 = min(row + side + 1 + margin, dataset.height)
        read = dataset.read(1, window=Window(x0, y0, x1 - x0, y1 - y0), masked=True)
        values = np.ma.getdata(read).astype(np.float64) * dataset.scales[0] + dataset.offsets[0]
        return values, ~np.ma.getmaskarray(read) & np.isfinite(values), column - x0, row - y0

    values, declared, _, _ = window(0)
    valid = declared & _possible(values)
    if valid.all():
        return Tile(values)
    from rasterio.fill import fillnodata

    shape = values.shape
    around, known, x, y = window(REACH)
    known &= _possible(around)
    place = (slice(y, y + shape[0]), slice(x, x + shape[1]))
    filled = np.where(known, around, 0.0)
    if known.any():
        guess = fillnodata(filled.astype(np.float32), known.astype(np.uint8), max_search_distance=REACH)
        # Cells out of reach of any valid one keep the value they came with: 0.
        filled = np.where(known, filled, guess)
    alone = _far_from(known, REACH)
    odd = values[declared & ~valid]
    return Tile(
        filled[place],
        int((~known[place]).sum()),
        len(odd),
        float(odd[0]) if len(odd) else 0.0,
        int(alone[place].sum()),
    )


def _possible(heights: FloatArray) -> BoolArray:
    with np.errstate(invalid="ignore"):
        return np.asarray((heights >= POSSIBLE[0]) & (heights <= POSSIBLE[1]))


def _far_from(known: Any, reach: int) -> Any:
    """True where the nearest valid cell is farther than `reach`."""
    import cv2

    if not known.any():
        return ~known
    return cv2.distanceTransform((~known).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE) > reach
