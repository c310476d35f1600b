"""Arrays in files of NumPy and MATLAB."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.io.gdal_errors import decoding
from featreg.io.mat_structure import check_mat
from featreg.io.reader import Band, Raster
from featreg.io.scales import scale_in_words
from featreg.io.window import Window
from featreg.types import Geolocation

NUMERIC = ("double", "single", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")


@dataclass(eq=False)
class NumpyReader:
    """An NPY file, through a memory map."""

    array: NDArray[Any]
    files: Sequence[str]
    driver: str = "NPY"
    whole: bool = False

    @property
    def bands(self) -> Sequence[Band]:
        return [Band("", (self.array.shape[0], self.array.shape[1]), self.array.dtype.name)]

    def geolocation(self, band: int) -> Geolocation | None:
        return None

    def read(self, band: int, window: Window | None = None) -> Raster:
        return Raster(np.array(self.array[slices(window)]), self.array.dtype.name)

    def close(self) -> None:
        """Nothing: the map ends with the array."""


def open_numpy(path: Path) -> NumpyReader:
    """Open an NPY file.

    Raises
    ------
    InputError
        It is broken, holds Python objects, or is no 2-D array of numbers or bool.
    """
    with decoding(path, "NPY"):
        try:
            array = np.load(path, mmap_mode="r", allow_pickle=False)
        except ValueError as error:
            if "object" not in str(error).lower():
                raise
            raise InputError(f"{path}: holds pickled Python objects, a plain 2-D numeric array is needed") from error
    if array.ndim != 2:
        raise InputError(f"{path}: has shape {array.shape}, one band as an (H, W) array is needed, e.g. a[..., 0]")
    if array.dtype.kind not in "buifc":
        raise InputError(f"{path}: holds {array.dtype} values, real or complex numbers are needed")
    return NumpyReader(array, [str(path)])


@dataclass(eq=False)
class MatlabReader:
    """The 2-D numeric variables of a MATLAB 5 file."""

    path: Path
    bands: Sequence[Band]
    driver: str = "MATLAB"
    whole: bool = True

    @property
    def files(self) -> Sequence[str]:
        return [str(self.path)]

    def geolocation(self, band: int) -> Geolocation | None:
        return None

    def read(self, band: int, window: Window | None = None) -> Raster:
        from scipy.io import loadmat

        known = self.bands[band]
        with decoding(self.path, "MATLAB"):
            # mat_dtype=True would drop the imaginary part; without it, doubles come as the small integers they are
            # kept in.
            array = loadmat(self.path, variable_names=[known.name])[known.name]
        if array.dtype.kind in "iu" and known.dtype in ("float64", "float32"):
            array = array.astype(known.dtype)
        return Raster(array[slices(window)], array.dtype.name, said=known.said)

    def close(self) -> None:
        """Nothing is open."""


def open_matlab(path: Path) -> MatlabReader:
    """Open a MATLAB file of version 4 or 5.

    Raises
    ------
    InputError
        It is broken, or holds no 2-D numeric variable.
    """
    from scipy.io import whosmat

    with decoding(path, "MATLAB"):
        check_mat(path)
        contents = whosmat(path)
        # Every MATLAB number is 2-D: scalars and vectors are no images.
        kinds = {"double": "float64", "single": "float32"}
        bands = [
            Band(name, (shape[0], shape[1]), kinds.get(kind, kind), said=scale_in_words(name))
            for name, shape, kind in contents
            if kind in NUMERIC and len(shape) == 2 and min(shape) > 1
        ]
        if not bands:
            held = ", ".join(f"{n} ({'x'.join(map(str, s))} {k})" for n, s, k in contents[:24]) or "no variables"
            raise InputError(f"{path}: has no 2-D numeric variable, one is needed; it holds {held}")
    return MatlabReader(path, bands)


def slices(window: Window | None) -> tuple[slice, slice]:
    """Rows and columns of a window that lies inside an array; everything for None."""
    if window is None:
        return slice(None), slice(None)
    return slice(window.y, window.y + window.height), slice(window.x, window.x + window.width)
