"""Pairs of spaceborne SAR scenes of any size, with RPCs, an elevation model and the exactly known geometry."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval

from featreg.errors import InputError, ParameterError
from featreg.geolocation.transfer import Transfer
from featreg.io.writers import replacing
from featreg.runtime.parameters import checked
from featreg.simulate.ground import SIDE, Ground
from featreg.simulate.orbit import RangeDoppler, Terrain
from featreg.simulate.scene_images import POSTING, Plane, Progress, View, write_dem, write_image
from featreg.simulate.speckle_field import Looks

TIES = 400


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
    plane = Plane(place, math.radians(heading_deg[0]), pixel[0])
    for date, (path, rng, lag) in enumerate(zip(paths, (first, second), ((0.0, 0.0), off), strict=False)):
        ground = Ground(seed, date, change, kept=3 * math.ceil(1.3 * max(shape) / SIDE) + 8)
        view = View(rpcs[date], terrain, plane, lag)
        write_image(path, view, ground, shape, looks, rng, progress)
    write_dem(paths[2], terrain, rpcs, shape, POSTING * pixel[0])
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
