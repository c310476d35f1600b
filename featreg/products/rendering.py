"""One window of a product: what is read of the secondary for it, and what it holds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.interfaces import Model
from featreg.io.raster_source import RasterSource, Window
from featreg.products.deramping import Ramp, with_ramp, without_ramp
from featreg.products.lattice import Lattice, lattice_of
from featreg.products.resample import TAPS, Support, support_box
from featreg.products.samples import Encoding
from featreg.types import BoolArray

#: Most pixels of the secondary that one output window reads.
MOST_READ = 3 << 20


@dataclass(frozen=True, eq=False)
class Job:
    """What one window needs."""

    sources: tuple[RasterSource, ...]
    encodings: tuple[Encoding, ...]
    model: Model
    resampling: str
    ramp: Ramp | None

    def render(self, window: Window) -> tuple[NDArray[Any], int]:
        """Return the numbers (bands, h, w) of a window and how many pixels of its first band are data."""
        lattice = lattice_of(self.model, window.x, window.y, window.shape)
        box = support_box(lattice, self.sources[0].shape, self.resampling)
        if box is not None and box.width * box.height > MOST_READ and min(window.shape) > 32:
            return self._by_parts(window)
        bands, good = [], 0
        for k, (source, encoding) in enumerate(zip(self.sources, self.encodings, strict=True)):
            values, mask = self._sampled(source, lattice, box)
            good += int(mask.sum()) if k == 0 else 0
            bands.append(encoding.encode(values, mask))
        return np.stack(bands), good

    def _by_parts(self, window: Window) -> tuple[NDArray[Any], int]:
        """A window that shows much of the secondary, a quarter at a time."""
        half_h, half_w = window.height // 2, window.width // 2
        rows = ((window.y, half_h), (window.y + half_h, window.height - half_h))
        cols = ((window.x, half_w), (window.x + half_w, window.width - half_w))
        parts = [[self.render(Window(x, y, w, h)) for x, w in cols] for y, h in rows]
        whole = np.concatenate([np.concatenate([p[0] for p in line], axis=2) for line in parts], axis=1)
        return whole, sum(p[1] for line in parts for p in line)

    def _sampled(self, source: RasterSource, lattice: Lattice, box: Window | None) -> tuple[NDArray[Any], BoolArray]:
        if box is None:
            kind = np.complex64 if source.is_complex else np.float32
            return np.zeros(lattice.shape, kind), np.zeros(lattice.shape, np.bool_)
        image = source.read(box)
        pixels: NDArray[Any] = image.pixels
        if self.ramp is not None:
            pixels = without_ramp(pixels, self.ramp, box.x, box.y)
        values, mask = Support(pixels, image.mask, self.resampling).sample(lattice.moved(-box.x, -box.y))
        if self.ramp is not None:
            values, mask = with_ramp(values, mask, self.ramp, lattice, TAPS[self.resampling] // 2)
        return (values if image.is_complex else np.maximum(values, 0)), mask
