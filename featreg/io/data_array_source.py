"""A DataArray of xarray as a scene that is read by windows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from featreg.errors import InputError
from featreg.io.bands import BandLike, Choice, choose, read_choice
from featreg.io.data_arrays import NAME, DataArrayReader
from featreg.io.masks import MaskLike, as_mask
from featreg.io.raster_files import scale_by_strips
from featreg.io.reader import Raster
from featreg.io.source import SampleSource, Source, spooled
from featreg.io.window import Window
from featreg.runtime.digests import digest_bytes
from featreg.types import BoolArray, Geolocation

#: Rows that are read at once where all of a scene must be looked at.
STRIP = 512


@dataclass(frozen=True, eq=False)
class DataArraySource(SampleSource):
    """A scene in a DataArray; of one of dask only the chunks behind a window are computed.

    Parameters
    ----------
    array : the DataArray
    scale, nodata, band : as of `featreg.io.raster_source.RasterSource`
    mask : (H, W) bool, True = data
    opened : makes the source of a file of its path and its scale
    """

    array: Any
    opened: Callable[..., Source]
    scale: str | None = None
    nodata: complex | None = None
    band: BandLike = None
    mask: BoolArray | None = None

    @cached_property
    def _reader(self) -> DataArrayReader:
        return DataArrayReader(self.array)

    @cached_property
    def _choice(self) -> Choice:
        return choose(self._reader.bands, self.band, self._reader.name)

    @property
    def name(self) -> str:
        return NAME

    @property
    def path(self) -> str:
        return NAME

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self._reader.shape

    @property
    def dtype(self) -> str:
        return "complex64" if self._choice.how == "iq" else self._reader.bands[self._choice.bands[0]].dtype

    @property
    def geolocation(self) -> Geolocation | None:
        return self._reader.geolocation(self._choice.bands[0])

    @cached_property
    def known_scale(self) -> str:  # told once
        if self.is_complex:
            return "complex"
        return self.scale or scale_by_strips(self.shape, self.samples, self.nodata, self.masked, NAME)

    def samples(self, window: Window) -> Raster:
        part = window.within(self.shape)
        if part is None:
            kind = "complex64" if self.is_complex else self.dtype
            return Raster(np.zeros((0, 0), kind), self.dtype)
        found = read_choice(self._reader, self._choice, part)
        # What is made of the samples is made in place.
        return replace(found, samples=np.array(found.samples))

    def masked(self, window: Window) -> BoolArray | None:
        part = window.within(self.shape)
        if self.mask is None or part is None:
            return None
        return self.mask[part.y : part.y + part.height, part.x : part.x + part.width]

    def identity(self) -> dict[str, Any]:
        """A digest of what is read, strip by strip."""
        height, width = self.shape
        strips = [self.read(Window(0, top, width, min(STRIP, height - top))) for top in range(0, height, STRIP)]
        sums = [digest_bytes(np.ascontiguousarray(part)) for strip in strips for part in (strip.pixels, strip.mask)]
        return {"sha256": digest_bytes("".join(sums).encode()), "shape": [height, width], "scale": self.known_scale}

    def shareable(self, folder: Callable[[], Path], stem: str) -> Source:
        """Written to a file, strip by strip: what stands behind an array of somebody else may not bear a fork."""
        path = spooled(self, folder(), stem)
        return self.opened(str(path), scale=None if self.is_complex else "amplitude")


def open_data_array(
    array: Any,
    opened: Callable[..., Source],
    *,
    mask: MaskLike | None,
    nodata: complex | None,
    scale: str | None,
    band: BandLike,
) -> DataArraySource:
    """Return the source of a DataArray, checked; parameters and errors as `featreg.io.as_image`.

    `opened` makes the source of a file of its path and its scale.
    """
    source = DataArraySource(array, opened, scale, nodata, band)
    shape = source.shape
    if min(shape) < 16:
        raise InputError(f"{NAME}: {shape[1]} x {shape[0]} pixels is too small, at least 16 x 16 is needed")
    if source.is_complex and scale in ("intensity", "db"):
        raise InputError(f"{NAME}: holds complex samples, scale='{scale}' cannot be; leave scale out")
    return source if mask is None else replace(source, mask=as_mask(mask, shape, NAME))
