"""Images located by ground control points, such as Sentinel-1's geolocation grid."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from featreg.errors import InputError
from featreg.geolocation.projection import WGS84, Projection
from featreg.geolocation.sensor import Sensor, column_of, wrapped
from featreg.types import FloatArray, read_only

#: Least uncertainty, px: orbit and timing of the products that come with control points.
LEAST_PX = 5.0
#: Heights must spread by this many metres (standard deviation) before their effect on the position is estimated.
HILLY_M = 5.0
#: Points at most from which the degrees of the polynomials are told.
DEGREE_POINTS = 1000
STEPS = 12
FOUND_PX = 1e-9


@dataclass(frozen=True, eq=False)
class GcpSensor(Sensor):
    """A sensor interpolated from ground control points.

    Parameters
    ----------
    gcps : (M, 5) x, y, ground x, ground y, height; x, y in this package's convention, M >= 4
    crs : coordinate system of the ground points, WKT or authority code

    Raises
    ------
    InputError
        Fewer than four points, points on a line, values that are not finite, an unknown coordinate system.

    Notes
    -----
    Longitude and latitude are polynomials of the image position (degree 1 to 10 along x, 1 to 5 along y), plus the
    height times a polynomial (1 to 3, and 1) where the points lie at different heights: in a SAR image a point moves
    along range by height over the tangent of the incidence angle, and the points of a Sentinel-1 grid lie on the
    terrain. The degrees are chosen by leave-one-out errors, which also make the uncertainty. Without spread in height
    the effect of the height is unknown and counts as none.
    """

    gcps: FloatArray
    crs: str = WGS84

    def __post_init__(self) -> None:
        points = np.array(self.gcps, np.float64)
        if points.ndim != 2 or points.shape[1] != 5 or len(points) < 4 or not np.isfinite(points).all():
            raise InputError(f"at least 4 finite ground control points (M, 5) are needed, got shape {points.shape}")
        object.__setattr__(self, "gcps", read_only(points))
        lonlat = Projection(self.crs).to_lonlat(points[:, 2:4])
        if not np.isfinite(lonlat).all():
            raise InputError("ground control points lie outside their coordinate system")
        object.__setattr__(self, "_surface", _Surface.fitted(points[:, :2], lonlat, points[:, 4]))

    def image_to_ground(self, xy: FloatArray, heights: ArrayLike) -> FloatArray:
        p = np.asarray(xy, np.float64)
        return self._fit.ground(p, column_of(heights, len(p)))

    def ground_to_image(self, lonlat: FloatArray, heights: ArrayLike) -> FloatArray:
        wanted = np.asarray(lonlat, np.float64)
        return self._fit.image(wanted, column_of(heights, len(wanted)))

    @property
    def uncertainty_px(self) -> float:
        return max(LEAST_PX, 3.0 * self._fit.error_px)

    @property
    def centre(self) -> tuple[float, float]:
        x, y = (0.5 * (self.gcps[:, :2].min(axis=0) + self.gcps[:, :2].max(axis=0))).tolist()
        return x, y

    @property
    def level(self) -> float:
        """The mean height of the points."""
        return self._fit.level

    @property
    def sees_height(self) -> bool:
        """Whether the control points tell how a height moves a pixel."""
        return self._fit.tall is not None

    def to_dict(self) -> dict[str, Any]:
        return {"type": "gcps", "gcps": self.gcps.tolist(), "crs": self.crs}

    @property
    def _fit(self) -> _Surface:
        surface: _Surface = self.__dict__["_surface"]
        return surface


@dataclass(frozen=True, eq=False)
class _Surface:
    """Longitude and latitude as Chebyshev polynomials of the image position, and their slopes with the height."""

    centre: FloatArray
    half: FloatArray
    origin: FloatArray
    flat: FloatArray
    tall: FloatArray | None
    level: float
    error_px: float

    @classmethod
    def fitted(cls, xy: FloatArray, lonlat: FloatArray, heights: FloatArray) -> _Surface:
        low, high = xy.min(axis=0), xy.max(axis=0)
        centre, half = 0.5 * (low + high), 0.5 * (high - low)
        if not (half > 0).all() or np.linalg.matrix_rank(np.column_stack([np.ones(len(xy)), (xy - centre) / half])) < 3:
            raise InputError(f"the {len(xy)} ground control points lie on a line of the image")
        origin = lonlat[0]
        ground = np.column_stack([wrapped(lonlat[:, 0] - origin[0]), lonlat[:, 1] - origin[1]])
        unit, level = (xy - centre) / half, float(heights.mean())
        counts = [len(np.unique(np.round(xy[:, axis], 3))) for axis in (0, 1)]
        degrees = (0, 1, 2, 3) if heights.std() > HILLY_M else (0,)
        best = (np.inf, 1, 1, 0)
        # The degrees are told from a part of very many points; every nth of a grid might be one of its columns.
        some = np.random.default_rng(0).permutation(len(xy))[:DEGREE_POINTS]
        for m, n, k in product(range(1, min(10, counts[0] - 1) + 1), range(1, min(5, counts[1] - 1) + 1), degrees):
            error = _left_out(_design(unit[some], heights[some] - level, m, n, k), ground[some])
            # A more complicated surface must be clearly better.
            if error < 0.9 * best[0]:
                best = (error, m, n, k)
        error, m, n, k = best
        # Four corners leave no point to spare: least squares of the fewest terms.
        design = _design(unit, heights - level, m, n, k)
        solution = np.linalg.lstsq(design, ground)[0]
        count = (m + 1) * (n + 1)
        flat = solution[:count].reshape(m + 1, n + 1, 2)
        tall = solution[count:].reshape(k + 1, 2, 2) if k else None
        made = cls(centre, half, origin, flat, tall, level, 0.0)
        jacobian = made.jacobian(centre[None], np.array([level]))[0]
        error = _left_out(design, ground) if len(some) < len(xy) else error
        error_px = error * float(np.linalg.norm(np.linalg.inv(jacobian), 2)) if np.isfinite(error) else 0.0
        object.__setattr__(made, "error_px", error_px)
        return made

    def ground(self, xy: FloatArray, heights: FloatArray) -> FloatArray:
        u = (xy - self.centre) / self.half
        out = _values(u, self.flat) + self.origin
        if self.tall is not None:
            out = out + (heights - self.level)[:, None] * _values(u, self.tall)
        out[:, 0] = wrapped(out[:, 0])
        return np.asarray(out)

    def jacobian(self, xy: FloatArray, heights: FloatArray) -> FloatArray:
        """(N, 2, 2) degrees per pixel."""
        u = (xy - self.centre) / self.half
        out = np.empty((len(xy), 2, 2))
        for axis in (0, 1):
            out[:, :, axis] = _values(u, np.polynomial.chebyshev.chebder(self.flat, axis=axis))
            if self.tall is not None:
                slope = np.polynomial.chebyshev.chebder(self.tall, axis=axis)
                out[:, :, axis] += (heights - self.level)[:, None] * _values(u, slope)
            out[:, :, axis] /= self.half[axis]
        return out

    def image(self, lonlat: FloatArray, heights: FloatArray) -> FloatArray:
        """(N, 2) image points, by Newton's iteration; outside the points' frame the map goes on as it is at the rim."""
        found = np.tile(self.centre, (len(lonlat), 1))
        open_ = np.flatnonzero(np.isfinite(lonlat).all(axis=1) & np.isfinite(heights))
        closed = np.zeros(len(lonlat), bool)
        with np.errstate(all="ignore"):
            for _ in range(STEPS):
                if not len(open_):
                    break
                off = lonlat[open_] - self.ground(found[open_], heights[open_])
                off[:, 0] = wrapped(off[:, 0])
                j = self.jacobian(found[open_], heights[open_])
                det = j[:, 0, 0] * j[:, 1, 1] - j[:, 0, 1] * j[:, 1, 0]
                dx = (j[:, 1, 1] * off[:, 0] - j[:, 0, 1] * off[:, 1]) / det
                dy = (j[:, 0, 0] * off[:, 1] - j[:, 1, 0] * off[:, 0]) / det
                found[open_] += np.column_stack([dx, dy])
                size = np.maximum(np.abs(dx), np.abs(dy))
                closed[open_] = size < 1e-7
                open_ = open_[~closed[open_] & (size < 1e7)]
        found[~closed] = np.nan
        return found


def _values(unit: FloatArray, coefficients: NDArray[np.floating]) -> FloatArray:
    """(N, 2) values at (N, 2) normalised points of the Chebyshev coefficients (m + 1, n + 1, 2)."""
    return np.asarray(np.moveaxis(np.polynomial.chebyshev.chebval2d(unit[:, 0], unit[:, 1], coefficients), 0, -1))


def _design(unit: FloatArray, heights: FloatArray, m: int, n: int, k: int) -> FloatArray:
    """Terms of degree m along x and n along y and, where k > 0, the height times those of degree k and 1."""
    chebyshev = np.polynomial.chebyshev.chebvander2d
    flat = np.asarray(chebyshev(unit[:, 0], unit[:, 1], [m, n]), np.float64)
    return np.column_stack([flat, heights[:, None] * chebyshev(unit[:, 0], unit[:, 1], [k, 1])]) if k else flat


def _left_out(design: FloatArray, values: FloatArray) -> float:
    """Root mean square leave-one-out error of a linear fit; infinite where it has no point to spare."""
    rows, columns = design.shape
    if rows <= columns:
        return np.inf
    q, r = np.linalg.qr(design / np.sqrt((design**2).sum(axis=0)))
    if np.abs(np.diag(r)).min() < 1e-10:
        return np.inf
    lever = (q**2).sum(axis=1)
    if lever.max() > 1 - 1e-9:
        return np.inf
    residuals = values - q @ (q.T @ values)
    return float(np.sqrt(((residuals / (1 - lever)[:, None]) ** 2).sum(axis=1).mean()))
