"""What stands in a simulated landscape: fields, woods, water, roads, towns, targets, and what changes between dates."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from featreg.simulate.landscape import (
    ASPHALT,
    LOOK,
    SHADOW,
    WATER,
    Landscape,
    Surface,
    blob,
    districts,
    inside,
    parcels,
    rectangle,
    ribbon,
    turned,
    wandering,
)
from featreg.types import BoolArray, FloatArray

#: Kinds of town quarters: mean length and depth of a house, gap to the next one, width of a street, in pixels.
QUARTERS = ((8.0, 6.0, 4.0, 9.0), (9.0, 7.0, 6.0, 8.0), (22.0, 8.0, 7.0, 12.0), (26.0, 15.0, 8.0, 12.0))
#: Pixels around a lone target that must be free of other point targets.
CLEARANCE = 14.0


@dataclass(eq=False)
class _Builder:
    """Collects the parts of one landscape; `share` of the objects of every kind differs between the two dates."""

    low: FloatArray
    high: FloatArray
    share: float
    rng: np.random.Generator
    surfaces: list[Surface] = field(default_factory=list)
    points: list[tuple[float, float, float, float]] = field(default_factory=list)
    lone: list[int] = field(default_factory=list)
    built_up: list[FloatArray] = field(default_factory=list)
    water: list[FloatArray] = field(default_factory=list)
    roads: list[FloatArray] = field(default_factory=list)

    def paint(
        self, outline: FloatArray, before: float, after: float | None = None, coarse: float = 0.0, fine: float = 0.0
    ) -> None:
        self.surfaces.append(Surface(outline, (before, before if after is None else after), coarse, fine))

    def scatterer(self, xy: FloatArray, before: float, after: float) -> None:
        self.points.append((float(xy[0]), float(xy[1]), before, after))

    def changing(self, count: int) -> BoolArray:
        """(count,) bool, True for the share of the objects that changes."""
        flags = np.zeros(count, dtype=bool)
        flags[self.rng.permutation(count)[: round(self.share * count)]] = True
        return flags

    def farmland(self) -> None:
        rng = self.rng
        quarters = districts(self.low, self.high, 210, rng)
        fields = [f for quarter in quarters for f in parcels(quarter, 54, rng)]
        for outline, changes in zip(fields, self.changing(len(fields)), strict=True):
            before = float(np.clip(0.8 * np.exp(0.75 * rng.standard_normal()), 0.12, 3.5))
            step = 10 ** (rng.uniform(0.3, 0.7) * (1 if before < 0.7 else -1)) if changes else 1.0
            self.paint(outline, before, before * step, coarse=rng.uniform(0.2, 0.7), fine=rng.uniform(0.0, 0.25))
        for outline in fields:
            start = rng.integers(len(outline))
            edge = np.array([outline[start], outline[(start + 1) % len(outline)]])
            if rng.random() < 0.3:  # a hedge: bright towards the radar, a shadow behind it
                self.paint(ribbon(edge + 2.0 * LOOK, 3.0), SHADOW + 0.1)
                self.paint(ribbon(edge, 2.0), rng.uniform(2.0, 5.0), fine=0.8)
        for outline in quarters:
            for edge in np.stack([outline, np.roll(outline, -1, axis=0)], axis=1):
                self.paint(ribbon(edge, 2.6), 3 * ASPHALT)

    def river(self, centre: FloatArray, unit: float, reach: float) -> FloatArray:
        along = turned([1.0, 0.0], self.rng.uniform(0, 2 * np.pi))
        offset = self.rng.uniform(-0.15, 0.15) * unit * along[::-1] * [-1, 1]
        path = wandering(
            centre + offset - 1.5 * reach * along, centre + offset + 1.5 * reach * along, 0.1 * unit, self.rng
        )
        t = np.linspace(0, 1, len(path))
        waves = np.sin(2 * np.pi * (t * 5 + self.rng.random())) + 0.6 * np.sin(2 * np.pi * (t * 13 + self.rng.random()))
        outline = ribbon(path, max(7.0, 0.045 * unit) * (1 + 0.2 * waves))
        self.shore(outline)
        return path

    def shore(self, outline: FloatArray) -> None:
        self.paint(outline, WATER)
        self.water.append(outline)

    def wood(self, centre: FloatArray, radius: float) -> None:
        outline = blob(centre, radius, 0.5, self.rng)
        self.paint(outline + 7.0 * LOOK, SHADOW + 0.03)
        self.paint(outline, 4.0, fine=0.6)
        self.paint(outline + 3.0 * LOOK, 1.5, coarse=0.3, fine=1.0)
        self.built_up.append(outline)

    def road(self, anchor: FloatArray, reach: float, width: float) -> None:
        along = 2.2 * reach * turned([1.0, 0.0], self.rng.uniform(0, np.pi))
        path = wandering(anchor - along, anchor + along, 8.0, self.rng)
        self.paint(ribbon(path, width), ASPHALT)
        wet = np.any([inside(outline, path) for outline in self.water], axis=0)
        for run in np.split(np.arange(len(path)), np.flatnonzero(np.diff(wet)) + 1):
            if wet[run[0]] and len(run) > 1:  # a bridge: its rails stand out of the water
                deck = path[max(run[0] - 2, 0) : run[-1] + 3]
                self.paint(ribbon(deck, width + 3.0), 12.0)
                self.paint(ribbon(deck, width), 0.3)
        self.roads.append(path)

    def town(self, centre: FloatArray, radius: float) -> None:
        """Quarters of one kind of house each, in rows along streets."""
        rng = self.rng
        outline = blob(centre, radius, 0.25, rng)
        self.built_up.append(outline)
        self.paint(outline, 0.6, coarse=0.3, fine=0.8)
        sites: list[tuple[FloatArray, float, float, float]] = []
        main = rng.uniform(-0.5, 0.5) + np.pi / 2
        for quarter in districts(centre - 1.4 * radius, centre + 1.4 * radius, max(50.0, 0.75 * radius), rng):
            direction = main + 0.25 * rng.standard_normal()
            sites += self.rows(quarter, outline, direction, QUARTERS[rng.integers(len(QUARTERS))])
            for edge in np.stack([quarter, np.roll(quarter, -1, axis=0)], axis=1):
                street = edge[0] + np.linspace(0, 1, 40)[:, None] * (edge[1] - edge[0])
                street = street[inside(outline, street)]
                if len(street) > 3:
                    self.paint(ribbon(street[[0, -1]], 5.0), ASPHALT)
        sites.sort(key=lambda site: float(site[0] @ LOOK))  # far walls stand in front of near shadows
        for (at, length, depth, direction), changes in zip(sites, self.changing(len(sites)), strict=True):
            here = (1.0, 0.0)[:: rng.choice([-1, 1])] if changes else (1.0, 1.0)
            self.building(at, length, depth, direction, rng.uniform(2.0, 0.8 * depth), (here[0], here[1]))

    def rows(
        self, quarter: FloatArray, outline: FloatArray, direction: float, kind: tuple[float, float, float, float]
    ) -> list[tuple[FloatArray, float, float, float]]:
        """(centre, length, depth, direction) of the houses of one convex quarter, as far as it lies inside the town."""
        rng = self.rng
        length, depth, gap, street = kind
        along, across = turned(np.eye(2), direction)
        middle, reach = quarter.mean(axis=0), np.ptp(quarter, axis=0).max()
        sites = []
        offset = -reach
        while offset < reach:
            offset += depth + (street if rng.random() < 0.6 else 4.0) + rng.uniform(0, 4)
            position = -reach
            while position < reach:
                long = length * rng.uniform(0.6, 1.5)
                at = middle + (offset + rng.uniform(-0.7, 0.7)) * across + (position + long / 2) * along
                corners = rectangle(at, long + 3, depth + 3, direction)
                if rng.random() < 0.85 and (inside(quarter, corners) & inside(outline, corners)).all():
                    sites.append((at, long, depth * rng.uniform(0.8, 1.2), direction))
                position += long + gap * rng.uniform(0.5, 2.0)
        return sites

    def building(
        self,
        at: FloatArray,
        length: float,
        depth: float,
        direction: float,
        height: float,
        here: tuple[float, float],
    ) -> None:
        """A block with its shadow, its roof and the double bounce of the walls that the radar sees: an L."""
        import cv2

        rng = self.rng
        walls = rectangle(at, length, depth, direction)

        def standing(value: float) -> tuple[float, float]:
            return (value if here[0] else np.nan, value if here[1] else np.nan)

        swept = np.concatenate([walls, walls + height * LOOK]).astype(np.float32)
        self.paint(cv2.convexHull(swept)[:, 0].astype(np.float64), *standing(SHADOW))
        self.paint(walls, *standing(rng.uniform(0.5, 1.5)), fine=0.5)
        strength = 55 * np.exp(0.8 * rng.standard_normal())
        for a, b in zip(walls, np.roll(walls, -1, axis=0), strict=True):
            outward = (b - a)[::-1] * [1, -1] / np.hypot(*(b - a))
            facing = float(-outward @ LOOK)
            if facing > 0.2:
                self.paint(ribbon(np.array([a, b]), 1.4), *standing(strength * facing**4))
        if rng.random() < 0.5:
            corner = walls[np.argmin(walls @ LOOK)]
            bright = float(np.clip(14 * np.exp(0.6 * rng.standard_normal()), 4, 60))
            self.scatterer(corner, bright * here[0], bright * here[1])

    def movers(self, places: FloatArray, amplitude: float) -> None:
        """Vehicles: each stands at one place at the first date and at another at the second, if anything changes."""
        half = len(places) // 2
        for before, after in zip(places[:half], places[half : 2 * half], strict=True):
            bright = amplitude * self.rng.uniform(0.6, 1.4)
            if self.share > 0:
                self.scatterer(before, bright, 0.0)
                self.scatterer(after, 0.0, bright)
            else:
                self.scatterer(before, bright, bright)

    def traffic(self) -> None:
        rng = self.rng
        for path in self.roads:
            on_view = path[((path > self.low) & (path < self.high)).all(axis=1)]
            count = 2 * (len(on_view) // 40)
            self.movers(rng.permutation(on_view)[:count] + rng.uniform(-1, 1, (count, 2)), 7.0)
        tries = rng.uniform(self.low, self.high, (int(np.prod((self.high - self.low) / 60)), 2))
        afloat = np.any([inside(outline, tries) for outline in self.water], axis=0)
        self.movers(tries[afloat], 22.0)

    def targets(self, count: int) -> None:
        """Lone point targets in the open: poles, pylons, reflectors."""
        rng = self.rng
        places = rng.uniform(self.low, self.high, (count, 2))
        start, along = rng.uniform(self.low, self.high), 45 * turned([1.0, 0.0], rng.uniform(0, 2 * np.pi))
        places = np.concatenate([places, start + np.arange(-30, 30)[:, None] * along])
        places = places[((places > self.low) & (places < self.high)).all(axis=1)]
        taken = [inside(outline, places) for outline in self.built_up + self.water]
        places = places[~np.any(taken, axis=0)]
        for place, changes in zip(places, self.changing(len(places)), strict=True):
            bright = float(np.exp(rng.uniform(np.log(15), np.log(55))))
            gone = rng.random() < 0.5
            if not changes:
                self.lone.append(len(self.points))
            self.scatterer(place, 0.0 if changes and gone else bright, 0.0 if changes and not gone else bright)

    def finish(self) -> Landscape:
        table = np.array(self.points, dtype=np.float64).reshape(-1, 4)
        xy = table[:, :2]
        isolated = np.zeros(len(table), dtype=bool)
        for i in self.lone:
            isolated[i] = (np.hypot(*(xy - xy[i]).T) < CLEARANCE).sum() == 1
        phase = self.rng.uniform(0, 2 * np.pi, len(table))
        return Landscape(tuple(self.surfaces), xy, table[:, 2:], phase, isolated)


def countryside(shape: tuple[int, int], reach: float, change: float, rng: np.random.Generator) -> Landscape:
    """Lay out farmland with woods, a river, lakes, roads, towns and point targets.

    Parameters
    ----------
    shape : (H, W) of the view around which things are placed; its first pixel's centre is (0, 0)
    reach : half side in pixels of the square, centred on the view, that is filled
    change : share of the fields, buildings and point targets that differ between the two dates, 0 to 1; vehicles
        move whenever it is not 0
    rng : source of the randomness
    """
    size = np.array(shape[::-1], dtype=np.float64)
    centre = (size - 1) / 2
    scene = _Builder(centre - reach, centre + reach, change, rng)
    tiles = np.maximum(1, np.round(size / 600)).astype(int)
    unit = float((size / tiles).min())
    scene.farmland()
    river = scene.river(centre, unit, reach)
    occupied = [(point, 0.04 * unit) for point in river]
    for tile in np.ndindex(*tiles):
        low = np.array(tile) * size / tiles
        centres = {}
        for kind, radius in (("town", 0.19), ("wood", 0.13), ("lake", 0.085), ("grove", 0.07)):
            tries = low + rng.uniform(radius, 1 - radius, (60, 2)) * size / tiles
            room = np.min([np.hypot(*(tries - at).T) - taken for at, taken in occupied], axis=0)
            centres[kind] = tries[np.argmax(np.minimum(room, 1.3 * radius * unit))], radius * unit
            occupied.append(centres[kind])
        scene.wood(*centres["wood"])
        scene.wood(*centres["grove"])
        scene.shore(blob(*centres["lake"], 0.45, rng))
        scene.road(centres["town"][0], reach, 4.5)
        scene.road(low + rng.uniform(0.2, 0.8, 2) * size / tiles, reach, 3.5)
        scene.town(*centres["town"])
    scene.traffic()
    scene.targets(int((2 * reach) ** 2 / 110**2))
    return scene.finish()
