"""Images located by the metadata of a SIDD, by sarkit (the `sicd` extra)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyval, polyval2d
from numpy.typing import ArrayLike

from featreg.errors import InputError
from featreg.geolocation.sensor import Sensor, column_of
from featreg.io.ellipsoid import earth_fixed, geodetic
from featreg.io.sarkit_metadata import BROKEN, sarkit_module, tree_of
from featreg.types import FloatArray

#: Metres (three standard errors) by which the geolocation may be off.
ACCURACY_M = 15.0
#: Metres to which the projections are solved, and rounds before a point counts as not to be found.
CLOSE_M, ROUNDS = 1e-4, 20
#: Grids of a plane, and those over the ground itself, whose pixels have one place whatever its height.
PLANE = "Planar Gridded Display"
MAPS = ("Geodetic Gridded Display", "Polynomial Fit Gridded Display")


@dataclass(frozen=True, eq=False, repr=False)
class SiddSensor(Sensor):
    """A sensor by the image grid of a SIDD: columns are x, rows are y.

    Parameters
    ----------
    xml : the metadata of the SIDD, or their ``Measurement``

    Raises
    ------
    InputError
        sarkit is not installed, the text is no XML of a SIDD, or lacks what its grid needs.

    Notes
    -----
    A pixel of a planar grid (PGD) is a point of its plane [1]_, as sarkit has it. What lies above or below it was
    imaged where the contour of its range and range rate at the centre of aperture meets it: that contour is followed to
    any height, and back, by the projections of the SICD [2]_. The polynomial of the time at the centre of aperture is
    taken of rows and columns in pixels; of a spotlight image it is one number. A grid in latitude and longitude (GGD,
    PFGD) is a map: its pixels have one place, at whatever height. Cylindrical grids (CGD) are refused: sarkit, at least
    to 1.8.1, takes the latitude in radians for degrees and tilts their surface.

    References
    ----------
    .. [1] NGA.STND.0025-1, "Sensor Independent Derived Data (SIDD), Vol. 1, Design and Implementation Description"
    .. [2] NGA.STND.0024-3, "Sensor Independent Complex Data (SICD), Vol. 3, Image Projections Description Document"
    """

    xml: str

    def __post_init__(self) -> None:
        sidd = sarkit_module("sidd", "the projection of a SIDD")
        try:
            tree = tree_of(self.xml)
            helper = sidd.XmlHelper(tree)
            rows, cols = (int(n) for n in helper.load("./{*}Measurement/{*}PixelFootprint"))
            kind = str(sidd.get_coordinate_system_type(tree))
            if kind not in (PLANE, *MAPS):
                raise ValueError(f"a {kind} is not projected")
            known = {"tree": tree, "shape": (rows, cols), "is_map": kind in MAPS}
            if not known["is_map"]:
                for part, name in (("orbit", "ARPPoly"), ("time", "PlaneProjection/{*}TimeCOAPoly")):
                    found = helper.load(f"./{{*}}Measurement/{{*}}{name}")
                    if found is None:
                        raise ValueError(f"it has no {name}")
                    known[part] = np.asarray(found, np.float64)
            object.__setattr__(self, "_known", known)
            x, y = self.centre
            middle = np.asarray(sidd.pixel_to_ecef(tree, np.array([[y, x]])), np.float64)
            known["level"] = float(geodetic(middle)[0, 2])
            if not known["is_map"]:
                known["look"] = self._side(middle)
            at = self.image_to_ground(np.array([self.centre]), self.level)
        except BROKEN as error:
            raise InputError(
                f"the metadata of the SIDD do not make a grid ({type(error).__name__}: {error})"
            ) from error
        if not np.isfinite(at).all():
            raise InputError("the metadata of the SIDD make a grid that does not converge at the image's centre")

    def __reduce__(self) -> tuple[type[SiddSensor], tuple[str]]:
        # The parsed tree cannot be pickled.
        return SiddSensor, (self.xml,)

    def __repr__(self) -> str:
        rows, cols = self._of["shape"]
        return f"SiddSensor({cols} x {rows} px)"

    def image_to_ground(self, xy: FloatArray, heights: ArrayLike) -> FloatArray:
        p = np.asarray(xy, np.float64)
        level = column_of(heights, len(p))
        good = np.isfinite(p).all(axis=1) & np.isfinite(level)
        out = np.full((len(p), 2), np.nan)
        if good.any():
            surface = self._surface(p[good])
            found = surface if self._of["is_map"] else self._at_height(p[good], surface, level[good])
            out[good] = geodetic(found)[:, :2]
        return out

    def ground_to_image(self, lonlat: FloatArray, heights: ArrayLike) -> FloatArray:
        p = np.asarray(lonlat, np.float64)
        level = column_of(heights, len(p))
        good = np.isfinite(p).all(axis=1) & np.isfinite(level)
        out = np.full((len(p), 2), np.nan)
        if not good.any():
            return out
        target = earth_fixed(p[good], level[good])
        xy = self._pixels(target)
        if not self._of["is_map"]:
            off = np.full(len(target), np.inf)
            aim = target.copy()
            for _ in range(ROUNDS):
                missed = target - self._at_height(xy, self._surface(xy), level[good])
                off = np.linalg.norm(missed, axis=1)
                if not (off > CLOSE_M).any():
                    break
                # What the contour is off at that height it is nearly off on the plane too.
                aim += np.nan_to_num(missed)
                xy = self._pixels(aim)
            xy[~(off <= CLOSE_M)] = np.nan
        out[good] = xy
        return out

    @property
    def uncertainty_px(self) -> float:
        size = min(self.pixel_size(self.level))
        return ACCURACY_M / size if math.isfinite(size) and size > 0 else ACCURACY_M

    @property
    def centre(self) -> tuple[float, float]:
        rows, cols = self._of["shape"]
        return (cols - 1) / 2, (rows - 1) / 2

    @property
    def level(self) -> float:
        """The height of the surface in the middle of the image."""
        return float(self._of["level"])

    def to_dict(self) -> dict[str, Any]:
        return {"type": "sidd", "xml": self.xml}

    @property
    def _of(self) -> dict[str, Any]:
        known: dict[str, Any] = self.__dict__["_known"]
        return known

    def _surface(self, xy: FloatArray) -> FloatArray:
        """(N, 3) Earth-fixed points of the grid."""
        sidd = import_module("sarkit.sidd")
        return np.asarray(sidd.pixel_to_ecef(self._of["tree"], xy[:, ::-1]), np.float64)

    def _pixels(self, points: FloatArray) -> FloatArray:
        """(N, 2) x, y of the pixels onto which Earth-fixed points fall along the plane's normal."""
        sidd = import_module("sarkit.sidd")
        return np.asarray(sidd.ecef_to_pixel(self._of["tree"], points), np.float64)[:, ::-1].copy()

    def _aperture(self, xy: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Time, position and velocity of the antenna at the centre of aperture of pixels."""
        orbit, times = self._of["orbit"], self._of["time"]
        time = np.asarray(polyval2d(xy[:, 1], xy[:, 0], times))
        powers = np.arange(1, len(orbit))[:, None]
        return time, np.asarray(polyval(time, orbit)).T, np.asarray(polyval(time, orbit[1:] * powers)).T

    def _side(self, middle: FloatArray) -> int:
        """1 where the antenna looks to the left of its track, -1 to the right."""
        _, position, velocity = self._aperture(np.array([self.centre]))
        left = np.cross(position[0], velocity[0])
        return 1 if float(left @ (middle[0] - position[0])) > 0 else -1

    def _at_height(self, xy: FloatArray, surface: FloatArray, level: FloatArray) -> FloatArray:
        """(N, 3) points at heights on the contours of range and range rate through points of the plane; else NaN."""
        tools: Any = import_module("sarkit.sicd.projection")
        time, position, velocity = self._aperture(xy)
        away = surface - position
        distance = np.linalg.norm(away, axis=1)
        rate = -np.sum(velocity * away, axis=1) / distance
        sets = tools.ProjectionSetsMono(t_COA=time, ARP_COA=position, VARP_COA=velocity, R_COA=distance, Rdot_COA=rate)
        middle = surface.mean(axis=0)
        with np.errstate(all="ignore"):
            points, off, _ = tools.r_rdot_to_constant_hae_surface(
                self._of["look"], middle, sets, level, delta_hae_max=0.1 * CLOSE_M, nlim=ROUNDS
            )
        found = np.isfinite(points).all(axis=1) & (np.abs(off) <= CLOSE_M)
        return np.where(found[:, None], points, np.nan)
