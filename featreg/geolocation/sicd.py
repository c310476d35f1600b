"""Images located by the metadata of a SICD, projected exactly at any height by sarkit (the `sicd` extra)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from featreg.errors import InputError
from featreg.geolocation.sensor import SIGMAS, Sensor, column_of
from featreg.io.ellipsoid import earth_fixed, geodetic
from featreg.io.sarkit_metadata import BROKEN, sarkit_module, tree_of
from featreg.types import FloatArray

#: Metres (three standard errors) by which the geolocation may be off, where the metadata do not say.
ACCURACY_M = 15.0
#: Metres to which the projections are solved, and rounds before a point counts as not to be found.
CLOSE_M, ROUNDS = 1e-4, 12


@dataclass(frozen=True, eq=False, repr=False)
class SicdSensor(Sensor):
    """A sensor by the image projections of a SICD: columns are x, rows are y.

    Parameters
    ----------
    xml : the metadata of the SICD, or the parts of them that its projection needs; for a part of a larger image with
        the first row and column that the file itself states

    Raises
    ------
    InputError
        sarkit is not installed, the text is no XML of a SICD, or lacks what its projection needs.

    Notes
    -----
    Both directions are those of the standard [1]_, as sarkit has them: a pixel's range and range rate at its centre of
    aperture, and the point of that contour at a height above the ellipsoid. They are solved to 1e-4 m at every point,
    adjustable parameter offsets included; nothing is interpolated. About 400 000 points a second.

    References
    ----------
    .. [1] NGA.STND.0024-3, "Sensor Independent Complex Data (SICD), Vol. 3, Image Projections Description Document"
    """

    xml: str

    def __post_init__(self) -> None:
        tools = sarkit_module("sicd.projection", "the projection of a SICD")
        try:
            tree = tree_of(self.xml)
            known = tools.MetadataParams.from_xml(tree)
            offsets: Any = None
            if tools.AdjustableParameterOffsets.exists(tree):
                offsets = tools.AdjustableParameterOffsets.from_xml(tree)
            object.__setattr__(self, "_known", known)
            object.__setattr__(self, "_offsets", offsets)
            object.__setattr__(self, "_error", _stated_error(tree))
            at = self.image_to_ground(np.array([self.centre]), known.SCP_HAE)
        except BROKEN as error:
            raise InputError(
                f"the metadata of the SICD do not make a projection ({type(error).__name__}: {error})"
            ) from error
        if not np.isfinite(at).all():
            raise InputError("the metadata of the SICD make a projection that does not converge at the image's centre")

    def __repr__(self) -> str:
        k = self._of
        return f"SicdSensor({k.NumCols} x {k.NumRows} px, {k.Grid_Type}, {k.SCP_Lon:.4f}, {k.SCP_Lat:.4f})"

    def image_to_ground(self, xy: FloatArray, heights: ArrayLike) -> FloatArray:
        p = np.asarray(xy, np.float64)
        level = column_of(heights, len(p))
        good = np.isfinite(p).all(axis=1) & np.isfinite(level)
        out = np.full((len(p), 2), np.nan)
        if good.any():
            tools, k = import_module("sarkit.sicd.projection"), self._of
            sets = self._sets(self._plane(p[good]))
            with np.errstate(all="ignore"):
                points, off, _ = tools.r_rdot_to_constant_hae_surface(
                    k.LOOK, k.SCP, sets, level[good], delta_hae_max=CLOSE_M, nlim=ROUNDS
                )
            found = np.isfinite(points).all(axis=1) & (np.abs(off) <= CLOSE_M)
            points[~found] = k.SCP
            out[good] = np.where(found[:, None], geodetic(points)[:, :2], np.nan)
        return out

    def ground_to_image(self, lonlat: FloatArray, heights: ArrayLike) -> FloatArray:
        p = np.asarray(lonlat, np.float64)
        level = column_of(heights, len(p))
        good = np.isfinite(p).all(axis=1) & np.isfinite(level)
        out = np.full((len(p), 2), np.nan)
        if good.any():
            tools, k = import_module("sarkit.sicd.projection"), self._of
            with np.errstate(all="ignore"):
                plane, off, _ = tools.scene_to_image(
                    k, earth_fixed(p[good], level[good]), adjust_param_offsets=self._offsets_of,
                    delta_gp_s2i=CLOSE_M, maxiter=ROUNDS,
                )  # fmt: skip
            rows = plane / [k.Row_SS, k.Col_SS] + [k.SCP_Row - k.FirstRow, k.SCP_Col - k.FirstCol]
            out[good] = np.where((off <= CLOSE_M)[:, None], rows[:, ::-1], np.nan)
        return out

    @property
    def uncertainty_px(self) -> float:
        stated: float | None = self.__dict__["_error"]
        size = min(self.pixel_size(self.level))
        metres = ACCURACY_M if stated is None else SIGMAS * stated
        return metres / size if math.isfinite(size) and size > 0 else metres

    @property
    def centre(self) -> tuple[float, float]:
        return (int(self._of.NumCols) - 1) / 2, (int(self._of.NumRows) - 1) / 2

    @property
    def level(self) -> float:
        """The height of the scene centre point."""
        return float(self._of.SCP_HAE)

    def to_dict(self) -> dict[str, Any]:
        return {"type": "sicd", "xml": self.xml}

    @property
    def _of(self) -> Any:
        return self.__dict__["_known"]

    @property
    def _offsets_of(self) -> Any:
        return self.__dict__["_offsets"]

    def _plane(self, xy: FloatArray) -> FloatArray:
        """(N, 2) metres along rows and columns from the scene centre point's pixel."""
        k = self._of
        rows = xy[:, ::-1] + [k.FirstRow - k.SCP_Row, k.FirstCol - k.SCP_Col]
        return np.asarray(rows * [k.Row_SS, k.Col_SS])

    def _sets(self, plane: FloatArray) -> Any:
        tools = import_module("sarkit.sicd.projection")
        sets = tools.compute_projection_sets(self._of, plane)
        return sets if self._offsets_of is None else tools.apply_apos(self._of, sets, self._offsets_of)


def _stated_error(tree: Any) -> float | None:
    """Metres of one standard error along range and azimuth together, as the metadata state it."""
    parts = [tree.findtext(f"{{*}}ErrorStatistics/{{*}}CompositeSCP/{{*}}{name}") for name in ("Rg", "Az")]
    values = [float(part) for part in parts if part]
    return math.hypot(*values) if values and max(values) > 0 else None
