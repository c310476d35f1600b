"""A landscape of shapes and point scatterers as a radar looking along +x sees it, in continuous coordinates.

Nothing here is sampled: outlines and points are real numbers, so that any image of the landscape may be rendered from
it directly (`featreg.simulate`). Backscatter is intensity relative to an average field.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from featreg.types import BoolArray, FloatArray

#: The radar illuminates from -x: shadows fall towards +x, walls seen from -x are bright.
LOOK = np.array([1.0, 0.0])
WATER, ASPHALT, SHADOW = 0.012, 0.06, 0.02


@dataclass(frozen=True, eq=False)
class Surface:
    """An area of rough surface; later surfaces cover earlier ones.

    `outline` is (N, 2); `backscatter` holds the mean intensity at the two dates (NaN = not there); `coarse` and
    `fine` say how much of the two natural textures the area shows, 0 to 1.
    """

    outline: FloatArray
    backscatter: tuple[float, float]
    coarse: float = 0.0
    fine: float = 0.0


@dataclass(frozen=True, eq=False)
class Landscape:
    """Surfaces in the order of painting, and point scatterers.

    `xy` (P, 2) positions; `amplitude` (P, 2) peak amplitudes at the two dates (0 = not there); `phase` (P,) radians;
    `isolated` (P,) bool, True for the targets that stand alone at both dates.
    """

    surfaces: tuple[Surface, ...]
    xy: FloatArray
    amplitude: FloatArray
    phase: FloatArray
    isolated: BoolArray


def turned(xy: ArrayLike, angle: float) -> FloatArray:
    """The points turned about the origin by `angle` radians, from +x towards +y."""
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(np.asarray(xy, dtype=np.float64) @ np.array([[c, s], [-s, c]]), dtype=np.float64)


def rectangle(centre: ArrayLike, length: float, width: float, angle: float) -> FloatArray:
    """(4, 2) corners of a rectangle whose length lies along `angle`."""
    corners = np.array([[-length, -width], [length, -width], [length, width], [-length, width]]) / 2
    return np.asarray(turned(corners, angle) + np.asarray(centre, dtype=np.float64))


def ribbon(path: FloatArray, width: ArrayLike) -> FloatArray:
    """Outline of a band of `width` pixels about an (N, 2) path."""
    along = np.gradient(path, axis=0)
    normal = along[:, ::-1] * [-1, 1] / np.hypot(*along.T)[:, None]
    half = np.broadcast_to(np.asarray(width, dtype=np.float64) / 2, len(path))[:, None]
    return np.concatenate([path + half * normal, (path - half * normal)[::-1]])


def wandering(start: FloatArray, end: FloatArray, sway: float, rng: np.random.Generator) -> FloatArray:
    """(N, 2) smooth path from `start` to `end` that leaves the straight line by about `sway` pixels."""
    t = np.linspace(0, 1, max(8, int(np.hypot(*(end - start)) / 6)))
    waves = np.arange(1, 5)
    parts = rng.standard_normal(4) / waves * np.sin(2 * np.pi * (t[:, None] * waves * 0.9 + rng.random(4)))
    side = (end - start)[::-1] * [-1, 1] / np.hypot(*(end - start))
    path: FloatArray = start + t[:, None] * (end - start) + sway * parts.sum(axis=1)[:, None] * side
    return path


def blob(centre: FloatArray, radius: float, roughness: float, rng: np.random.Generator) -> FloatArray:
    """(96, 2) closed smooth outline about `centre`."""
    angle = np.linspace(0, 2 * np.pi, 96, endpoint=False)
    waves = np.arange(2, 12)
    size = rng.standard_normal(10) * roughness / (0.6 * waves**1.7)
    bumps = 1 + (size * np.cos(angle[:, None] * waves + rng.uniform(0, 2 * np.pi, 10))).sum(axis=1)
    spread = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    outline: FloatArray = centre + radius * np.maximum(bumps, 0.3)[:, None] * spread
    return outline


def clipped(polygon: FloatArray, normal: FloatArray, offset: float) -> FloatArray:
    """The part of a convex polygon where ``normal . p <= offset``; empty where there is none."""
    height = polygon @ normal - offset
    following, next_height = np.roll(polygon, -1, axis=0), np.roll(height, -1)
    kept: list[Any] = []
    for p, q, a, b in zip(polygon, following, height, next_height, strict=True):
        if a <= 0:
            kept.append(p)
        if (a <= 0) != (b <= 0):
            kept.append(p + (q - p) * (a / (a - b)))
    return np.array(kept).reshape(-1, 2)


def area_of(polygon: FloatArray) -> float:
    x, y = polygon.T
    return float(abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2)


def districts(low: FloatArray, high: FloatArray, spacing: float, rng: np.random.Generator) -> list[FloatArray]:
    """Convex Voronoi cells of jittered sites, about `spacing` apart, that tile the box."""
    count = np.maximum(1, np.round((high - low) / spacing)).astype(int)
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in count), indexing="ij"), axis=-1).reshape(-1, 2)
    sites = low + (grid + rng.uniform(0.1, 0.9, grid.shape)) * (high - low) / count
    box = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    cells = []
    for i, site in enumerate(sites):
        cell = box
        order = np.argsort(((sites - site) ** 2).sum(axis=1), kind="stable")
        for other in sites[order[order != i][:24]]:
            normal = other - site
            cell = clipped(cell, normal, float(normal @ (other + site) / 2))
        cells.append(cell)
    return cells


def parcels(district: FloatArray, size: float, rng: np.random.Generator) -> list[FloatArray]:
    """Cut a convex district into fields of about `size` x `size`/2 along one common direction."""
    direction = rng.uniform(0, np.pi)
    axes = turned(np.eye(2), direction)
    waiting, done = [district], []
    while waiting:
        field = waiting.pop()
        extent = np.ptp(field @ axes.T, axis=0)
        if area_of(field) < size**2 * rng.uniform(0.5, 1.6) or extent.max() < size:
            done.append(field)
            continue
        # fields are long: the cut across the first axis comes later than the one across the second
        across = axes[0] if extent[0] > 1.6 * extent[1] else axes[1]
        reach = field @ across
        cut = float(reach.min() + np.ptp(reach) * rng.uniform(0.35, 0.65))
        waiting += [p for p in (clipped(field, across, cut), clipped(field, -across, -cut)) if len(p) > 2]
    return done


def inside(polygon: FloatArray, xy: NDArray[np.float64]) -> BoolArray:
    """(N,) bool, True for the points inside the polygon (even-odd rule)."""
    x, y = xy[:, :1], xy[:, 1:]
    (x0, y0), (x1, y1) = polygon.T, np.roll(polygon, -1, axis=0).T
    rises = y1 - y0
    with np.errstate(divide="ignore", invalid="ignore"):
        crosses = ((y0 > y) != (y1 > y)) & (x < x0 + (y - y0) * (x1 - x0) / rises)
    return np.asarray(crosses.sum(axis=1) % 2 == 1)
