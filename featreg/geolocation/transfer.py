"""From the pixels of one image to those of another, over the ground."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from featreg.geolocation.elevation_model import DemHeights
from featreg.geolocation.heights import ConstantHeight, Heights
from featreg.geolocation.rpc import RpcSensor
from featreg.geolocation.sensor import Sensor
from featreg.geometry.base import DerivedModel
from featreg.types import BoolArray, FloatArray

#: Heights count as found to this many metres.
CLOSE_M = 1e-5
#: Plain rounds before the crossing is bracketed, and rounds of the bracketing.
PLAIN, BRACKETED = 6, 80
#: No ground lies outside these heights in metres.
LOWEST, HIGHEST = -1000.0, 9500.0
#: So many metres above and below the start of a search its ground is looked for in one part of the elevation model.
RELIEF = 1000.0
#: Fewer points than this are not worth a part of the model each when they do not fit in one together.
FEWEST = 32


@dataclass(frozen=True, eq=False)
class Transfer(DerivedModel):
    """Reference pixels -> secondary pixels by both sensors' geometry and the heights of the ground.

    Parameters
    ----------
    reference, secondary : the sensors of the two images
    heights : of the ground

    Notes
    -----
    The line of sight of a reference pixel is a function lonlat(h); its point on the ground has h = DEM(lonlat(h)),
    sought as in section 2.1 of [1]_: Eq. 1 (image to ground at a height, here by inverting Eq. 2, because the forward
    coefficients are rarely delivered) and the DEM in turn, until the height stands still to 1e-5 m. Departures: after
    the first round secants are taken, as long as each leaves at most half of the gap h - DEM(lonlat(h)); points where
    they do not start again by plain rounds, and where these have not settled after six (slopes as steep as the line of
    sight), the gap is bracketed and its crossing found by regula falsi (Illinois), which always ends. A point whose
    ground is not found is NaN.

    Where the ground lies over, the line of sight crosses it more than once. The point is given the crossing to which
    this search leads from the height of the ground at the image's centre, which need be neither the highest nor the
    nearest one. It depends on the point, the sensor and the heights alone, not on the other points that are asked.

    References
    ----------
    .. [1] "SAR image matching based on SAR-ORB", section 2.1 (Eq. 1, 2)
    """

    reference: Sensor
    secondary: Sensor
    heights: Heights
    instead: ClassVar[str] = "the sensors give it; fit an RpcBias on top of it"

    def __call__(self, xy: ArrayLike) -> FloatArray:
        p = np.asarray(xy, np.float64)
        flat = p.reshape(-1, 2)
        lonlat, heights = on_ground(self.reference, flat, self.heights)
        return self.secondary.ground_to_image(lonlat, heights).reshape(p.shape)

    @property
    def inverse(self) -> Transfer:
        """Secondary -> reference, the heights sought along the secondary's lines of sight."""
        return Transfer(self.secondary, self.reference, self.heights)

    @property
    def parameters(self) -> Mapping[str, Any]:
        return {
            "reference": self.reference.to_dict(),
            "secondary": self.secondary.to_dict(),
            "heights": self.heights.to_dict(),
        }


def on_ground(sensor: Sensor, xy: FloatArray, heights: Heights) -> tuple[FloatArray, FloatArray]:
    """Return where (N, 2) image points lie: (N, 2) longitude and latitude, and (N,) heights; NaN where not found."""
    if isinstance(heights, ConstantHeight):
        level = np.full(len(xy), heights.metres)
        return sensor.image_to_ground(xy, level), level
    start = _start(sensor, heights)
    if type(sensor) is RpcSensor and isinstance(heights, DemHeights) and heights.in_degrees:
        return _by_secants(sensor, xy, heights, start)
    return by_rounds(sensor, xy, heights, start)


def _by_secants(sensor: RpcSensor, xy: FloatArray, heights: DemHeights, start: float) -> tuple[FloatArray, FloatArray]:
    """`on_ground` by compiled loops over a part of the elevation model, for the points where secants close in."""
    known = np.flatnonzero(np.isfinite(xy).all(axis=1))
    lonlat, level = np.full((len(xy), 2), np.nan), np.full(len(xy), np.nan)
    if not len(known):
        return lonlat, level
    # The part is that on which all lies between the corners of what is asked, at any height around.
    ends = np.array([xy[known].min(axis=0), xy[known].max(axis=0)])
    corners = np.array([[x, y] for x in ends[:, 0] for y in ends[:, 1]] * 2)
    patch = heights.patch(sensor.image_to_ground(corners, np.repeat([start - RELIEF, start + RELIEF], 4)))
    if patch is None:
        # Each half needs a smaller part.
        along = int(np.argmax(ends[1] - ends[0]))
        first = xy[known, along] < ends[:, along].mean()
        if len(known) < FEWEST or not first.any():
            return by_rounds(sensor, xy, heights, start)
        for half in (known[first], known[~first]):
            lonlat[half], level[half] = _by_secants(sensor, xy[half], heights, start)
        return lonlat, level
    lonlat, level, found = sensor.on_patch(xy, patch, start, CLOSE_M)
    left = known[~found[known]]
    if len(left):
        lonlat[left], level[left] = by_rounds(sensor, xy[left], heights, start)
    return lonlat, level


