"""What the numbers in a product are: the user's own values, in the file's own dtype, with a value for no data."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.io.raster_source import RasterSource
from featreg.types import BoolArray

#: Integers that a product keeps; all other real samples become float32.
INTEGERS = ("uint8", "int16", "uint16", "int32", "uint32")


@dataclass(frozen=True)
class Encoding:
    """From amplitude or complex samples back to the numbers of the file they came from.

    Parameters
    ----------
    dtype : of the product: uint8, int16, uint16, int32 and uint32 are kept, complex samples are complex64, all other
        float32
    nodata : value of pixels that are not data: the file's own where this dtype has it; else NaN for float32, 0 for
        unsigned and the lowest value for signed integers. Complex pixels are nan+nanj, and none is declared.
    scale : what the file's samples are: "amplitude", "intensity", "db" or "complex"
    gain, offset : value = gain * sample + offset in the file; the product has the same
    """

    dtype: str
    nodata: float | None
    scale: str
    gain: float = 1.0
    offset: float = 0.0

    def encode(self, values: NDArray[Any], mask: BoolArray) -> NDArray[Any]:
        """Return the numbers to write for (h, w) float32 amplitude or complex64 samples."""
        if self.dtype == "complex64":
            return np.where(mask, values, np.complex64(complex(np.nan, np.nan)))
        with np.errstate(divide="ignore"):
            if self.scale == "intensity":
                values = values * values
            elif self.scale == "db":
                values = np.where(values > 0, 20.0 * np.log10(values), -np.inf)
                mask = mask & np.isfinite(values)
        if (self.gain, self.offset) != (1.0, 0.0):
            values = (values - self.offset) / self.gain
        wanted = np.dtype(self.dtype)
        nodata = math.nan if self.nodata is None else self.nodata
        if wanted.kind == "f":
            return np.where(mask, values, nodata).astype(wanted)
        limits = np.iinfo(wanted)
        whole = np.clip(np.rint(values.astype(np.float64)), limits.min, limits.max)
        # A sample that rounds to the value for no data would be lost: it moves to the next one.
        whole[whole == nodata] += 1 if nodata < limits.max else -1
        return np.where(mask, whole, nodata).astype(wanted)


def encoding_of(source: RasterSource) -> Encoding:
    """Return how a product of this source is to be written."""
    first = source.head.first
    own, gain, offset = first.nodata, first.gain, first.offset
    if source.head.choice.how != "one":
        gain, offset = 1.0, 0.0
    if source.is_complex:
        return Encoding("complex64", None, "complex")
    if source.calibrate is not None:
        # Whoever opens a file of sigma0 expects sigma0, not its root.
        return Encoding("float32", math.nan, "intensity")
    given = source.nodata if source.nodata is not None else own
    nodata = float(given.real) if given is not None else math.nan
    dtype = source.dtype if source.dtype in INTEGERS else "float32"
    if dtype == "float32":
        # One of float64 may lie beyond.
        nodata = nodata if abs(nodata) <= float(np.finfo(np.float32).max) or math.isinf(nodata) else math.nan
    else:
        limits = np.iinfo(dtype)
        if not (nodata.is_integer() and limits.min <= nodata <= limits.max):
            nodata = 0.0 if limits.min == 0 else float(limits.min)
    return Encoding(dtype, nodata, source.known_scale, gain, offset)
