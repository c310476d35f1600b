"""Which part of two images shows the same ground."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from featreg.errors import InputError, NoOverlapError
from featreg.geolocation.elevation_model import DemHeights
from featreg.geolocation.heights import ConstantHeight, Heights
from featreg.geolocation.projection import FULL_TURN, near
from featreg.geolocation.sensor import Sensor, metres
from featreg.geolocation.transfer import Transfer, on_ground
from featreg.io.window import Window
from featreg.types import BoolArray, FloatArray

#: Nodes along each side of the lattice on which the overlap is first sought, and points per side that are checked.
NODES = 97
CHECKED = 65
#: Part of a pixel by which the rectangles may reach over the rim of an image.
SLACK = 0.05

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Overlap:
    """The common ground of two images.

    Parameters
    ----------
    reference : the largest upright rectangle of the reference that lies wholly inside the secondary
    secondary : the smallest upright rectangle of the secondary that holds it, as the sensors have it
    transfer : reference -> secondary
    uncertainty_px : how far the transfer may be off along either axis of the secondary, px
    """

    reference: Window
    secondary: Window
    transfer: Transfer
    uncertainty_px: float


def find_overlap(
    reference: Sensor,
    secondary: Sensor,
    reference_shape: tuple[int, int],
    secondary_shape: tuple[int, int],
    heights: Heights,
    *,
    names: tuple[str, str] = ("reference", "secondary"),
) -> Overlap:
    """Find the overlap of two images.

    Parameters
    ----------
    reference, secondary : the sensors
    reference_shape, secondary_shape : (H, W)
    heights : of the ground
    names : of the two images, for the error

    Raises
    ------
    NoOverlapError
        The images do not see the same ground; the text says where each lies and how far apart they are.
    InputError
        The elevation model covers none of the overlap, or the sensors do not find the ground.

    Notes
    -----
    Section 2.1.3 of the SAR-ORB paper maps the four corners and takes the largest rectangle inside. Here a lattice over
    the reference is mapped instead, because relief bends the outline between the corners: the largest rectangle of
    lattice cells whose nodes all fall inside the secondary, whose sides then grow by bisection to the last pixel.
    """
    transfer = Transfer(reference, secondary, heights)
    height, width = reference_shape
    limit = np.array([secondary_shape[1], secondary_shape[0]]) - 1.0

    def inside(xy: FloatArray) -> BoolArray:
        at = transfer(xy)
        return np.asarray((np.isfinite(at) & (at >= -0.5) & (at <= limit + 0.5)).all(axis=1))

    xs, ys = (np.linspace(-0.5, n - 0.5, min(NODES, n + 1)) for n in (width, height))
    grid = np.stack(np.meshgrid(xs, ys), -1)
    nodes = inside(grid.reshape(-1, 2)).reshape(len(ys), len(xs))
    cells = nodes[:-1, :-1] & nodes[:-1, 1:] & nodes[1:, :-1] & nodes[1:, 1:]
    found = largest_rectangle(cells, np.diff(xs), np.diff(ys))
    if found is None:
        raise NoOverlapError(_apart(reference, secondary, reference_shape, secondary_shape, heights, names))
    top, left, bottom, right = found
    sides = [float(xs[left]), float(ys[top]), float(xs[right]), float(ys[bottom])]
    room = [
        xs[max(left - 1, 0)],
        ys[max(top - 1, 0)],
        xs[min(right + 1, len(xs) - 1)],
        ys[min(bottom + 1, len(ys) - 1)],
    ]
    for side in (0, 1, 2, 3):
        sides[side] = _grown(sides, side, float(room[side]), inside)
    x0, y0 = (math.ceil(side + 0.5 - SLACK) for side in sides[:2])
    x1, y1 = (math.floor(side + 0.5 + SLACK) for side in sides[2:])
    here = Window(x0, y0, x1 - x0, y1 - y0)
    if isinstance(heights, DemHeights):
        _check_cover(reference, here, heights, names[0])
    there = transfer(_rim(x0 - 0.5, y0 - 0.5, x1 - 0.5, y1 - 0.5))
    low = np.clip(np.floor(np.nanmin(there, axis=0) + 0.5 + SLACK), 0, limit).astype(int)
    high = np.clip(np.ceil(np.nanmax(there, axis=0) - 0.5 - SLACK), 0, limit).astype(int)
    window = Window(int(low[0]), int(low[1]), int(high[0] - low[0] + 1), int(high[1] - low[1] + 1))
    return Overlap(here, window, transfer, _uncertainty(reference, secondary))


def largest_rectangle(
    cells: BoolArray, widths: FloatArray | None = None, heights: FloatArray | None = None
) -> tuple[int, int, int, int] | None:
    """Return (top, left, bottom, right), ends excluded, of the largest rectangle of True cells, or None.

    Parameters
    ----------
    cells : (H, W) bool
    widths, heights : (W,) and (H,) sizes of the columns and rows; None for equal ones

    Notes
    -----
    The largest rectangle under each row's histogram of True cells above it, with a stack: O(H W).
    """
    rows, columns = cells.shape
    across = np.concatenate([[0.0], np.cumsum(np.ones(columns) if widths is None else widths)])
    down = np.concatenate([[0.0], np.cumsum(np.ones(rows) if heights is None else heights)])
    start = np.zeros(columns, np.int64)
    best, found = 0.0, None
    for row in range(rows):
        start[~cells[row]] = row + 1
        stack: list[tuple[int, int]] = []
        for column in range(columns + 1):
            top = row + 1 if column == columns else int(start[column])
            left = column
            while stack and stack[-1][1] < top:
                left, above = stack.pop()
                area = (across[column] - across[left]) * (down[row + 1] - down[above])
                if area > best:
                    best, found = area, (above, left, row + 1, column)
            if top <= row:
                stack.append((left, top))
    return found


def _grown(sides: list[float], side: int, room: float, inside: Callable[[FloatArray], BoolArray]) -> float:
    """Move one side outwards, up to `room`, as far as all of it stays inside the secondary."""
    good, bad = sides[side], room
    start, stop = (sides[1], sides[3]) if side in (0, 2) else (sides[0], sides[2])
    along = np.linspace(start, stop, CHECKED)

    def fits(value: float) -> bool:
        edge = np.full(CHECKED, value)
        points = np.column_stack([edge, along] if side in (0, 2) else [along, edge])
        return bool(inside(points).all())

    if good == bad or fits(bad):
        return bad
    while abs(good - bad) > SLACK / 2:
        middle = 0.5 * (good + bad)
        good, bad = (middle, bad) if fits(middle) else (good, middle)
    return good


def _rim(x0: float, y0: float, x1: float, y1: float) -> FloatArray:
    """(4 CHECKED, 2) points along the rim of a rectangle."""
    x, y = np.linspace(x0, x1, CHECKED), np.linspace(y0, y1, CHECKED)
    one = np.ones(CHECKED)
    return np.concatenate([np.column_stack(p) for p in ((x, y0 * one), (x1 * one, y), (x, y1 * one), (x0 * one, y))])


def _uncertainty(reference: Sensor, secondary: Sensor) -> float:
    """Both sensors' uncertainties, in pixels of the secondary; 5 px where a sensor cannot tell its pixel size."""
    ratio = min(reference.pixel_size()) / min(secondary.pixel_size())
    ratio = ratio if math.isfinite(ratio) and ratio > 0 else 1.0
    return math.hypot(reference.uncertainty_px * ratio, secondary.uncertainty_px)


