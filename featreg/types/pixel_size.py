"""The size of a pixel."""

from __future__ import annotations

from typing import NamedTuple


class PixelSize(NamedTuple):
    """Size of a pixel along x and y, in `unit`: "metre" on the ground, or "degree" of a grid of degrees."""

    x: float
    y: float
    unit: str
