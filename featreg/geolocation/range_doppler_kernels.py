"""Loops of the range-Doppler equations over points: states of an orbit, zero-Doppler times, points on the ground.

An orbit is given by its `knots` (M,) in seconds and `pieces` (M - 1, 6, K), see `featreg.geolocation.orbit.Orbit`. A
state is nine numbers: position, velocity, acceleration.
"""

from __future__ import annotations

import math

import numpy as np

from featreg.io.ellipsoid import AXIS, ECCENTRICITY2
from featreg.runtime.jit import compiled
from featreg.types import FloatArray

#: Newton steps before a point counts as not to be found; four are usual.
STEPS = 20
#: Seconds and metres to which the equations are solved: a thousandth of a millimetre on the ground.
CLOSE_S, CLOSE_M = 1e-10, 1e-6


@compiled
def state(knots: FloatArray, pieces: FloatArray, t: float, out: FloatArray) -> None:
    """Write the state at one time to `out` (9,)."""
    low, high = 0, knots.shape[0] - 1
    while high - low > 1:
        middle = (low + high) // 2
        if t < knots[middle]:
            high = middle
        else:
            low = middle
    half = 0.5 * (knots[low + 1] - knots[low])
    u = (t - 0.5 * (knots[low] + knots[low + 1])) / half
    count = pieces.shape[2]
    for axis in range(6):
        value, slope = 0.0, 0.0
        for k in range(count - 1, -1, -1):
            slope = slope * u + value
            value = value * u + pieces[low, axis, k]
        out[axis] = value
        if axis >= 3:
            out[3 + axis] = slope / half


@compiled
def states(knots: FloatArray, pieces: FloatArray, times: FloatArray, out: FloatArray) -> None:
    """Write the states (N, 9) at `times` (N,)."""
    for i in range(times.shape[0]):
        state(knots, pieces, times[i], out[i])


@compiled
def zero_doppler(
    knots: FloatArray, pieces: FloatArray, points: FloatArray, start: float, side: float,
    time: FloatArray, distance: FloatArray,
) -> None:  # fmt: skip
    """Write time and range of closest approach to Earth-fixed points (N, 3).

    Newton's iteration on (P - S(t)) . V(t) = 0 from `start`. NaN where it does not settle, ends beyond the orbit by
    more than its outer interval, or the point lies on the other side of the track than `side` (1 right, -1 left).
    """
    s = np.empty(9)
    last = knots.shape[0] - 1
    earliest, latest = 2.0 * knots[0] - knots[1], 2.0 * knots[last] - knots[last - 1]
    for i in range(points.shape[0]):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        t, settled = start, False
        for _ in range(STEPS):
            state(knots, pieces, t, s)
            dx, dy, dz = px - s[0], py - s[1], pz - s[2]
            off = dx * s[3] + dy * s[4] + dz * s[5]
            slope = dx * s[6] + dy * s[7] + dz * s[8] - s[3] * s[3] - s[4] * s[4] - s[5] * s[5]
            step = off / slope
            t = min(max(t - step, earliest), latest)
            if abs(step) <= CLOSE_S:
                settled = True
                break
        if settled:
            state(knots, pieces, t, s)
            dx, dy, dz = px - s[0], py - s[1], pz - s[2]
            # Right of the track is flight x up.
            across = (
                dx * (s[4] * s[2] - s[5] * s[1]) + dy * (s[5] * s[0] - s[3] * s[2]) + dz * (s[3] * s[1] - s[4] * s[0])
            )
            settled = across * side > 0.0
        time[i] = t if settled else np.nan
        distance[i] = math.sqrt(dx * dx + dy * dy + dz * dz) if settled else np.nan


@compiled
def ground_points(
    knots: FloatArray, pieces: FloatArray, time: FloatArray, distance: FloatArray, height: FloatArray, side: float,
    lonlat: FloatArray,
) -> None:  # fmt: skip
    """Write longitude and latitude (N, 2) in degrees of the points at zero Doppler of a time, a range and a height.

    Newton's iteration in longitude and latitude, whose points lie exactly `height` above the ellipsoid, from the point
    on a sphere under the satellite. NaN where the range does not reach the ground.
    """
    s = np.empty(9)
    for i in range(time.shape[0]):
        lonlat[i, 0] = np.nan
        lonlat[i, 1] = np.nan
        reach, h = distance[i], height[i]
        if not (math.isfinite(time[i]) and math.isfinite(reach) and math.isfinite(h)):
            continue
        state(knots, pieces, time[i], s)
        speed = math.sqrt(s[3] * s[3] + s[4] * s[4] + s[5] * s[5])
        ax, ay, az = s[3] / speed, s[4] / speed, s[5] / speed
        high = math.sqrt(s[0] * s[0] + s[1] * s[1] + s[2] * s[2])
        # Down, upright to the flight, and right of it.
        along = s[0] * ax + s[1] * ay + s[2] * az
        nx, ny, nz = along * ax - s[0], along * ay - s[1], along * az - s[2]
        size = math.sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx / size, ny / size, nz / size
        rx, ry, rz = ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax
        sine = s[2] / high
        sphere = AXIS * (1.0 - 0.5 * ECCENTRICITY2 * sine * sine) + h
        cosine = (high * high + reach * reach - sphere * sphere) / (2.0 * reach * size)
        if cosine > 1.0 and (high - sphere) < reach * 1.01:
            cosine = 1.0 - 1e-6
        if not -1.0 < cosine < 1.0:
            continue
        sine = side * math.sqrt(1.0 - cosine * cosine)
        px = s[0] + reach * (cosine * nx + sine * rx)
        py = s[1] + reach * (cosine * ny + sine * ry)
        pz = s[2] + reach * (cosine * nz + sine * rz)
        lon = math.atan2(py, px)
        lat = math.atan2(pz, math.sqrt(px * px + py * py) * (1.0 - ECCENTRICITY2))
        settled = False
        for _ in range(STEPS):
            sl, cl, sp, cp = math.sin(lon), math.cos(lon), math.sin(lat), math.cos(lat)
            root = 1.0 - ECCENTRICITY2 * sp * sp
            normal = AXIS / math.sqrt(root)
            meridian = normal * (1.0 - ECCENTRICITY2) / root
            dx = (normal + h) * cp * cl - s[0]
            dy = (normal + h) * cp * sl - s[1]
            dz = (normal * (1.0 - ECCENTRICITY2) + h) * sp - s[2]
            now = math.sqrt(dx * dx + dy * dy + dz * dz)
            f = now - reach
            g = dx * ax + dy * ay + dz * az
            # Unit vectors east (-sl, cl, 0) and north (-sp cl, -sp sl, cp), metres as unknowns.
            fe = (-sl * dx + cl * dy) / now
            fn = (-sp * cl * dx - sp * sl * dy + cp * dz) / now
            ge = -sl * ax + cl * ay
            gn = -sp * cl * ax - sp * sl * ay + cp * az
            det = fe * gn - fn * ge
            east = (f * gn - fn * g) / det
            north = (fe * g - f * ge) / det
            lon -= east / ((normal + h) * cp)
            lat -= north / (meridian + h)
            if abs(east) + abs(north) <= CLOSE_M:
                settled = True
                break
        if settled:
            lonlat[i, 0] = math.degrees(lon)
            lonlat[i, 1] = math.degrees(lat)
