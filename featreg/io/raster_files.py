"""The files behind scenes: what they say of themselves, and windows of their samples.

One-band rasters of GDAL are read by windows, NPY files through a memory map. Files that must be looked at as a whole
(palettes, three equal bands, MATLAB) are read once in each process, and windows are cut from them.
"""

from __future__ import annotations

import os
import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.io.masks import holds_nodata
from featreg.io.readers import Raster, gdal_dataset, geolocation_of, quiet, read_raster, reason, shown, stated_scale
from featreg.io.scales import real_pixels
from featreg.io.window import Window
from featreg.runtime.numpy_files import load_array
from featreg.types import BoolArray, Geolocation

#: Bytes that GDAL may keep of the tiles it has decoded, in each process; two rows of tiles of a wide scene.
CACHE_BYTES = 64 << 20
#: Open files a thread keeps.
OPEN_FILES = 4
#: Side of a square of as many pixels as are read to tell the scale of real samples.
SAMPLE = 1024

#: Names one version of a file: path, size, time of its last change.
Stamp: TypeAlias = tuple[str, int, int]


@dataclass(frozen=True, eq=False)
class Head:
    """What a file says of itself, the samples aside."""

    shape: tuple[int, int]
    dtype: str
    geolocation: Geolocation | None
    way: str  # "windows", "map" or "whole"


def physical(raster: Raster) -> NDArray[Any]:
    """The samples with the file's own gain and offset applied; untouched where it has none."""
    if (raster.gain, raster.offset) == (1.0, 0.0):
        return raster.samples
    return np.asarray(raster.samples * raster.gain + raster.offset)


def stamp_of(path: str) -> Stamp:
    """Names one version of a file; a missing file is left to the reader, whose message says so."""
    try:
        known = os.stat(path)
    except (OSError, ValueError):
        return path, -1, -1
    return path, known.st_size, known.st_mtime_ns


@lru_cache(maxsize=64)
def read_head(stamp: Stamp, band: int) -> Head:
    path = stamp[0]
    if Path(path).suffix.lower() == ".npy":
        array = _mapped(stamp)
        return Head((array.shape[0], array.shape[1]), array.dtype.name, None, "map")
    with gdal_dataset(path) as dataset:
        if dataset is not None and _by_windows(dataset, band):
            shape = dataset.height, dataset.width
            kind = _dtype_name(dataset.dtypes[max(band, 1) - 1])
            return Head(shape, kind, geolocation_of(dataset), "windows")
        if dataset is not None and band > dataset.count:
            raise InputError(f"{path}: has {dataset.count} bands, band {band} was asked for")
    raster = _whole(stamp)
    return Head((raster.samples.shape[0], raster.samples.shape[1]), raster.dtype, raster.geolocation, "whole")


def _by_windows(dataset: Any, band: int) -> bool:
    from rasterio.enums import ColorInterp

    if not 0 <= band <= dataset.count or len(dataset.subdatasets) > 1:
        return False
    data = [i + 1 for i, colour in enumerate(dataset.colorinterp) if colour != ColorInterp.alpha]
    chosen = data == [1] if band == 0 else band in data
    return chosen and dataset.colorinterp[max(band, 1) - 1] != ColorInterp.palette and dataset.driver != "JPEG"


def _dtype_name(name: str) -> str:
    return "complex64" if name == "complex_int16" else name


def read_samples(path: str, band: int, window: Window) -> Raster:
    """The samples of the part of a window inside the scene; (0, 0) of them where it lies outside."""
    stamp = stamp_of(path)
    head = read_head(stamp, band)
    part = window.within(head.shape)
    if part is None:
        return Raster(np.zeros((0, 0), np.dtype(head.dtype)), head.dtype)
    rows, cols = slice(part.y, part.y + part.height), slice(part.x, part.x + part.width)
    if head.way == "map":
        array = _mapped(stamp)
        return Raster(np.array(array[rows, cols]), array.dtype.name)
    if head.way == "whole":
        raster = _whole(stamp)
        mask = None if raster.mask is None else raster.mask[rows, cols]
        return replace(raster, samples=raster.samples[rows, cols].copy(), mask=mask)
    return _gdal_samples(path, stamp, max(band, 1), part)


