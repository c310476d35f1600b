"""Rational polynomial coefficients (RPC00B), evaluated directly: vectorised, without a GDAL handle."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from featreg.errors import InputError
from featreg.geolocation.elevation_model import Patch
from featreg.geolocation.sensor import SIGMAS, Sensor, column_of, wrapped
from featreg.types import BoolArray, FloatArray, read_only

COEFFICIENTS = ("samp_num_coeff", "samp_den_coeff", "line_num_coeff", "line_den_coeff")
NUMBERS = tuple(f"{what}_{part}" for what in ("samp", "line", "long", "lat", "height") for part in ("off", "scale"))
ERRORS = ("err_bias", "err_rand")
#: Uncertainty, px, of an RPC that does not state its errors.
UNKNOWN_PX = 20.0
#: A ground point is found when it projects this close to its image point, px; one more Newton step follows.
FOUND_PX = 1e-4
#: Newton steps before a point counts as not to be found; real RPCs need four.
STEPS = 20


@dataclass(frozen=True, eq=False, repr=False)
class RpcSensor(Sensor):
    """A sensor given by rational polynomial coefficients.

    Parameters
    ----------
    rpcs : under rasterio's names: ``samp_off``, ``samp_scale``, ..., ``line_num_coeff`` (20 numbers), ..., and
        optionally ``err_bias`` and ``err_rand`` in metres

    Raises
    ------
    InputError
        A value is missing, not a number, or a scale is not positive.

    Notes
    -----
    The sample and line of an RPC count from the centre of the first pixel, which is this package's convention. GDAL's
    transformer adds half a pixel to them, because its pixel coordinates count from the corner.
    Longitudes are wrapped to within 180 degrees of the offset, so images across the antimeridian work.
    """

    rpcs: Mapping[str, Any]

    def __post_init__(self) -> None:
        kept: dict[str, Any] = {}
        for name in NUMBERS:
            kept[name] = _number(self.rpcs, name)
            if name.endswith("scale") and not kept[name] > 0:
                raise InputError(f"RPC '{name}' must be > 0, got {kept[name]}")
        for name in COEFFICIENTS:
            kept[name] = _twenty(self.rpcs, name)
        for name in ERRORS:
            value = self.rpcs.get(name)
            # A negative error is how NITF files say "unknown".
            kept[name] = None if value is None or not float(value) >= 0 else float(value)
        object.__setattr__(self, "rpcs", kept)
        object.__setattr__(self, "_table", read_only(np.array([kept[name] for name in COEFFICIENTS])))

    def __repr__(self) -> str:
        r = self.rpcs
        return f"RpcSensor(longitude {r['long_off']:.4f}, latitude {r['lat_off']:.4f}, height {r['height_off']:.0f} m)"

    def ground_to_image(self, lonlat: FloatArray, heights: ArrayLike) -> FloatArray:
        from featreg.geolocation.rpc_kernels import project

        p, r = np.asarray(lonlat, np.float64), self.rpcs
        x = wrapped(p[:, 0] - r["long_off"]) / r["long_scale"]
        y = (p[:, 1] - r["lat_off"]) / r["lat_scale"]
        sample, line = np.empty(len(p)), np.empty(len(p))
        project(*self._rows(), x, y, self._high(heights, len(p)), sample, line)
        return np.column_stack([sample * r["samp_scale"] + r["samp_off"], line * r["line_scale"] + r["line_off"]])

    def image_to_ground(self, xy: FloatArray, heights: ArrayLike) -> FloatArray:
        from featreg.geolocation.rpc_kernels import locate

        p, r = np.asarray(xy, np.float64), self.rpcs
        sample = (p[:, 0] - r["samp_off"]) / r["samp_scale"]
        line = (p[:, 1] - r["line_off"]) / r["line_scale"]
        x, y = np.empty(len(p)), np.empty(len(p))
        tolerance = FOUND_PX / max(r["samp_scale"], r["line_scale"])
        locate(self._coefficients, sample, line, self._high(heights, len(p)), x, y, tolerance, STEPS)
        return np.column_stack([wrapped(x * r["long_scale"] + r["long_off"]), y * r["lat_scale"] + r["lat_off"]])

    def on_patch(
        self, xy: FloatArray, patch: Patch, start: float, close: float
    ) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Return where the lines of sight of (N, 2) image points meet a part of an elevation model.

        Parameters
        ----------
        xy : image points
        patch : the part
        start : metres at which the search begins
        close : heights count as found to so many metres

        Returns
        -------
        lonlat, heights : (N, 2) degrees and (N,) metres, NaN where not found
        found : (N,) bool; elsewhere the ground is too steep for secants, or lies beyond the part
        """
        from featreg.geolocation.ground_kernels import ground_of

        p, r = np.ascontiguousarray(xy, np.float64), self.rpcs
        lonlat, level, found = np.full((len(p), 2), np.nan), np.full(len(p), np.nan), np.zeros(len(p), np.uint8)
        norm = [r[f"{name}_{part}"] for name in ("samp", "line", "long", "lat", "height") for part in ("scale", "off")]
        tolerance = FOUND_PX / max(r["samp_scale"], r["line_scale"])
        ground_of(
            self._coefficients, np.array(norm, np.float64), patch.cells, patch.heights, patch.left, patch.top,
            start, close, tolerance, STEPS, p, lonlat, level, found,
        )  # fmt: skip
        good = found.view(np.bool_)
        return lonlat, level, good

    @property
    def uncertainty_px(self) -> float:
        known = [self.rpcs[name] for name in ERRORS if self.rpcs[name] is not None]
        if not any(known):
            return UNKNOWN_PX
        return SIGMAS * math.hypot(*known) / min(self.pixel_size(self.rpcs["height_off"]))

    @property
    def centre(self) -> tuple[float, float]:
        return self.rpcs["samp_off"], self.rpcs["line_off"]

    @property
    def level(self) -> float:
        """The height offset."""
        return float(self.rpcs["height_off"])

    def to_dict(self) -> dict[str, Any]:
        return {"type": "rpc", **self.rpcs}

    @property
    def _coefficients(self) -> FloatArray:
        table: FloatArray = self.__dict__["_table"]
        return table

    def _rows(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        a, b, c, d = self._coefficients
        return a, b, c, d

    def _high(self, heights: ArrayLike, count: int) -> FloatArray:
        return np.asarray((column_of(heights, count) - self.rpcs["height_off"]) / self.rpcs["height_scale"])


def _number(rpcs: Mapping[str, Any], name: str) -> float:
    try:
        value = float(rpcs[name])
    except KeyError as error:
        raise InputError(f"the RPC lacks '{name}'; it needs {', '.join((*NUMBERS, *COEFFICIENTS))}") from error
    except (TypeError, ValueError) as error:
        raise InputError(f"RPC '{name}' must be a number, got {rpcs[name]!r:.40}") from error
    if not math.isfinite(value):
        raise InputError(f"RPC '{name}' must be finite, got {value}")
    return value


def _twenty(rpcs: Mapping[str, Any], name: str) -> list[float]:
    try:
        values = np.asarray(rpcs[name], np.float64)
    except KeyError as error:
        raise InputError(f"the RPC lacks '{name}'") from error
    except (TypeError, ValueError) as error:
        raise InputError(f"RPC '{name}' must be 20 numbers, got {rpcs[name]!r:.40}") from error
    if values.shape != (20,) or not np.isfinite(values).all():
        raise InputError(f"RPC '{name}' must be 20 finite numbers, got shape {values.shape}")
    listed: list[float] = values.tolist()
    return listed