def by_rounds(sensor: Sensor, xy: FloatArray, heights: Heights, start: float) -> tuple[FloatArray, FloatArray]:
    """`on_ground` for any sensor and heights, from a height at which every search starts."""
    level, found = _secants(sensor, xy, heights, start)
    left = np.flatnonzero(~found)
    if len(left):
        level[left] = _plain(sensor, xy[left], heights, start)
    return sensor.image_to_ground(xy, level), level


def _secants(sensor: Sensor, xy: FloatArray, heights: Heights, start: float) -> tuple[FloatArray, BoolArray]:
    """(N,) heights by the rule of `featreg.geolocation.ground_kernels.ground_of`, and which of them are found.

    Which crossing a point is given must not depend on whether it was asked with others that lie in one part of the
    elevation model, so that both ways take the same steps.
    """
    from featreg.geolocation.ground_kernels import ROUNDS, SHRINKING

    level, found = np.full(len(xy), start), np.zeros(len(xy), np.bool_)
    before, gap = level.copy(), np.full(len(xy), np.nan)
    open_ = np.arange(len(xy))
    for turn in range(ROUNDS):
        here = level[open_]
        now = heights.at(sensor.image_to_ground(xy[open_], here)) - here
        done = np.abs(now) <= CLOSE_M
        step = now
        if turn:
            with np.errstate(divide="ignore", invalid="ignore"):
                step = np.where(done, now, -now * (here - before[open_]) / (now - gap[open_]))
        found[open_[done]] = True
        closing = np.isfinite(now) if not turn else np.abs(now) <= SHRINKING * np.abs(gap[open_])
        keep = done | closing
        before[open_], gap[open_] = here, now
        level[open_[keep]] = (here + step)[keep]
        open_ = open_[closing & ~done]
        if not len(open_):
            break
    return level, found


def _plain(sensor: Sensor, xy: FloatArray, heights: Heights, start: float) -> FloatArray:
    """(N,) heights by plain rounds from `start`, and by bracketing where these do not settle; NaN where not found."""
    level = heights.at(sensor.image_to_ground(xy, start))
    low, high = np.full(len(xy), LOWEST), np.full(len(xy), HIGHEST)
    over, under = np.full(len(xy), np.nan), np.full(len(xy), np.nan)
    open_ = np.flatnonzero(np.isfinite(level))
    for _ in range(PLAIN):
        if not len(open_):
            break
        now = level[open_]
        found = heights.at(sensor.image_to_ground(xy[open_], now))
        _narrow(low, high, over, under, open_, now, found - now)
        level[open_] = found
        open_ = open_[np.abs(found - now) > CLOSE_M]
    if len(open_):
        level[open_] = _bracketed(sensor, xy[open_], heights, low[open_], high[open_], over[open_], under[open_])
    return level


def _start(sensor: Sensor, heights: Heights) -> float:
    """The height of the ground at the sensor's centre, about, so that no search begins far off the image."""

    def find() -> float:
        level = np.zeros(1)
        for _ in range(3):
            level = np.nan_to_num(heights.at(sensor.image_to_ground(np.array([sensor.centre]), level)))
        return float(level[0])

    return heights.start(sensor, find) if isinstance(heights, DemHeights) else find()


def _narrow(
    low: FloatArray,
    high: FloatArray,
    over: FloatArray,
    under: FloatArray,
    rows: NDArray[np.int64],
    level: FloatArray,
    gap: FloatArray,
) -> None:
    """Keep the closest heights known to lie below the ground (gap > 0) and above it, with their gaps."""
    below = (gap > 0) & (level > low[rows])
    low[rows[below]], over[rows[below]] = level[below], gap[below]
    above = (gap <= 0) & (level < high[rows])
    high[rows[above]], under[rows[above]] = level[above], gap[above]


def _bracketed(
    sensor: Sensor,
    xy: FloatArray,
    heights: Heights,
    low: FloatArray,
    high: FloatArray,
    over: FloatArray,
    under: FloatArray,
) -> FloatArray:
    """Heights where DEM(lonlat(h)) - h changes its sign, by the Illinois variant of regula falsi."""

    def gap(level: FloatArray, rows: NDArray[np.int64]) -> FloatArray:
        return heights.at(sensor.image_to_ground(xy[rows], level)) - level

    # Where the ground lies over, `low` (below the ground) may be higher than `high`; a crossing is between them still.
    everything = np.arange(len(xy))
    over = np.where(np.isnan(over), gap(low, everything), over)
    under = np.where(np.isnan(under), gap(high, everything), under)
    level, side = 0.5 * (low + high), np.zeros(len(xy))
    open_ = np.flatnonzero((over > 0) & (under <= 0))
    failed = np.setdiff1d(everything, open_)
    for _ in range(BRACKETED):
        if not len(open_):
            break
        near, far, a, b = low[open_], high[open_], over[open_], under[open_]
        now = far - b * (far - near) / (b - a)
        f = gap(now, open_)
        level[open_] = now
        up = f > 0
        low[open_], over[open_] = np.where(up, now, near), np.where(up, f, np.where(side[open_] < 0, 0.5 * a, a))
        high[open_], under[open_] = np.where(up, far, now), np.where(up, np.where(side[open_] > 0, 0.5 * b, b), f)
        side[open_] = np.where(up, 1.0, -1.0)
        done = (np.abs(f) <= CLOSE_M) | (np.abs(high[open_] - low[open_]) <= CLOSE_M) | ~np.isfinite(f)
        level[open_[~np.isfinite(f)]] = np.nan
        open_ = open_[~done]
    level[open_] = np.nan
    level[failed] = np.nan
    return level