def _gdal_samples(path: str, stamp: Stamp, band: int, part: Window) -> Raster:
    import rasterio
    from rasterio.windows import Window as RasterioWindow

    box = RasterioWindow(part.x, part.y, part.width, part.height)
    with quiet(), rasterio.Env(GDAL_CACHEMAX=CACHE_BYTES):
        try:
            dataset = _opened(path, stamp)
            samples = dataset.read(band, window=box)
            mask = shown(dataset, band, box)
        except rasterio.errors.RasterioError as error:
            message = f"{path}: the file is broken or cut short ({reason(error)}); a complete file is needed"
            raise InputError(message) from error
        return Raster(
            samples,
            _dtype_name(dataset.dtypes[band - 1]),
            mask,
            dataset.nodatavals[band - 1],
            dataset.scales[band - 1],
            dataset.offsets[band - 1],
            said=stated_scale(dataset, band),
        )


_local = threading.local()


def _opened(path: str, stamp: Stamp) -> Any:
    """An open dataset of this thread and process: GDAL's handles may be shared by neither."""
    if getattr(_local, "process", None) != os.getpid():
        # A handle that came through a fork is dropped without being closed: its descriptor is the parent's too.
        _local.inherited, _local.process, _local.files = getattr(_local, "files", None), os.getpid(), OrderedDict()
    files: OrderedDict[Any, Any] = _local.files
    if stamp not in files:
        while len(files) >= OPEN_FILES:
            files.popitem(last=False)[1][0].close()
        holder = gdal_dataset(path)
        files[stamp] = (_Kept(holder), holder.__enter__())
    files.move_to_end(stamp)
    return files[stamp][1]


class _Kept:
    """A context that was entered, to be left later."""

    def __init__(self, context: Any) -> None:
        self._context = context

    def close(self) -> None:
        self._context.__exit__(None, None, None)


@lru_cache(maxsize=4)
def _mapped(stamp: Stamp) -> NDArray[Any]:
    path = stamp[0]
    try:
        array = load_array(path, "r")
    except (OSError, ValueError):
        array = read_raster(path).samples  # says what is wrong with it
    if array.ndim != 2 or array.dtype.kind not in "uifc":
        raise InputError(f"{path}: holds {array.dtype} of shape {array.shape}, one band of numbers (H, W) is needed")
    return np.asarray(array) if not isinstance(array, np.memmap) else array


@lru_cache(maxsize=2)
def _whole(stamp: Stamp) -> Raster:
    return read_raster(stamp[0])


@lru_cache(maxsize=64)
def inferred_scale(
    stamp: Stamp, nodata: complex | None, band: int, masked: Callable[[Window], BoolArray | None]
) -> str:
    """What real samples are, told from four strips over the scene as `featreg.io.as_image` does from all of them.

    A scene of no more pixels than the strips hold is looked at as a whole. `masked` gives the user's mask of a window.
    """
    path = stamp[0]
    head = read_head(stamp, band)
    height, width = head.shape
    rows = max(1, SAMPLE**2 // 4 // width)
    if height <= 4 * rows:
        rows = height
    parts = []
    for top in np.unique(np.linspace(0, max(0, height - rows), 4).astype(int)).tolist():
        window = Window(0, top, width, rows)
        raster = read_samples(path, band, window)
        if raster.samples.dtype.kind == "u" and raster.offset >= 0 and raster.gain >= 0:
            return "amplitude"
        hole = holds_nodata(raster.samples, raster.nodata if nodata is None else nodata)
        valid = np.ones(raster.samples.shape, np.bool_) if hole is None else ~hole
        for more in (raster.mask, masked(window)):
            if more is not None:
                valid &= more
        values = physical(raster)[valid]
        parts.append(values[np.isfinite(values)])
    values = np.concatenate(parts)
    if not len(values):
        return "amplitude"
    return real_pixels(values[None], None, None, path, owned=False, content=False, said=raster.said)[2]
