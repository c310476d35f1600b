"""A rectangle of whole pixels of a scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from featreg.errors import ParameterError
from featreg.types import BoolArray, FloatArray


@dataclass(frozen=True)
class Window:
    """A rectangle of whole pixels: columns x .. x + width - 1, rows y .. y + height - 1; it may reach outside."""

    x: int
    y: int
    width: int
    height: int

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise ParameterError(f"a window needs width and height >= 1, got {self.width} x {self.height}")

    @property
    def origin(self) -> FloatArray:
        """(x, y) of the first pixel's centre."""
        return np.array([self.x, self.y], np.float64)

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self.height, self.width

    @property
    def size(self) -> int:
        """Number of pixels."""
        return self.height * self.width

    def grown(self, margin: int) -> Window:
        """The window with `margin` pixels more on every side."""
        return Window(self.x - margin, self.y - margin, self.width + 2 * margin, self.height + 2 * margin)

    def within(self, shape: tuple[int, int]) -> Window | None:
        """The part inside an image of (H, W), or None."""
        x, y = max(self.x, 0), max(self.y, 0)
        right, bottom = min(self.x + self.width, shape[1]), min(self.y + self.height, shape[0])
        return Window(x, y, right - x, bottom - y) if right > x and bottom > y else None

    def holds(self, xy: FloatArray) -> BoolArray:
        """(N,) whether each (N, 2) point lies on a pixel of the window, half-open: neighbours share no point."""
        x, y = np.floor(xy + 0.5).T
        return np.asarray(
            (x >= self.x) & (x < self.x + self.width) & (y >= self.y) & (y < self.y + self.height), np.bool_
        )
