"""What a scene is to whoever reads it, and what sources share whose samples are read by windows."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from featreg.errors import ParameterError
from featreg.io.bands import BandLike
from featreg.io.nodata import holds_nodata
from featreg.io.reader import Raster, physical
from featreg.io.scales import complex_pixels, real_pixels
from featreg.io.window import Window
from featreg.types import BoolArray, Geolocation, Image, everywhere, read_only


class Source(Protocol):
    """A scene: of a file, an array or an image in memory."""

    @property
    def name(self) -> str:
        """What it is called in messages and results."""

    @property
    def path(self) -> str:
        """The name by which its file is found again; what it is called where there is none."""

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""

    @property
    def dtype(self) -> str:
        """Name of the dtype of the samples before any conversion."""

    @property
    def band(self) -> BandLike:
        """What was asked for of a file of several bands."""

    @property
    def is_complex(self) -> bool:
        """Whether its samples are complex."""

    @property
    def geolocation(self) -> Geolocation | None:
        """Where it lies."""

    @property
    def known_scale(self) -> str:
        """What the samples are: "amplitude", "intensity", "db" or "complex"."""

    def read(self, window: Window) -> Image:
        """Return the pixels of a window; those outside the scene are masked."""

    def overview(self, factor: int) -> Image:
        """Return every `factor` x `factor` pixels averaged to one; see `overview_of`."""

    def identity(self) -> dict[str, Any]:
        """What tells this scene from another, as JSON can hold it."""

    def shareable(self, folder: Callable[[], Path], stem: str) -> Source:
        """The scene as processes find it that share neither this memory nor this folder.

        `folder` gives one for what must be written, under names that begin with `stem`.
        """


def overview_of(source: Source, factor: int) -> Image:
    """Return every `factor` x `factor` pixels averaged to one (root mean square of the amplitude), by strips.

    The pixel (0, 0) of the overview has its centre at ``(factor - 1) / 2``. What does not fill a pixel at the lower
    and right border is left out. A pixel is valid where more than half of what it averages is.
    """
    if factor < 1:
        raise ParameterError(f"an overview needs factor >= 1, got {factor}")
    height, width = source.shape[0] // factor, source.shape[1] // factor
    if height < 1 or width < 1:
        raise ParameterError(f"{source.name}: an overview of 1 / {factor} of {source.shape} has no pixel")
    import cv2

    pixels, mask = np.empty((height, width), np.float32), np.empty((height, width), np.bool_)
    step = max(1, 512 // factor)
    for top in range(0, height, step):
        rows = min(step, height - top)
        strip = source.read(Window(0, top * factor, width * factor, rows * factor))
        size = (width, rows)
        cells = cv2.resize(np.square(strip.amplitude), size, interpolation=cv2.INTER_AREA)
        if strip.all_valid:
            np.sqrt(cells, out=pixels[top : top + rows])
            mask[top : top + rows] = True
            continue
        share = cv2.resize(strip.mask.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        good = share > 0.5
        pixels[top : top + rows] = np.sqrt(np.divide(cells, share, out=np.zeros_like(cells), where=good))
        mask[top : top + rows] = good
    return Image(read_only(pixels), read_only(mask), None, source.name, source.dtype, source.known_scale)


class SampleSource(ABC):
    """What sources share whose samples are read by windows and turned into amplitude here.

    A kind of source says what `name`, `shape`, `dtype` and `known_scale` are, and reads `samples`; `nodata` overrides
    what these say of themselves.
    """

    nodata: complex | None

    @property
    @abstractmethod
    def name(self) -> str:
        """What it is called in messages and results."""

    @property
    @abstractmethod
    def shape(self) -> tuple[int, int]:
        """(H, W)."""

    @property
    @abstractmethod
    def dtype(self) -> str:
        """Name of the dtype of the samples before any conversion."""

    @property
    @abstractmethod
    def known_scale(self) -> str:
        """What the samples are: "amplitude", "intensity", "db" or "complex"."""

    @abstractmethod
    def samples(self, window: Window) -> Raster:
        """The samples of the part of a window inside the scene, as they are; (0, 0) of them where it lies outside."""

    @property
    def is_complex(self) -> bool:
        return self.dtype.startswith("complex")

    def masked(self, window: Window) -> BoolArray | None:
        """The user's mask of the part of a window that lies in the scene, None = all valid."""
        return None

    def read(self, window: Window) -> Image:
        """Return the pixels of a window; those outside the scene are masked.

        Raises
        ------
        InputError
            The samples cannot be read. A window without any valid pixel, or of one value, is no error.
        """
        raster = self.samples(window)
        samples, valid = raster.samples, raster.mask
        hole = holds_nodata(samples, raster.nodata if self.nodata is None else self.nodata)
        for more in (None if hole is None else ~hole, self.masked(window)):
            if more is not None:
                valid = more if valid is None else valid & more
        samples = physical(raster)
        pixels: NDArray[Any]
        if samples.dtype.kind == "c":
            pixels, valid = complex_pixels(samples, valid, self.name, owned=True, content=False)
        else:
            pixels, valid, _ = real_pixels(samples, valid, self.known_scale, self.name, owned=True, content=False)
        if valid is None:
            valid = everywhere((pixels.shape[0], pixels.shape[1]))
        else:
            pixels[~valid] = 0
        return Image(*padded(pixels, valid, window, self.shape), None, self.name, raster.dtype, self.known_scale)

    def overview(self, factor: int) -> Image:
        """As `overview_of`."""
        return overview_of(cast(Source, self), factor)


def spooled(source: Source, folder: Path, stem: str) -> Path:
    """Write the pixels to a NPY file, invalid ones as NaN, for workers that do not share this memory.

    Real samples are then amplitude, whatever they were.
    """
    path = folder / f"{stem}.npy"
    height, width = source.shape
    kind = np.complex64 if source.is_complex else np.float32
    target = np.lib.format.open_memmap(path, mode="w+", dtype=kind, shape=(height, width))
    for top in range(0, height, 512):
        strip = source.read(Window(0, top, width, min(512, height - top)))
        target[top : top + 512] = np.where(strip.mask, strip.pixels, np.nan)
    target.flush()
    return path


def padded(
    pixels: NDArray[Any], mask: BoolArray, window: Window, shape: tuple[int, int]
) -> tuple[NDArray[Any], BoolArray]:
    """The part inside the scene on the whole window, what is outside masked; locked."""
    part = window.within(shape)
    if part == window:
        return read_only(pixels), read_only(mask)
    whole, valid = np.zeros(window.shape, pixels.dtype), np.zeros(window.shape, np.bool_)
    if part is not None:
        rows = slice(part.y - window.y, part.y - window.y + part.height)
        cols = slice(part.x - window.x, part.x - window.x + part.width)
        whole[rows, cols], valid[rows, cols] = pixels, mask
    return read_only(whole), read_only(valid)
