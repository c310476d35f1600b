"""A part of a scene that is read once, and windows cut from it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from featreg.io.source import Source
from featreg.io.window import Window
from featreg.types import BoolArray, Image, read_only

#: Two windows are read as one where that takes at most so much of the pixels of both.
AS_ONE = 0.75


@dataclass(frozen=True, eq=False)
class Excerpt:
    """A window of a scene, kept in memory from the first time that a part of it is asked for.

    Parameters
    ----------
    source : the scene
    window : of it
    """

    source: Source
    window: Window

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of the scene."""
        return self.source.shape

    def read(self, window: Window) -> Image:
        """Return the pixels of a window inside that of the excerpt."""
        whole = self._image
        if window == self.window:
            return whole
        rows, cols = inside(window, self.window)
        pixels, mask = whole.pixels[rows, cols].copy(), whole.mask[rows, cols].copy()
        return Image(read_only(pixels), read_only(mask), None, whole.name, whole.source_dtype, whole.scale)

    @cached_property
    def _image(self) -> Image:
        return self.source.read(self.window)


def together(first: Window, second: Window) -> Window | None:
    """Return the window that holds two, or None where they have so little in common that each is better read alone."""
    x, y = min(first.x, second.x), min(first.y, second.y)
    right = max(first.x + first.width, second.x + second.width)
    bottom = max(first.y + first.height, second.y + second.height)
    both = Window(x, y, right - x, bottom - y)
    return both if both.size <= AS_ONE * (first.size + second.size) else None


def inside(window: Window, whole: Window) -> tuple[slice, slice]:
    """Rows and columns of a window in another that holds it."""
    x, y = window.x - whole.x, window.y - whole.y
    return slice(y, y + window.height), slice(x, x + window.width)


def part_of(mask: BoolArray, window: Window, whole: Window) -> BoolArray:
    """The part of a mask over `whole` that lies in a window of it."""
    return np.ascontiguousarray(mask[inside(window, whole)])
