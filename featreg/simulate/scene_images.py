"""Images of a simulated scene rendered through their own geometry, and its elevation model, written tile by tile."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.geolocation.heights import Heights
from featreg.geolocation.rpc import RpcSensor
from featreg.geolocation.sensor import METRES_PER_DEGREE, Sensor
from featreg.geolocation.transfer import on_ground
from featreg.io.gdal_errors import quiet
from featreg.io.writers import replacing
from featreg.simulate.ground import SIDE, Ground
from featreg.simulate.orbit import Terrain, plane_metres
from featreg.simulate.pairs import NOISE
from featreg.simulate.speckle_field import RADIUS, point_field, speckled_intensity
from featreg.types import FloatArray

#: Rows and columns of an image made at a time: the size of a tile of the file.
TILE = 512
#: Distance in pixels of the lattice on which the ground under an image is sought; between its nodes it is linear.
STEP = 4
#: Digital number of an average field, and metres between the cells of the elevation model, in pixels.
GAIN, POSTING = 300.0, 8.0

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Plane:
    """Ground pixels (u, v) of `pixel` metres, v along the reference's flight, u to its right; a block's middle is
    the origin."""

    origin: tuple[float, float]
    heading: float
    pixel: float

    def of(self, lonlat: FloatArray) -> FloatArray:
        east, north = plane_metres(lonlat, self.origin).T / self.pixel
        c, s = math.cos(self.heading), math.sin(self.heading)
        return np.column_stack([c * east - s * north, s * east + c * north]) + SIDE / 2

    def lonlat(self, uv: FloatArray) -> FloatArray:
        u, v = (uv.T - SIDE / 2) * self.pixel
        c, s = math.cos(self.heading), math.sin(self.heading)
        east, north = c * u + s * v, c * v - s * u
        x = east / (METRES_PER_DEGREE * math.cos(math.radians(self.origin[1])))
        return np.asarray(np.column_stack([x, north / METRES_PER_DEGREE]) + np.array(self.origin))


@dataclass(frozen=True, eq=False)
class View:
    """How an image sees the plane: its sensor, and the bias (x, y) px of the image against the sensor."""

    sensor: Sensor
    heights: Heights
    plane: Plane
    bias: tuple[float, float]

    def ground(self, xy: FloatArray) -> FloatArray:
        return self.plane.of(on_ground(self.sensor, xy - np.array(self.bias), self.heights)[0])

    def image(self, uv: FloatArray) -> FloatArray:
        lonlat = self.plane.lonlat(uv)
        return np.asarray(self.sensor.ground_to_image(lonlat, self.heights.at(lonlat)) + np.array(self.bias))


def write_image(
    path: Path,
    view: View,
    ground: Ground,
    shape: tuple[int, int],
    looks: float,
    rng: np.random.Generator,
    progress: Progress | None,
) -> None:
    """Write the image (H, W) of a view of the ground as a GeoTIFF with the RPCs of its sensor."""
    from rasterio.rpc import RPC
    from rasterio.windows import Window

    height, width = shape
    rpcs = RPC(**view.sensor.rpcs) if isinstance(view.sensor, RpcSensor) else None
    profile = {"width": width, "height": height, "dtype": "uint16", "nodata": 0, "rpcs": rpcs, "compress": "deflate"}

    def fill(dataset: Any) -> None:
        for top in range(0, height, TILE):
            rows = min(TILE, height - top)
            # A seed of its own per row of tiles: the image does not depend on how it is cut into columns.
            for left, tile_rng in zip(range(0, width, TILE), rng.spawn(math.ceil(width / TILE)), strict=True):
                columns = min(TILE, width - left)
                values = _rendered(view, ground, (left, top, columns, rows), looks, tile_rng)
                dataset.write(values, 1, window=Window(left, top, columns, rows))
            if progress is not None:
                progress(path.name, top + rows, height)

    _write_tiff(path, profile, fill)


def _rendered(
    view: View, ground: Ground, window: tuple[int, int, int, int], looks: float, rng: np.random.Generator
) -> NDArray[np.uint16]:
    """The pixels of one window (left, top, width, height)."""
    import cv2

    left, top, width, height = window
    x = np.arange(left - STEP, left + width + 2 * STEP, STEP, dtype=np.float64)
    y = np.arange(top - STEP, top + height + 2 * STEP, STEP, dtype=np.float64)
    nodes = view.ground(np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)).reshape(len(y), len(x), 2)
    low = np.floor(nodes.min(axis=(0, 1))).astype(int) - 2
    high = np.ceil(nodes.max(axis=(0, 1))).astype(int) + 3
    u0, v0, across, down = int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1])
    # The same power from less ground: slopes that face the radar are bright.
    steep = np.gradient(nodes[..., 0], STEP, axis=1)
    fields = np.dstack([nodes[..., 0] - u0, nodes[..., 1] - v0, np.clip(1.0 / np.maximum(steep, 0.1), 0.3, 4.0)])
    u, v, bright = cv2.split(_between(fields, np.arange(width) / STEP + 1, np.arange(height) / STEP + 1))
    canvas = ground.canvas(u0, v0, across, down)
    backscatter = cv2.remap(canvas, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) * bright
    places, amplitude = ground.targets(u0 - RADIUS, v0 - RADIUS, across + 2 * RADIUS, down + 2 * RADIUS)
    field = point_field(view.image(places) - [left, top], amplitude, (height, width))
    intensity = speckled_intensity(np.asarray(backscatter + np.float32(NOISE), np.float32), field, looks, rng)
    return np.asarray(np.clip(np.rint(GAIN * np.sqrt(intensity)), 1, 65535), np.uint16)


def _between(fields: FloatArray, x: FloatArray, y: FloatArray) -> NDArray[np.float32]:
    """(h, w, K) bilinear values of (R, C, K) node values at node coordinates (w,) and (h,)."""
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    s, t = (x - i)[None, :, None], (y - j)[:, None, None]
    rows = fields[j] * (1 - t) + fields[j + 1] * t
    return np.asarray(rows[:, i] * (1 - s) + rows[:, i + 1] * s, np.float32)


def write_dem(path: Path, terrain: Terrain, sensors: list[RpcSensor], shape: tuple[int, int], posting: float) -> None:
    """Write the heights of the ground under both images and a margin of a twentieth of their size."""
    from rasterio.transform import from_origin
    from rasterio.windows import Window

    height, width = shape
    corners = np.array([[x, y] for x in (0.0, width - 1.0) for y in (0.0, height - 1.0)])
    ground = np.concatenate(
        [s.image_to_ground(corners, h) for s in sensors for h in (terrain.level - 2000, terrain.level + 2000)]
    )
    (west, south), (east, north) = ground.min(axis=0), ground.max(axis=0)
    margin = 0.05 * (north - south)
    step_y = posting / METRES_PER_DEGREE
    step_x = step_y / math.cos(math.radians(0.5 * (south + north)))
    west, north = west - margin, north + margin
    columns = math.ceil((east + margin - west) / step_x)
    rows = math.ceil((north - south + margin) / step_y)
    profile = {
        "width": columns,
        "height": rows,
        "dtype": "float32",
        "crs": "EPSG:4326",
        "transform": from_origin(west, north, step_x, step_y),
        "compress": "deflate",
    }

    def fill(dataset: Any) -> None:
        x = west + (np.arange(columns) + 0.5) * step_x
        for top in range(0, rows, TILE):
            y = north - (np.arange(top, min(top + TILE, rows)) + 0.5) * step_y
            places = np.stack(np.meshgrid(x, y), -1)
            values = terrain.at(places.reshape(-1, 2)).reshape(len(y), len(x)).astype(np.float32)
            dataset.write(values, 1, window=Window(0, top, columns, len(y)))

    _write_tiff(path, profile, fill)


def _write_tiff(path: Path, profile: Mapping[str, Any], fill: Callable[[Any], None]) -> None:
    import rasterio

    layout = {"driver": "GTiff", "count": 1, "tiled": True, "blockxsize": TILE, "blockysize": TILE}
    layout |= {**profile, "bigtiff": "if_safer"}
    with replacing(path) as temporary, quiet(), rasterio.open(temporary.absolute(), "w", **layout) as dataset:
        fill(dataset)
