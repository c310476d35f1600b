"""The grid on the ground on which an image is formed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from featreg.errors import ParameterError
from featreg.types import FloatArray


@dataclass(frozen=True)
class GroundGrid:
    """The pixels of an image on a horizontal plane; without a turn, x grows to the right and y upwards.

    Parameters
    ----------
    shape : (H, W)
    spacing : of the pixels, m
    centre : ground (x, y) m of the image centre ((W - 1) / 2, (H - 1) / 2)
    height : z of the plane, m
    turn_deg : the image's +x axis, degrees counter-clockwise from ground +x. With the azimuth of the radar, columns
        run along cross-range and rows along ground range, towards the radar.

    Raises
    ------
    ParameterError
        A shape below 1 x 1, a spacing that is not positive, values that are not finite.
    """

    shape: tuple[int, int] = (501, 501)
    spacing: float = 0.2
    centre: tuple[float, float] = (0.0, 0.0)
    height: float = 0.0
    turn_deg: float = 0.0

    def __post_init__(self) -> None:
        if len(self.shape) != 2 or min(self.shape) < 1:
            raise ParameterError(f"shape must be (H, W) of at least 1 x 1, got {self.shape}")
        values = (self.spacing, *self.centre, self.height, self.turn_deg)
        if not np.isfinite(values).all() or self.spacing <= 0 or len(self.centre) != 2:
            raise ParameterError(f"the grid needs finite numbers and a spacing > 0 m, got {self}")

    @property
    def step(self) -> FloatArray:
        """(2,) m, ground vector from a pixel to the next in its row."""
        turn = math.radians(self.turn_deg)
        return np.array([math.cos(turn), math.sin(turn)]) * self.spacing

    @property
    def row_starts(self) -> FloatArray:
        """(H, 2) m, ground x, y of the first pixel of every row; row 0 has the largest y."""
        height, width = self.shape
        up = np.array([-self.step[1], self.step[0]])
        rows = (height - 1) / 2 - np.arange(height)
        return np.asarray(np.array(self.centre) - (width - 1) / 2 * self.step + rows[:, None] * up)

    def to_ground(self, xy: FloatArray) -> FloatArray:
        """(N, 2) m, ground x, y of (N, 2) pixel coordinates."""
        up = np.array([-self.step[1], self.step[0]])
        off = np.asarray(xy, np.float64) - [(self.shape[1] - 1) / 2, (self.shape[0] - 1) / 2]
        return np.asarray(np.array(self.centre) + off[:, :1] * self.step - off[:, 1:] * up)

    def to_pixels(self, ground: FloatArray) -> FloatArray:
        """(N, 2) pixel coordinates of (N, 2) ground points in m."""
        off = (np.asarray(ground, np.float64) - np.array(self.centre)) / self.spacing**2
        up = np.array([-self.step[1], self.step[0]])
        middle = [(self.shape[1] - 1) / 2, (self.shape[0] - 1) / 2]
        return np.column_stack([off @ self.step, -(off @ up)]) + middle
