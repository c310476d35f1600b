"""Pairs of spaceborne SAR scenes of any size, with RPCs, an elevation model and the exactly known geometry."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from featreg.errors import InputError, ParameterError
from featreg.geolocation.heights import Heights
from featreg.geolocation.rpc import RpcSensor
from featreg.geolocation.sensor import METRES_PER_DEGREE, Sensor
from featreg.geolocation.transfer import Transfer, on_ground
from featreg.io.gdal_errors import quiet
from featreg.io.writers import replacing
from featreg.runtime.parameters import checked
from featreg.simulate.ground import SIDE, Ground
from featreg.simulate.orbit import RangeDoppler, Terrain, plane_metres
from featreg.simulate.pairs import NOISE
from featreg.simulate.speckle_field import RADIUS, Looks, point_field, speckled_intensity
from featreg.types import FloatArray

#: Rows and columns of an image made at a time: the size of a tile of the file.
TILE = 512
#: Distance in pixels of the lattice on which the ground under an image is sought; between its nodes it is linear.
STEP = 4
#: Digital number of an average field, and metres between the cells of the elevation model, in pixels.
GAIN, POSTING = 300.0, 8.0
TIES = 400

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False)
class ScenePair:
    """The files of a simulated pair, and the truth between them.

    Parameters
    ----------
    reference, secondary : GeoTIFFs, uint16 amplitude, nodata 0, with RPCs
    dem : GeoTIFF of heights in metres above the ellipsoid, EPSG:4326
    truth_file : JSON of the exact geometry and of 400 tie points
    truth : reference -> secondary pixels
    bias : (x, y) px by which the secondary lies off what its RPC says
    """

    reference: Path
    secondary: Path
    dem: Path
    truth_file: Path
    truth: Transfer
    bias: tuple[float, float]


@checked("simulate_scene")
def simulate_scene(
    folder: str | Path,
    shape: tuple[int, int] = (10_000, 11_000),
    *,
    relief: Annotated[float, Interval(ge=0, le=3000)] = 150.0,
    bias: tuple[float, float] | None = None,
    incidence_deg: tuple[float, float] = (35.0, 40.0),
    heading_deg: tuple[float, float] = (-12.0, -10.5),
    pixel: tuple[float, float] = (3.0, 3.03),
    looks: Looks = 4,
    change: Annotated[float, Interval(ge=0, le=1)] = 0.05,
    seed: int = 0,
    progress: Progress | None = None,
) -> ScenePair:
    """Write a pair of spaceborne scenes and all that belongs to it.

    Parameters
    ----------
    folder : made where it is missing; files of the same names are replaced
    shape : (H, W) of both images, at least 256 x 256
    relief : metres from the lowest valley to the highest hill, at most
    bias : (x, y) px by which the secondary lies off its RPC; None draws 4 to 10 px along each axis
    incidence_deg, heading_deg, pixel : incidence angle, flight direction (clockwise from north) and ground pixel in
        metres of the reference and of the secondary; both look to the right
    looks : independent looks averaged in intensity
    change : share of fields, houses and point targets that differ between the dates
    seed : the same seed gives the same files
    progress : called with the name of the file, rows done and rows in all

    Returns
    -------
    `ScenePair`

    Raises
    ------
    ParameterError, InputError
        An argument outside its range; a folder that cannot be written.

    Notes
    -----
    A zero-Doppler satellite on a circular orbit passes twice at different incidence, so that hills lean towards the
    radar by different amounts and the displacement is not affine. Columns are slant range, lines are time. The RPCs are
    fitted to that geometry (below 1e-3 px over the scene) and know nothing of the bias. Each image is rendered from the
    backscatter on the ground through its own geometry, with its own speckle; point targets stand at exact places.
    The elevation model samples the same smooth hills. Memory does not grow with the number of lines.

    Examples
    --------
    >>> import tempfile
    >>> pair = simulate_scene(tempfile.mkdtemp(), (256, 320), relief=80.0, seed=1)
    >>> pair.truth(np.array([[100.0, 120.0]])).shape
    (1, 2)
    """
    _check(shape, (*incidence_deg, *heading_deg, *pixel, *(bias or ())))
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); give a folder that can be written") from error
    draw, hills, first, second = np.random.default_rng(seed).spawn(4)
    place = float(draw.uniform(5, 25)), float(draw.uniform(-50, 50))
    drawn = draw.choice([-1.0, 1.0], 2) * draw.uniform(4, 10, 2)
    off = (float(drawn[0]), float(drawn[1])) if bias is None else (float(bias[0]), float(bias[1]))
    extent = math.hypot(*shape) * max(pixel)
    terrain = Terrain.made(place, 200.0 + relief / 2, relief, 0.7 * extent, hills)
    views = [
        RangeDoppler.over(place, shape, incidence_deg=i, heading_deg=h, pixel=p, height=terrain.level, shift=s)
        for i, h, p, s in zip(incidence_deg, heading_deg, pixel, ((0.0, 0.0), _shift(shape, draw)), strict=True)
    ]
    low, high = terrain.level - relief / 2 - 100, terrain.level + relief / 2 + 100
    rpcs = [view.rpc(shape, low, high, 10.0 * p) for view, p in zip(views, pixel, strict=True)]
    paths = [folder / name for name in ("reference.tif", "secondary.tif", "dem.tif", "truth.json")]
    plane = _Plane(place, math.radians(heading_deg[0]), pixel[0])
    for date, (path, rng, lag) in enumerate(zip(paths, (first, second), ((0.0, 0.0), off), strict=False)):
        ground = Ground(seed, date, change, kept=3 * math.ceil(1.3 * max(shape) / SIDE) + 8)
        view = _View(rpcs[date], terrain, plane, lag)
        _write_image(path, view, ground, shape, looks, rng, progress)
    _write_dem(paths[2], terrain, rpcs, shape, POSTING * pixel[0])
    there = _moved(views[1], off)
    truth = Transfer(views[0], there, terrain)
    _write_truth(paths[3], truth, shape, off, seed)
    return ScenePair(paths[0], paths[1], paths[2], paths[3], truth, off)


def read_scene_truth(path: str | Path) -> Transfer:
    """Return the exact map reference -> secondary that `simulate_scene` wrote as ``truth.json``.

    Raises
    ------
    InputError
        The file is no such truth.
    """
    try:
        values = json.loads(Path(path).read_text(encoding="utf-8"))
        views = [_view_of(values[name]) for name in ("reference", "secondary")]
        hills = values["terrain"]
        terrain = Terrain(tuple(hills["origin"]), hills["level"], np.array(hills["waves"], np.float64))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: is not the truth of a simulated scene ({type(error).__name__}: {error})") from error
    return Transfer(views[0], views[1], terrain)


@dataclass(frozen=True)
class _Plane:
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
class _View:
    """How an image sees the plane: its sensor, and the bias (x, y) px of the image against the sensor."""

    sensor: Sensor
    heights: Heights
    plane: _Plane
    bias: tuple[float, float]

    def ground(self, xy: FloatArray) -> FloatArray:
        return self.plane.of(on_ground(self.sensor, xy - np.array(self.bias), self.heights)[0])

    def image(self, uv: FloatArray) -> FloatArray:
        lonlat = self.plane.lonlat(uv)
        return np.asarray(self.sensor.ground_to_image(lonlat, self.heights.at(lonlat)) + np.array(self.bias))


def _check(shape: tuple[int, int], numbers: tuple[float, ...]) -> None:
    if len(shape) != 2 or min(shape) < 256:
        raise ParameterError(f"shape must be (H, W) of at least 256 x 256, got {tuple(shape)}")
    good = len(numbers) in (6, 8) and np.isfinite(numbers).all()
    if not (good and all(15 <= i <= 60 for i in numbers[:2]) and all(p > 0 for p in numbers[4:6])):
        raise ParameterError(
            f"two incidence angles from 15 to 60 degrees, two headings, two pixels > 0 m and a bias (x, y) are needed, "
            f"got {numbers}"
        )


def _shift(shape: tuple[int, int], rng: np.random.Generator) -> tuple[float, float]:
    dx, dy = (rng.uniform(-0.04, 0.04, 2) * np.array(shape[::-1])).tolist()
    return dx, dy


def _write_image(
    path: Path,
    view: _View,
    ground: Ground,
    shape: tuple[int, int],
    looks: float,
    rng: np.random.Generator,
    progress: Progress | None,
) -> None:
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
    view: _View, ground: Ground, window: tuple[int, int, int, int], looks: float, rng: np.random.Generator
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


def _write_dem(path: Path, terrain: Terrain, sensors: list[RpcSensor], shape: tuple[int, int], posting: float) -> None:
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


def _moved(view: RangeDoppler, bias: tuple[float, float]) -> RangeDoppler:
    """The same orbit with every image point moved by the bias."""
    middle = view.middle[0] + bias[0], view.middle[1] + bias[1]
    return RangeDoppler(view.toward, view.along, middle, view.distance, view.spacing, view.centre_lonlat)


def _write_truth(path: Path, truth: Transfer, shape: tuple[int, int], bias: tuple[float, float], seed: int) -> None:
    side = math.ceil(math.sqrt(TIES))
    x, y = np.meshgrid(np.linspace(0.02, 0.98, side) * (shape[1] - 1), np.linspace(0.02, 0.98, side) * (shape[0] - 1))
    here = np.column_stack([x.ravel(), y.ravel()])
    there = truth(here)
    values = {
        "shape": list(shape),
        "seed": seed,
        "bias": list(bias),
        "reference": truth.reference.to_dict(),
        "secondary": truth.secondary.to_dict(),
        "terrain": truth.heights.to_dict(),
        "tie_points": {
            "columns": ["reference_x", "reference_y", "secondary_x", "secondary_y"],
            "rows": np.column_stack([here, there]).tolist(),
        },
    }
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(values), encoding="utf-8")


def _view_of(values: Mapping[str, Any]) -> RangeDoppler:
    given: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items() if k != "type"}
    return RangeDoppler(**given)
