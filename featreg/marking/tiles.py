"""Tiles of a scene at powers of two, read by windows and toned alike."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from featreg.errors import ParameterError
from featreg.io.bands import BandLike
from featreg.io.raster_source import Window, open_source
from featreg.pictures.panels import resized, tone, tone_limits
from featreg.types import Image

#: Side of a tile in pixels of the page, and the coarsest level that is read from the scene itself.
TILE, DIRECT = 256, 2
#: Longest side of the overview from which coarser tiles come.
OVERVIEW = 4096


class TiledScene:
    """One image as tiles: tile (column, row) of level L covers TILE * 2**L pixels each way.

    Parameters
    ----------
    source, band : path, array or `Image`, and which band of a file, as `featreg.match` takes them
    """

    def __init__(self, source: Any, band: BandLike = None) -> None:
        self.source = open_source(source, band=band)
        self.shape = self.source.shape
        self.name = self.source.name
        factor = 1
        while max(self.shape) // factor > OVERVIEW:
            factor *= 2
        self.factor = factor
        self.overview = self.source.overview(factor)
        self.limits = tone_limits(self.overview.amplitude, self.overview.mask)
        self.tile = lru_cache(maxsize=512)(self._tile)

    def _tile(self, level: int, column: int, row: int) -> bytes:
        """Return one tile as WebP.

        Raises
        ------
        ParameterError
            No such tile.
        """
        import cv2

        scale = 2**level if 0 <= level <= 20 else 0
        side = TILE * scale
        inside = scale and 0 <= column * side < self.shape[1] and 0 <= row * side < self.shape[0]
        if not inside:
            raise ParameterError(f"there is no tile {column}, {row} of level {level}")
        if scale >= self.factor and level > DIRECT:
            image, scale = self._cut(column, row, side), scale // self.factor
        else:
            image = self.source.read(Window(column * side, row * side, side, side))
        amplitude, mask = resized(image.amplitude, image.mask, 1 / scale)
        _, webp = cv2.imencode(".webp", tone(amplitude, mask, self.limits), [cv2.IMWRITE_WEBP_QUALITY, 90])
        return bytes(webp.tobytes())

    def _cut(self, column: int, row: int, side: int) -> Image:
        """A part of the overview, padded where it ends."""
        part = side // self.factor
        top, left = row * part, column * part
        pixels, mask = np.zeros((part, part), np.float32), np.zeros((part, part), np.bool_)
        seen = self.overview.amplitude[top : top + part, left : left + part]
        pixels[: seen.shape[0], : seen.shape[1]] = seen
        mask[: seen.shape[0], : seen.shape[1]] = self.overview.mask[top : top + part, left : left + part]
        return Image(pixels, mask)
