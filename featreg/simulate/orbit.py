"""A satellite that images side-looking on a circular orbit, and a smooth made-up terrain: exact geometry of scenes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from featreg.geolocation.heights import Heights
from featreg.geolocation.range_doppler import RangeDopplerSensor
from featreg.geolocation.rpc import RpcSensor
from featreg.geolocation.rpc_fit import fitted, lattice
from featreg.geolocation.sensor import METRES_PER_DEGREE, Sensor, column_of, wrapped
from featreg.io.ellipsoid import earth_fixed
from featreg.types import FloatArray

#: Radius of the orbit, metres (about 514 km above the ground).
ORBIT = 6_885_000.0
#: Radians a second along it, and seconds between the state vectors that describe it.
RATE, EVERY = 1.105e-3, 10.0
#: Lattice of image points and heights through which an RPC is fitted, and how far beyond the image, as a share of it.
NODES, BEYOND = (21, 21, 7), 0.08


@dataclass(frozen=True, eq=False)
class RangeDoppler(Sensor):
    """Zero-Doppler geometry of a circular orbit over an Earth that does not turn; x is slant range, y is flight.

    Parameters
    ----------
    toward, along : (3,) unit vectors of the orbit's plane: to the satellite at the middle line, and its flight then
    middle : (x, y) image point of `distance` and of the satellite at `toward`
    distance : slant range in metres at `middle`
    spacing : metres of slant range per column, radians of flight per line
    centre_lonlat : degrees, of the ground at the middle
    """

    toward: tuple[float, float, float]
    along: tuple[float, float, float]
    middle: tuple[float, float]
    distance: float
    spacing: tuple[float, float]
    centre_lonlat: tuple[float, float]

    @classmethod
    def over(
        cls,
        lonlat: tuple[float, float],
        shape: tuple[int, int],
        *,
        incidence_deg: float,
        heading_deg: float,
        pixel: float,
        height: float = 0.0,
        shift: tuple[float, float] = (0.0, 0.0),
    ) -> Self:
        """Return the right-looking sensor of an image of (H, W) pixels of `pixel` metres about a ground point.

        `shift` moves the image point of the ground point away from the image centre, px.
        """
        place = np.array([lonlat])
        ground = earth_fixed(place, np.array([height]))[0]
        east, north, up = _axes(lonlat)
        heading, incidence = math.radians(heading_deg), math.radians(incidence_deg)
        right = math.cos(heading) * east - math.sin(heading) * north
        sight = math.cos(incidence) * up - math.sin(incidence) * right
        # The satellite lies where the line of sight reaches the orbit's sphere.
        half = float(ground @ sight)
        distance = -half + math.sqrt(half * half + ORBIT**2 - float(ground @ ground))
        satellite = ground + distance * sight
        along = np.cross(satellite, sight)
        along /= np.linalg.norm(along)
        along *= math.copysign(1.0, float(along @ (math.sin(heading) * east + math.cos(heading) * north)))
        toward = satellite / np.linalg.norm(satellite)
        spacing = pixel * math.sin(incidence), pixel / float(ground @ toward)
        middle = (shape[1] - 1) / 2 + shift[0], (shape[0] - 1) / 2 + shift[1]
        return cls(_triple(toward), _triple(along), middle, distance, spacing, lonlat)

    def ground_to_image(self, lonlat: FloatArray, heights: ArrayLike) -> FloatArray:
        p = earth_fixed(lonlat, column_of(heights, len(lonlat)))
        a, b = p @ np.array(self.toward), p @ np.array(self.along)
        # Closest approach of a circle to a point: the satellite over the point's projection onto the orbit's plane.
        reach = np.sqrt(np.einsum("ij,ij->i", p, p) + ORBIT**2 - 2.0 * ORBIT * np.hypot(a, b))
        return np.column_stack(
            [
                (reach - self.distance) / self.spacing[0] + self.middle[0],
                np.arctan2(b, a) / self.spacing[1] + self.middle[1],
            ]
        )

    def image_to_ground(self, xy: FloatArray, heights: ArrayLike) -> FloatArray:
        wanted = np.asarray(xy, np.float64)
        level = column_of(heights, len(wanted))
        found = np.tile(np.array(self.centre_lonlat), (len(wanted), 1))
        step = 1e-4
        aside, ahead = np.array([step, 0.0]), np.array([0.0, step])
        for _ in range(12):
            now = self.ground_to_image(found, level)
            off = wanted - now
            east = (self.ground_to_image(found + aside, level) - now) / step
            north = (self.ground_to_image(found + ahead, level) - now) / step
            det = east[:, 0] * north[:, 1] - north[:, 0] * east[:, 1]
            found[:, 0] += (north[:, 1] * off[:, 0] - north[:, 0] * off[:, 1]) / det
            found[:, 1] += (east[:, 0] * off[:, 1] - east[:, 1] * off[:, 0]) / det
            if not (np.abs(off) > 1e-9).any():
                break
        found[:, 0] = wrapped(found[:, 0])
        return found

    def rpc(self, shape: tuple[int, int], low: float, high: float, error_m: float) -> RpcSensor:
        """Return the RPC fitted over an image of (H, W) and heights from `low` to `high` metres."""
        size = np.array(shape[::-1], np.float64)
        unit = lattice(*(np.cos(np.pi * (np.arange(n) + 0.5) / n) for n in NODES))
        xy = (size - 1) / 2 + unit[:, :2] * size * (0.5 + BEYOND)
        level = 0.5 * (low + high) + 0.5 * (high - low) * unit[:, 2]
        ground = self.image_to_ground(xy, level)
        # One run of longitudes also where the scene lies across the antimeridian.
        ground[:, 0] = self.centre_lonlat[0] + wrapped(ground[:, 0] - self.centre_lonlat[0])
        frame: dict[str, float] = {}
        for name, values in (("samp", xy[:, 0]), ("line", xy[:, 1]), ("long", ground[:, 0]), ("lat", ground[:, 1])):
            frame[f"{name}_off"] = float(0.5 * (values.min() + values.max()))
            frame[f"{name}_scale"] = float(0.5 * np.ptp(values))
        frame |= {"height_off": 0.5 * (low + high), "height_scale": 0.5 * (high - low)}
        return RpcSensor(
            fitted(np.column_stack([ground, level]), xy, frame, errors={"err_bias": error_m, "err_rand": 1.0})
        )

    def sensor(self, shape: tuple[int, int], level: float) -> RangeDopplerSensor:
        """Return the same geometry as a product states it: state vectors every 10 s, timing and range.

        `shape` is the image's (H, W), `level` the height of the ground in metres that it states.
        """
        interval = self.spacing[1] / RATE
        first = -self.middle[1] * interval
        steps = np.arange(math.floor(first / EVERY) - 4, math.ceil((first + shape[0] * interval) / EVERY) + 5)
        times = np.asarray(steps * EVERY, np.float64)
        s, c = np.sin(RATE * times)[:, None], np.cos(RATE * times)[:, None]
        toward, along = np.array(self.toward), np.array(self.along)
        return RangeDopplerSensor(
            times, ORBIT * (c * toward + s * along), ORBIT * RATE * (c * along - s * toward), interval, shape,
            first_line_time=first, near_range=self.distance - self.middle[0] * self.spacing[0],
            range_spacing=self.spacing[0], ground_m=level,
        )  # fmt: skip

    @property
    def uncertainty_px(self) -> float:
        return 0.0

    @property
    def centre(self) -> tuple[float, float]:
        return self.middle

    def to_dict(self) -> dict[str, Any]:
        return {
            "type": "range-doppler",
            "toward": list(self.toward),
            "along": list(self.along),
            "middle": list(self.middle),
            "distance": self.distance,
            "spacing": list(self.spacing),
            "centre_lonlat": list(self.centre_lonlat),
        }


@dataclass(frozen=True, eq=False)
class Terrain(Heights):
    """Smooth hills: a sum of plane waves of the ground plane.

    Parameters
    ----------
    origin : longitude and latitude in degrees of the plane's origin
    level : mean height, metres
    waves : (K, 4) metres of amplitude, cycles per metre east and north, phase in radians
    """

    origin: tuple[float, float]
    level: float
    waves: FloatArray

    @classmethod
    def made(
        cls, origin: tuple[float, float], level: float, relief: float, extent: float, rng: np.random.Generator
    ) -> Self:
        """Return hills that reach at most `relief` metres from lowest to highest, over `extent` metres of ground."""
        cycles = np.array([0.8, 1.3, 1.9, 2.7, 3.6]) / extent
        direction = rng.uniform(0, 2 * np.pi, len(cycles))
        amplitude = cycles**-0.7
        amplitude *= 0.5 * relief / amplitude.sum()
        waves = [
            amplitude,
            cycles * np.cos(direction),
            cycles * np.sin(direction),
            rng.uniform(0, 2 * np.pi, len(cycles)),
        ]
        return cls(origin, level, np.column_stack(waves))

    def at(self, lonlat: FloatArray) -> FloatArray:
        metres = plane_metres(lonlat, self.origin)
        phase = 2 * np.pi * (metres @ self.waves[:, 1:3].T) + self.waves[:, 3]
        return np.asarray(self.level + np.cos(phase) @ self.waves[:, 0])

    def to_dict(self) -> dict[str, Any]:
        return {"type": "terrain", "origin": list(self.origin), "level": self.level, "waves": self.waves.tolist()}


def plane_metres(lonlat: FloatArray, origin: tuple[float, float]) -> FloatArray:
    """(N, 2) metres east and north of `origin` on a plane that is linear in longitude and latitude."""
    p = np.asarray(lonlat, np.float64)
    scale = METRES_PER_DEGREE * np.array([math.cos(math.radians(origin[1])), 1.0])
    return np.asarray(np.column_stack([wrapped(p[:, 0] - origin[0]), p[:, 1] - origin[1]]) * scale)


def _axes(lonlat: tuple[float, float]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """East, north and up at a ground point, Earth-fixed."""
    lon, lat = math.radians(lonlat[0]), math.radians(lonlat[1])
    east = np.array([-math.sin(lon), math.cos(lon), 0.0])
    up = np.array([math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)])
    return east, np.cross(up, east), up


def _triple(vector: FloatArray) -> tuple[float, float, float]:
    x, y, z = vector.tolist()
    return x, y, z
