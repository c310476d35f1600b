"""What a sensor model is: image to ground at a height, and back."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from featreg.types import FloatArray

#: Metres per degree of latitude, and of longitude on the equator; for sizes, not for positions.
METRES_PER_DEGREE = 111_320.0
#: The geolocation of an image is trusted to this many standard errors.
SIGMAS = 3.0


class Sensor(ABC):
    """Where the pixels of one image lie on the ground.

    Image points are (x, y) in this package's convention, the centre of the first pixel at (0, 0). Ground points are
    (longitude, latitude) in degrees on WGS84; heights are metres above its ellipsoid.
    """

    @abstractmethod
    def image_to_ground(self, xy: FloatArray, heights: ArrayLike) -> FloatArray:
        """Return (N, 2) longitude and latitude of (N, 2) image points that lie `heights` (N,) or () metres high.

        Rows are NaN where the point cannot be found.
        """

    @abstractmethod
    def ground_to_image(self, lonlat: FloatArray, heights: ArrayLike) -> FloatArray:
        """Return (N, 2) image points of (N, 2) ground points; rows are NaN where the point cannot be found."""

    @property
    @abstractmethod
    def uncertainty_px(self) -> float:
        """How far the projection may be off along either image axis, px (three standard errors)."""

    @property
    @abstractmethod
    def centre(self) -> tuple[float, float]:
        """An image point in the middle of where the sensor model holds."""

    @property
    def level(self) -> float | None:
        """Metres above the ellipsoid of the ground, where what the sensor is made from states it."""
        return None

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """A JSON-able dict from which `sensor_from_dict` makes the same sensor."""

    def pixel_size(self, height: float = 0.0) -> tuple[float, float]:
        """Return the size in metres on the ground of the pixel at the centre, along x and along y."""
        x, y = self.centre
        at = np.array([[x, y], [x + 1, y], [x, y + 1]])
        ground = self.image_to_ground(at, height)
        steps = metres(ground[1:] - ground[0], float(ground[0, 1]))
        across, along = np.hypot(*steps.T).tolist()
        return across, along


def metres(degrees: FloatArray, latitude: float) -> FloatArray:
    """Return (N, 2) differences of longitude and latitude in metres east and north; good to half a percent."""
    east, north = wrapped(degrees[:, 0]), degrees[:, 1]
    return np.column_stack([east * math.cos(math.radians(latitude)), north]) * METRES_PER_DEGREE


def wrapped(longitudes: FloatArray) -> FloatArray:
    """Return differences of longitude between -180 and 180 degrees."""
    return np.asarray((longitudes + 180.0) % 360.0 - 180.0)


def column_of(heights: ArrayLike, count: int) -> FloatArray:
    """Return `heights` as a contiguous (count,) float64 array; one number stands for all."""
    return np.ascontiguousarray(np.broadcast_to(np.asarray(heights, np.float64), (count,)))
