"""Orbits: state vectors, and the satellite's position between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from featreg.errors import InputError
from featreg.types import FloatArray, read_only

#: State vectors around an interval through which its polynomials go, and the least of which each is good enough alone.
NEIGHBOURS, ENOUGH = 8, 6
#: A velocity may differ from what the positions say by so many metres a second; one that does not turn with the Earth
#: differs by hundreds.
ODD_SPEED = 20.0


@dataclass(frozen=True, eq=False)
class Orbit:
    """A satellite's way between state vectors, Earth-fixed.

    Parameters
    ----------
    times : (M,) seconds from any epoch, increasing, M >= 2
    positions : (M, 3) metres
    velocities : (M, 3) metres a second, of the positions as they are given: in the frame that turns with the Earth

    Raises
    ------
    InputError
        Other shapes, values that are not finite, times that do not increase, velocities of another frame.

    Notes
    -----
    In each interval positions go by the polynomial of degree 7 through the eight state vectors nearest to it, and
    velocities by one of their own. With a vector every 10 s that is right to less than 1e-4 m for satellites near the
    Earth, and every 60 s to less than 1e-2 m. Stated velocities differ from the slope of stated positions, by 0.02 m/s
    in annotations of Sentinel-1, and processors compute with what is stated: the direction of zero Doppler that follows
    from one polynomial through both is 0.1 to 0.4 px off the annotation's own grid between the vectors. Of fewer than
    six vectors it is the Hermite polynomial through positions and velocities of all.
    """

    times: FloatArray
    positions: FloatArray
    velocities: FloatArray

    def __post_init__(self) -> None:
        times = np.array(self.times, np.float64)
        where, speed = np.array(self.positions, np.float64), np.array(self.velocities, np.float64)
        good = times.ndim == 1 and len(times) >= 2 and where.shape == speed.shape == (len(times), 3)
        if not good or not all(np.isfinite(part).all() for part in (times, where, speed)):
            raise InputError(
                "an orbit needs at least 2 finite state vectors: times (M,), positions (M, 3) and velocities (M, 3), "
                f"got {times.shape}, {where.shape} and {speed.shape}"
            )
        if not (np.diff(times) > 0).all():
            raise InputError("the times of an orbit's state vectors must increase")
        gaps = np.diff(times)[:, None]
        with np.errstate(all="ignore"):
            odd = np.diff(where, axis=0) / gaps - 0.5 * (speed[1:] + speed[:-1])
            # The mean of two velocities leaves the third derivative of the way out, 0.01 m/s^3 of any low orbit.
            worst = float((np.linalg.norm(odd, axis=1) - 0.002 * gaps[:, 0] ** 2).max())
        if not worst <= ODD_SPEED:
            raise InputError(
                f"the velocities of the orbit differ from its positions by {worst:.0f} m/s; both must be in the frame "
                "that turns with the Earth"
            )
        for name, values in (("times", times), ("positions", where), ("velocities", speed)):
            object.__setattr__(self, name, read_only(values))
        object.__setattr__(self, "_pieces", read_only(_coefficients(times, where, speed)))

    @property
    def pieces(self) -> FloatArray:
        """(M - 1, 6, K) coefficients of each interval for position and velocity: powers of (t - its middle) / its half
        length.
        """
        pieces: FloatArray = self.__dict__["_pieces"]
        return pieces

    def at(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (N, 3) positions and (N, 3) velocities at (N,) times; the outer intervals go on beyond the ends."""
        from featreg.geolocation.range_doppler_kernels import states

        t = np.ascontiguousarray(times, np.float64)
        found = np.empty((len(t), 9))
        states(self.times, self.pieces, t, found)
        return found[:, :3], found[:, 3:6]


def _coefficients(times: FloatArray, positions: FloatArray, velocities: FloatArray) -> FloatArray:
    """The coefficients of `Orbit.pieces`."""
    alone = len(times) >= ENOUGH
    count = min(NEIGHBOURS, len(times))
    powers = np.arange(count if alone else 2 * count)
    out = np.zeros((len(times) - 1, 6, len(powers)))
    for i in range(len(times) - 1):
        first = min(max(i - (count - 2) // 2, 0), len(times) - count)
        rows = slice(first, first + count)
        middle, half = 0.5 * (times[i] + times[i + 1]), 0.5 * (times[i + 1] - times[i])
        u = ((times[rows] - middle) / half)[:, None]
        # From the interval's own position, so that the digits are spent on what changes.
        there = positions[rows] - positions[i]
        if alone:
            out[i] = np.linalg.solve(u**powers, np.concatenate([there, velocities[rows]], axis=1)).T
        else:
            slopes = powers * u ** np.maximum(powers - 1, 0)
            values = np.concatenate([there, velocities[rows] * half])
            out[i, :3] = np.linalg.solve(np.concatenate([u**powers, slopes]), values).T
            out[i, 3:, :-1] = out[i, :3, 1:] * powers[1:] / half
        out[i, :3, 0] += positions[i]
    return out
