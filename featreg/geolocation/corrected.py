"""A sensor whose image points are moved by an affine map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from featreg.errors import InputError
from featreg.geolocation.sensor import Sensor
from featreg.geometry.matrix import Affine
from featreg.types import FloatArray


@dataclass(frozen=True, eq=False)
class CorrectedSensor(Sensor):
    """Another sensor, and a bias of its image points that was measured.

    Parameters
    ----------
    sensor : the other one
    bias : (2, 3) float64, image points as the sensor predicts them -> true ones

    Raises
    ------
    InputError
        No sensor, or a map that cannot be inverted.
    """

    sensor: Sensor
    bias: FloatArray

    def __post_init__(self) -> None:
        if not isinstance(self.sensor, Sensor):
            raise InputError(f"a sensor is needed, got {self.sensor!r:.80}")
        object.__setattr__(self, "_map", Affine(np.array(self.bias, np.float64)))
        object.__setattr__(self, "bias", self._of.coefficients)

    def image_to_ground(self, xy: FloatArray, heights: ArrayLike) -> FloatArray:
        return self.sensor.image_to_ground(self._of.inverse(np.asarray(xy, np.float64)), heights)

    def ground_to_image(self, lonlat: FloatArray, heights: ArrayLike) -> FloatArray:
        return self._of(self.sensor.ground_to_image(lonlat, heights))

    @property
    def uncertainty_px(self) -> float:
        return self.sensor.uncertainty_px

    @property
    def centre(self) -> tuple[float, float]:
        x, y = self._of(np.array([self.sensor.centre]))[0].tolist()
        return x, y

    @property
    def level(self) -> float | None:
        return self.sensor.level

    def to_dict(self) -> dict[str, Any]:
        return {"type": "corrected", "sensor": self.sensor.to_dict(), "bias": self.bias.tolist()}

    @property
    def _of(self) -> Affine:
        known: Affine = self.__dict__["_map"]
        return known