def _check_cover(reference: Sensor, window: Window, heights: DemHeights, name: str) -> None:
    x, y = np.meshgrid(
        np.linspace(window.x, window.x + window.width - 1, 33), np.linspace(window.y, window.y + window.height - 1, 33)
    )
    ground, _ = on_ground(reference, np.column_stack([x.ravel(), y.ravel()]), heights)
    share = float(heights.covers(ground).mean())
    if share == 0:
        west, south, east, north = heights.bounds()
        raise InputError(
            f"{heights.path}: covers none of the overlap; it spans longitude {west:.4f} to {east:.4f} and latitude "
            f"{south:.4f} to {north:.4f}, {name} needs {_range(ground)}"
        )
    if share < 1:
        logger.warning("elevation model %s covers %.0f %% of the overlap; its edge goes on", heights.path, 100 * share)


def _range(ground: FloatArray) -> str:
    ground = _unfolded(ground)
    (west, south), (east, north) = np.nanmin(ground, axis=0), np.nanmax(ground, axis=0)
    return f"longitude {west:.4f} to {east:.4f} and latitude {south:.4f} to {north:.4f}"


def _unfolded(ground: FloatArray) -> FloatArray:
    """Ground points with longitudes that go on across the date line."""
    known = np.flatnonzero(np.isfinite(ground).all(axis=1))
    middle = float(ground[known[0], 0]) if len(known) else 0.0
    return np.column_stack([near(ground[:, 0], middle, FULL_TURN), ground[:, 1]])


def _apart(
    reference: Sensor,
    secondary: Sensor,
    reference_shape: tuple[int, int],
    secondary_shape: tuple[int, int],
    heights: Heights,
    names: tuple[str, str],
) -> str:
    places, middles = [], []
    for sensor, (height, width), name in zip(
        (reference, secondary), (reference_shape, secondary_shape), names, strict=True
    ):
        ground, _ = on_ground(sensor, _rim(-0.5, -0.5, width - 0.5, height - 0.5), heights)
        if not np.isfinite(ground).all():
            raise InputError(f"{name}: its sensor model does not find the ground of the image's rim")
        places.append(f"{name} spans {_range(ground)}")
        middles.append(_unfolded(ground).mean(axis=0))
    apart = float(np.hypot(*metres((middles[1] - middles[0])[None], float(middles[0][1]))[0])) / 1000
    over = f"; with the ground at {heights.metres:g} m" if isinstance(heights, ConstantHeight) else ""
    return f"the images do not overlap: {places[0]}, {places[1]}; their centres are {apart:.1f} km apart{over}"
