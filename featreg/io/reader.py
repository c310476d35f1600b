"""What every opened file gives: its bands, where they lie, and their samples as they are, by windows or whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from featreg.io.window import Window
from featreg.types import BoolArray, Geolocation


@dataclass(frozen=True)
class Band:
    """One band, dataset or variable of a file, as the file describes it.

    Parameters
    ----------
    name : what it may be asked for by: a polarisation, the path of a dataset; "" where the file gives it none
    shape : (H, W)
    dtype : of the samples in the file; complex integers as "complex_int16"
    role : "red", "green", "blue" or "alpha" where the file says so, "coordinate" of longitudes and latitudes of every
        pixel, else ""
    said : the scale that its names and units state, if any; see `featreg.io.scales.scale_in_words`
    nodata : the value of samples that are not data, if the file states one
    gain, offset : value = gain * sample + offset
    said_by_file : whether `said` is what the name of the file states, not something inside it
    palette : digest of the colours that stand for its samples; "" where they stand for themselves
    """

    name: str
    shape: tuple[int, int]
    dtype: str
    role: str = ""
    said: str | None = None
    nodata: float | None = None
    gain: float = 1.0
    offset: float = 0.0
    said_by_file: bool = False
    palette: str = ""

    @property
    def is_complex(self) -> bool:
        return self.dtype.startswith("complex")


@dataclass(frozen=True, eq=False)
class Raster:
    """Samples of one band, whole or of a window.

    Parameters
    ----------
    samples : (H, W) in the file's dtype (complex_int16 as complex64)
    dtype : the name of that dtype
    mask : (H, W) bool, True = valid, from an alpha band, a mask band or a transparent palette entry; None = all valid
    nodata : the file's nodata value, compared with `samples`
    gain, offset : value = gain * sample + offset
    geolocation : where the file says the image lies; left out of windows
    said : the scale that the file's names and units of the band state, if any
    band : what was read of a file of several bands
    factor : (H, W) float32 by which values are multiplied for a calibrated quantity; None = they are left
    """

    samples: NDArray[Any]
    dtype: str
    mask: BoolArray | None = None
    nodata: float | None = None
    gain: float = 1.0
    offset: float = 0.0
    geolocation: Geolocation | None = None
    said: str | None = None
    band: str | None = None
    factor: NDArray[np.float32] | None = None


class Reader(Protocol):
    """An open file of any format, for one thread; bands are counted from 0 here.

    `whole` says that a window costs as much as the whole, so that whoever reads windows had better keep the whole.
    `files` are those on disk that hold the samples, none where they lie elsewhere.
    """

    driver: str
    whole: bool

    @property
    def bands(self) -> Sequence[Band]:
        """What the file holds."""

    @property
    def files(self) -> Sequence[str]:
        """Paths of the files that hold the samples, the one that was opened first."""

    def geolocation(self, band: int) -> Geolocation | None:
        """Where a band lies, None where the file does not say."""

    def read(self, band: int, window: Window | None = None) -> Raster:
        """The samples of a window that lies inside the band, or of all of it.

        Raises
        ------
        InputError
            They cannot be read.
        """

    def close(self) -> None:
        """Close the file."""


def physical(raster: Raster) -> NDArray[Any]:
    """The samples with the file's own gain and offset, and a calibration, applied; untouched where it has none."""
    values = raster.samples
    if (raster.gain, raster.offset) != (1.0, 0.0):
        values = np.asarray(values * raster.gain + raster.offset)
    return values if raster.factor is None else np.asarray(values * raster.factor)
