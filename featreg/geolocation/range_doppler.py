"""Images located by the orbit of their sensor and the times of their pixels, at zero Doppler."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from featreg.errors import InputError
from featreg.geolocation.orbit import Orbit
from featreg.geolocation.sensor import Sensor, column_of
from featreg.io.ellipsoid import earth_fixed
from featreg.runtime.parameters import check
from featreg.types import FloatArray

#: Speed of light, m/s.
LIGHT = 299_792_458.0
Look = Literal["right", "left"]
#: Metres (three standard errors) by which orbit, timing and atmosphere put a pixel off, where nothing says so.
ACCURACY_M = 15.0
#: Newton steps from slant range to ground range, and metres to which it is solved.
STEPS, CLOSE_M = 12, 1e-7


@dataclass(frozen=True, eq=False)
class GroundRange:
    """Polynomials that take a ground range to a slant range, as Sentinel-1's detected products state them.

    Parameters
    ----------
    spacing : metres of ground range per column
    times : (K,) seconds of zero Doppler at which each polynomial holds, increasing; linear in time between
    origins : (K,) ground range in metres that each polynomial counts from
    coefficients : (K, C) slant range in metres, in powers of (ground range - origin)
    """

    spacing: float
    times: FloatArray
    origins: FloatArray
    coefficients: FloatArray

    def __post_init__(self) -> None:
        times, origins = (
            np.atleast_1d(np.array(self.times, np.float64)),
            np.atleast_1d(np.array(self.origins, np.float64)),
        )
        powers = np.array(self.coefficients, np.float64)
        good = powers.ndim == 2 and powers.shape[1] >= 2 and len(powers) == len(times) == len(origins) >= 1
        if not good or not all(np.isfinite(part).all() for part in (times, origins, powers)):
            raise InputError("ground range needs times (K,), origins (K,) and coefficients (K, C >= 2), all finite")
        if not (np.diff(times) > 0).all() or not float(self.spacing) > 0:
            raise InputError("the times of ground range polynomials must increase, and their spacing be > 0 m")
        for name, values in (("times", times), ("origins", origins), ("coefficients", powers)):
            object.__setattr__(self, name, values)

    def slant(self, columns: FloatArray, time: FloatArray) -> FloatArray:
        """(N,) metres of slant range at (N,) columns and seconds."""
        origin, powers = self._at(time)
        return _polynomial(powers, columns * self.spacing - origin)[0]

    def columns(self, slant: FloatArray, time: FloatArray) -> FloatArray:
        """(N,) columns at (N,) metres of slant range and seconds, by Newton's iteration; NaN where there is none."""
        origin, powers = self._at(time)
        ground = (slant - powers[:, 0]) / powers[:, 1]
        # Near the nadir slant range grows slowly with ground range: the second power gives the start there.
        with np.errstate(all="ignore"):
            bent = powers[:, 1] ** 2 - 4 * (powers[:, 2] if powers.shape[1] > 2 else 0.0) * (powers[:, 0] - slant)
            near = 2 * (slant - powers[:, 0]) / (powers[:, 1] + np.sqrt(bent))
            ground = np.where(np.isfinite(near), near, ground)
            step = np.full(len(ground), np.inf)
            for _ in range(STEPS):
                value, slope = _polynomial(powers, ground)
                step = np.where(np.abs(step) > CLOSE_M, (value - slant) / slope, 0.0)
                ground = ground - step
                if not (np.abs(step) > CLOSE_M).any():
                    break
            ground[~(np.abs(step) <= CLOSE_M)] = np.nan
        return np.asarray((ground + origin) / self.spacing)

    def to_dict(self) -> dict[str, Any]:
        return {
            "spacing": self.spacing,
            "times": self.times.tolist(),
            "origins": self.origins.tolist(),
            "coefficients": self.coefficients.tolist(),
        }

    def _at(self, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N,) origins and (N, C) coefficients at times; those of the ends beyond them."""
        if len(self.times) == 1:
            return np.broadcast_to(self.origins, time.shape), np.broadcast_to(
                self.coefficients, (len(time), self.coefficients.shape[1])
            )
        place = np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, len(self.times) - 2)
        part = np.clip((time - self.times[place]) / (self.times[place + 1] - self.times[place]), 0.0, 1.0)
        origin = self.origins[place] * (1 - part) + self.origins[place + 1] * part
        powers = self.coefficients[place] * (1 - part)[:, None] + self.coefficients[place + 1] * part[:, None]
        return origin, powers


@dataclass(frozen=True, eq=False)
class Bursts:
    """The bursts of a TOPS image, one below the other in its lines, which overlap on the ground.

    Parameters
    ----------
    times : (B,) seconds of zero Doppler of each burst's first line, increasing
    lines : of each burst
    valid : (B, 2) first and last line of each burst that hold data, counted in the burst
    """

    times: FloatArray
    lines: int
    valid: FloatArray

    def __post_init__(self) -> None:
        times, valid = np.array(self.times, np.float64), np.array(self.valid, np.float64)
        if times.ndim != 1 or len(times) < 1 or valid.shape != (len(times), 2) or int(self.lines) < 1:
            raise InputError("bursts need times (B,), lines >= 1 and valid (B, 2)")
        if not np.isfinite(times).all() or not (np.diff(times) > 0).all():
            raise InputError("the times of bursts must increase")
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "lines", int(self.lines))
        object.__setattr__(self, "valid", valid)

    def time(self, rows: FloatArray, interval: float) -> FloatArray:
        """(N,) seconds of (N,) lines of the image."""
        burst = np.clip(np.floor((np.nan_to_num(rows) + 0.5) / self.lines), 0, len(self.times) - 1).astype(int)
        return np.asarray(self.times[burst] + (rows - burst * self.lines) * interval)

    def rows(self, time: FloatArray, interval: float) -> FloatArray:
        """(N,) lines of the image at (N,) seconds: of the burst whose valid lines lie around them most evenly."""
        inside = (time[:, None] - self.times) / interval
        middle, half = self.valid.mean(axis=1), np.maximum(0.5 * np.diff(self.valid, axis=1)[:, 0], 1.0)
        burst = np.argmin(np.nan_to_num(np.abs(inside - middle) / half, nan=np.inf), axis=1)
        return np.asarray(inside[np.arange(len(time)), burst] + burst * self.lines)

    def to_dict(self) -> dict[str, Any]:
        return {"times": self.times.tolist(), "lines": self.lines, "valid": self.valid.tolist()}


@dataclass(frozen=True, eq=False, repr=False)
class RangeDopplerSensor(Sensor):
    """A sensor by the range-Doppler equations: rows are times of zero Doppler, columns are slant or ground range.

    Parameters
    ----------
    times, positions, velocities : state vectors of the orbit, (M,), (M, 3), (M, 3), see `Orbit`
    first_line_time : seconds of zero Doppler at the first row, from the epoch of `times`
    line_interval : seconds per row, not 0; negative where later rows were seen earlier
    near_range : metres of slant range at the first column
    range_spacing : metres of slant range per column, not 0
    shape : (H, W) of the image
    look : "right" or "left" of the flight
    ground_range : in place of `near_range` and `range_spacing`, what `GroundRange` takes
    bursts : in place of `first_line_time`, what `Bursts` takes
    bistatic_range : slant range in metres at which the time of a row is that of zero Doppler, where a processor has
        corrected for the way of the pulse at one range only: elsewhere it is (R - bistatic_range) / c later; None: it
        is the same over the row
    accuracy_m : how far the geolocation may be off on the ground, metres (three standard errors)
    ground_m : metres above the ellipsoid of the ground, taken where nobody states its heights
    epoch : from which the seconds count, for the record

    Raises
    ------
    InputError
        Values that are missing, not finite or impossible.

    Notes
    -----
    Ground to image: the time at which (P - S(t)) . V(t) = 0, by Newton's iteration on the interpolated orbit, then the
    range |P - S|. Image to ground: both equations solved for longitude and latitude at a height above the ellipsoid, by
    Newton's iteration [1]_. Both are exact to 1e-6 m of the model. In the overlap of two bursts a ground point is given
    in one of them, so the map from the ground jumps there.

    References
    ----------
    .. [1] J. C. Curlander, "Location of spaceborne SAR imagery", IEEE Trans. Geosci. Remote Sens. GE-20(3), 1982,
       DOI 10.1109/TGRS.1982.350455
    """

    times: FloatArray
    positions: FloatArray
    velocities: FloatArray
    line_interval: float
    shape: tuple[int, int]
    first_line_time: float = 0.0
    near_range: float = 0.0
    range_spacing: float = 0.0
    look: Look = "right"
    ground_range: GroundRange | None = None
    bursts: Bursts | None = None
    bistatic_range: float | None = None
    accuracy_m: float = ACCURACY_M
    ground_m: float | None = None
    epoch: str = ""

    def __post_init__(self) -> None:
        put = object.__setattr__
        orbit = Orbit(self.times, self.positions, self.velocities)
        for name in ("times", "positions", "velocities"):
            put(self, name, getattr(orbit, name))
        put(self, "_orbit", orbit)
        for name, kind in (("ground_range", GroundRange), ("bursts", Bursts)):
            given = getattr(self, name)
            put(self, name, kind(**given) if isinstance(given, Mapping) else given)
        for name in ("line_interval", "first_line_time", "near_range", "range_spacing", "accuracy_m"):
            value = float(getattr(self, name))
            if not math.isfinite(value):
                raise InputError(f"{name} of a range-Doppler sensor must be finite, got {value}")
            put(self, name, value)
        if self.bistatic_range is not None:
            put(self, "bistatic_range", float(self.bistatic_range))
        if self.ground_m is not None:
            put(self, "ground_m", float(self.ground_m))
        if self.line_interval == 0 or (self.ground_range is None and not (self.near_range > 0 and self.range_spacing)):
            raise InputError(
                "a range-Doppler sensor needs line_interval other than 0 s and, without ground_range, near_range > 0 m "
                f"and range_spacing other than 0 m; got {self.line_interval}, {self.near_range}, {self.range_spacing}"
            )
        height, width = (int(n) for n in self.shape)
        put(self, "shape", (height, width))
        check("look", self.look, Look)
        seen = self._time(np.array([0.0, height - 1.0]))
        # As far as `zero_doppler` looks for a point: an interval beyond either end.
        earliest, latest = 2 * self.times[0] - self.times[1], 2 * self.times[-1] - self.times[-2]
        if not earliest <= seen.min() <= seen.max() <= latest:
            raise InputError(
                f"the image was seen from {seen.min():.6g} to {seen.max():.6g} s, and the state vectors of its orbit "
                f"reach from {self.times[0]:.6g} to {self.times[-1]:.6g} s: they must cover it"
            )

    def __repr__(self) -> str:
        return f"RangeDopplerSensor({self.shape[1]} x {self.shape[0]} px, {len(self.times)} state vectors, {self.look})"

    def ground_to_image(self, lonlat: FloatArray, heights: ArrayLike) -> FloatArray:
        time, slant = self.zero_doppler(lonlat, heights)
        time = time - self._late(slant)
        rows = self._rows(time)
        if self.ground_range is not None:
            return np.column_stack([self.ground_range.columns(slant, time), rows])
        return np.column_stack([(slant - self.near_range) / self.range_spacing, rows])

    def image_to_ground(self, xy: FloatArray, heights: ArrayLike) -> FloatArray:
        from featreg.geolocation.range_doppler_kernels import ground_points

        p = np.asarray(xy, np.float64)
        time, slant = self.time_and_range(p)
        lonlat = np.empty((len(p), 2))
        ground_points(
            self._of.times, self._of.pieces, np.ascontiguousarray(time), np.ascontiguousarray(slant),
            column_of(heights, len(p)), self._side, lonlat,
        )  # fmt: skip
        return lonlat

    def zero_doppler(self, lonlat: FloatArray, heights: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return (N,) seconds and (N,) metres of slant range of closest approach to (N, 2) ground points."""
        from featreg.geolocation.range_doppler_kernels import zero_doppler

        p = np.asarray(lonlat, np.float64)
        points = earth_fixed(p, column_of(heights, len(p)))
        time, slant = np.empty(len(p)), np.empty(len(p))
        middle = float(self._time(np.array([(self.shape[0] - 1) / 2]))[0])
        zero_doppler(self._of.times, self._of.pieces, points, middle, self._side, time, slant)
        return time, slant

    def time_and_range(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (N,) seconds of zero Doppler and (N,) metres of slant range of (N, 2) image points."""
        time = self._time(xy[:, 1])
        if self.ground_range is not None:
            slant = self.ground_range.slant(xy[:, 0], time)
        else:
            slant = self.near_range + xy[:, 0] * self.range_spacing
        return time + self._late(slant), slant

    @property
    def uncertainty_px(self) -> float:
        size = min(self.pixel_size(self.ground_m or 0.0))
        return self.accuracy_m / size if math.isfinite(size) and size > 0 else self.accuracy_m

    @property
    def level(self) -> float | None:
        return self.ground_m

    @property
    def centre(self) -> tuple[float, float]:
        return (self.shape[1] - 1) / 2, (self.shape[0] - 1) / 2

    def to_dict(self) -> dict[str, Any]:
        return {
            "type": "range-doppler",
            "times": self.times.tolist(),
            "positions": self.positions.tolist(),
            "velocities": self.velocities.tolist(),
            "first_line_time": self.first_line_time,
            "line_interval": self.line_interval,
            "near_range": self.near_range,
            "range_spacing": self.range_spacing,
            "shape": list(self.shape),
            "look": self.look,
            "ground_range": None if self.ground_range is None else self.ground_range.to_dict(),
            "bursts": None if self.bursts is None else self.bursts.to_dict(),
            "bistatic_range": self.bistatic_range,
            "accuracy_m": self.accuracy_m,
            "ground_m": self.ground_m,
            "epoch": self.epoch,
        }

    @property
    def _of(self) -> Orbit:
        orbit: Orbit = self.__dict__["_orbit"]
        return orbit

    @property
    def _side(self) -> float:
        return 1.0 if self.look == "right" else -1.0

    def _time(self, rows: FloatArray) -> FloatArray:
        if self.bursts is not None:
            return self.bursts.time(rows, self.line_interval)
        return np.asarray(self.first_line_time + rows * self.line_interval)

    def _late(self, slant: FloatArray) -> FloatArray | float:
        """Seconds from the time of a row to zero Doppler at (N,) slant ranges."""
        return 0.0 if self.bistatic_range is None else (slant - self.bistatic_range) / LIGHT

    def _rows(self, time: FloatArray) -> FloatArray:
        if self.bursts is not None:
            return self.bursts.rows(time, self.line_interval)
        return np.asarray((time - self.first_line_time) / self.line_interval)


def _polynomial(powers: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(N,) values and slopes of (N, C) polynomials at (N,) places."""
    value, slope = np.zeros(len(at)), np.zeros(len(at))
    for k in range(powers.shape[1] - 1, -1, -1):
        slope = slope * at + value
        value = value * at + powers[:, k]
    return value, slope
