"""Scenes read by windows: the pixels of a file as `Image` objects, never the whole scene in memory.

The rules are those of `featreg.io.as_image`: linear amplitude or complex64, invalid pixels masked. One-band rasters of
GDAL are read by windows, NPY files through a memory map. Files that must be looked at as a whole (palettes, three equal
bands, MATLAB) are read once in each process, and windows are cut from them.
"""

from __future__ import annotations

import hashlib
import os
import threading
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError, ParameterError
from featreg.masks import MaskLike, holds_nodata, polygons_of
from featreg.masks import inside_polygons as inside
from featreg.readers import Raster, gdal_dataset, geolocation_of, quiet, read_raster, reason
from featreg.scales import complex_pixels, real_pixels
from featreg.types import BoolArray, FloatArray, Geolocation, Image

#: Bytes that GDAL may keep of the tiles it has decoded, in each process; two rows of tiles of a wide scene.
CACHE_BYTES = 64 << 20
#: Open files a thread keeps.
OPEN_FILES = 4
#: Longer side of the sample from which the scale of real samples is told.
SAMPLE = 1024
#: Bytes at either end of a file that identify it together with its size and time.
FINGERPRINT = 1 << 16


@dataclass(frozen=True)
class Window:
    """A rectangle of whole pixels: columns x .. x + width - 1, rows y .. y + height - 1; it may reach outside."""

    x: int
    y: int
    width: int
    height: int

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise ParameterError(f"a window needs width and height >= 1, got {self.width} x {self.height}")

    @property
    def origin(self) -> FloatArray:
        """(x, y) of the first pixel's centre."""
        return np.array([self.x, self.y], np.float64)

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self.height, self.width

    def grown(self, margin: int) -> Window:
        """The window with `margin` pixels more on every side."""
        return Window(self.x - margin, self.y - margin, self.width + 2 * margin, self.height + 2 * margin)

    def within(self, shape: tuple[int, int]) -> Window | None:
        """The part inside an image of (H, W), or None."""
        x, y = max(self.x, 0), max(self.y, 0)
        right, bottom = min(self.x + self.width, shape[1]), min(self.y + self.height, shape[0])
        return Window(x, y, right - x, bottom - y) if right > x and bottom > y else None

    def holds(self, xy: FloatArray) -> BoolArray:
        """(N,) whether each (N, 2) point lies on a pixel of the window, half-open: neighbours share no point."""
        x, y = np.floor(xy + 0.5).T
        return np.asarray(
            (x >= self.x) & (x < self.x + self.width) & (y >= self.y) & (y < self.y + self.height), np.bool_
        )


@dataclass(frozen=True)
class RasterSource:
    """A scene in a file, read by windows; picklable, and holds no open file itself.

    Parameters
    ----------
    path : of the file
    scale : "amplitude", "intensity" or "db", what real samples are; None tells it from a sample of the scene, as
        `featreg.io.as_image` does from the whole
    nodata : value of samples that are not data; None takes the file's own
    band : counted from 1; that of a file of several bands must be chosen by a number above 1, or the file split
    mask : pixels that are data: path of an image of the same size, or polygons as nested tuples of (x, y)

    Notes
    -----
    Open files are kept for each thread and process (`OPEN_FILES` of them), so that a block does not pay for opening.
    """

    path: str
    scale: str | None = None
    nodata: complex | None = None
    band: int = 1
    mask: Any = field(default=None, repr=False)

    @property
    def name(self) -> str:
        return self.path

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return _head(self).shape

    @property
    def dtype(self) -> str:
        """Name of the dtype of the samples in the file."""
        return _head(self).dtype

    @property
    def is_complex(self) -> bool:
        return self.dtype.startswith("complex")

    @property
    def geolocation(self) -> Geolocation | None:
        """Where the scene lies, as its file says it."""
        return _head(self).geolocation

    @property
    def known_scale(self) -> str:
        """What the samples are, told where it was not stated: "amplitude", "intensity", "db" or "complex"."""
        return "complex" if self.is_complex else (self.scale or _told_scale(self))

    def read(self, window: Window) -> Image:
        """Return the pixels of a window; those outside the scene are masked.

        Raises
        ------
        InputError
            The file cannot be read. A window without any valid pixel, or of one value, is no error.
        """
        return self._image(window, _samples(self, window))

    def overview(self, factor: int) -> Image:
        """Return every `factor` x `factor` pixels averaged to one (root mean square of the amplitude), by strips.

        The pixel (0, 0) of the overview has its centre at ``(factor - 1) / 2``. What does not fill a pixel at the lower
        and right border is left out. A pixel is valid where more than half of what it averages is.
        """
        if factor < 1:
            raise ParameterError(f"an overview needs factor >= 1, got {factor}")
        height, width = self.shape[0] // factor, self.shape[1] // factor
        if height < 1 or width < 1:
            raise ParameterError(f"{self.path}: an overview of 1 / {factor} of {self.shape} has no pixel")
        pixels, mask = np.empty((height, width), np.float32), np.empty((height, width), np.bool_)
        step = max(1, 512 // factor)
        for top in range(0, height, step):
            rows = min(step, height - top)
            strip = self.read(Window(0, top * factor, width * factor, rows * factor))
            cells = (strip.amplitude**2).reshape(rows, factor, width, factor).mean(axis=(1, 3))
            share = strip.mask.reshape(rows, factor, width, factor).mean(axis=(1, 3))
            good = share > 0.5
            pixels[top : top + rows] = np.sqrt(np.divide(cells, share, out=np.zeros_like(cells), where=good))
            mask[top : top + rows] = good
        return Image(pixels, mask, None, self.path, self.dtype, self.known_scale)

    def identity(self) -> dict[str, Any]:
        """What tells this source from another: size, time and both ends of its files, scale, nodata and band."""
        mask = fingerprint(self.mask) if isinstance(self.mask, str) else self.mask
        return {
            **fingerprint(self.path),
            "shape": list(self.shape),
            "scale": self.known_scale,
            "nodata": None if self.nodata is None else str(self.nodata),
            "band": self.band,
            "mask": mask,
        }

    def checked(self) -> RasterSource:
        """Return the source with its scale settled, after all that can be checked without reading the whole scene."""
        shape = self.shape
        if min(shape) < 16:
            raise InputError(f"{self.path}: {shape[1]} x {shape[0]} pixels is too small, at least 16 x 16 is needed")
        if isinstance(self.mask, str):
            other = _head(RasterSource(self.mask)).shape
            if other != shape:
                given, wanted = f"{other[1]} x {other[0]}", f"{shape[1]} x {shape[0]}"
                raise InputError(f"mask {self.mask} of {self.path}: is {given} pixels, the scene is {wanted}")
        if self.is_complex and self.scale in ("intensity", "db"):
            raise InputError(f"{self.path}: holds complex samples, scale='{self.scale}' cannot be; leave scale out")
        return self if self.is_complex else replace(self, scale=self.known_scale)

    def _image(self, window: Window, raster: Raster) -> Image:
        samples, valid = raster.samples, raster.mask
        hole = holds_nodata(samples, raster.nodata if self.nodata is None else self.nodata)
        for more in (None if hole is None else ~hole, self._masked(window)):
            if more is not None:
                valid = more if valid is None else valid & more
        if (raster.gain, raster.offset) != (1.0, 0.0):
            samples = samples * raster.gain + raster.offset
        pixels: NDArray[Any]
        if samples.dtype.kind == "c":
            pixels, valid = complex_pixels(samples, valid, self.path, owned=True, content=False)
        else:
            pixels, valid, _ = real_pixels(samples, valid, self.known_scale, self.path, owned=True, content=False)
        if valid is None:
            valid = np.ones(pixels.shape, np.bool_)
        else:
            pixels[~valid] = 0
        return Image(*_padded(pixels, valid, window, self.shape), None, self.path, raster.dtype, self.known_scale)

    def _masked(self, window: Window) -> BoolArray | None:
        """The mask of the part of a window that lies in the scene."""
        part = window.within(self.shape)
        if self.mask is None or part is None:
            return None
        if isinstance(self.mask, str):
            raster = _samples(RasterSource(self.mask), part)
            good = raster.samples != 0
            good &= np.isfinite(raster.samples)
            hole = holds_nodata(raster.samples, raster.nodata)
            for more in (raster.mask, None if hole is None else ~hole):
                if more is not None:
                    good &= more
            return np.asarray(good)
        return inside([np.array(polygon, np.float64) - part.origin for polygon in self.mask], part.shape)


@dataclass(frozen=True, eq=False)
class ImageSource:
    """A scene that is in memory already, with the same manners as a file's.

    Parameters
    ----------
    image : the scene
    """

    image: Image

    @property
    def name(self) -> str:
        return self.image.name

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self.image.shape

    @property
    def dtype(self) -> str:
        return self.image.source_dtype

    @property
    def is_complex(self) -> bool:
        return self.image.is_complex

    @property
    def geolocation(self) -> Geolocation | None:
        return self.image.geolocation

    @property
    def known_scale(self) -> str:
        return self.image.scale

    def read(self, window: Window) -> Image:
        """Return the pixels of a window; those outside the scene are masked."""
        part = window.within(self.shape)
        rows = slice(0, 0) if part is None else slice(part.y, part.y + part.height)
        cols = slice(0, 0) if part is None else slice(part.x, part.x + part.width)
        pixels, mask = self.image.pixels[rows, cols].copy(), self.image.mask[rows, cols].copy()
        return Image(*_padded(pixels, mask, window, self.shape), None, self.name, self.dtype, self.known_scale)

    def overview(self, factor: int) -> Image:
        """As `RasterSource.overview`."""
        return RasterSource.overview(self, factor)  # type: ignore[arg-type]  # it needs shape, read and names only

    def identity(self) -> dict[str, Any]:
        """A digest of the pixels and of the mask."""
        sums = [hashlib.sha256(np.ascontiguousarray(a).data).hexdigest() for a in (self.image.pixels, self.image.mask)]
        return {"sha256": sums, "shape": list(self.shape), "scale": self.known_scale}

    @property
    def path(self) -> str:
        return self.name

    def spooled(self, folder: Path, stem: str) -> RasterSource:
        """Write the pixels to a NPY file, invalid ones as NaN, for workers that do not share this memory."""
        path = folder / f"{stem}.npy"
        pixels = self.image.pixels
        target = np.lib.format.open_memmap(path, mode="w+", dtype=pixels.dtype, shape=pixels.shape)
        for top in range(0, self.shape[0], 512):
            rows = slice(top, top + 512)
            target[rows] = np.where(self.image.mask[rows], pixels[rows], np.nan)
        target.flush()
        return RasterSource(str(path), scale=None if self.is_complex else "amplitude")


Source = RasterSource | ImageSource


def open_source(
    source: Any, *, mask: MaskLike | None = None, nodata: complex | None = None, scale: str | None = None
) -> Source:
    """Return the source of a path, an array or an `Image`, checked; parameters and errors as `featreg.io.as_image`."""
    from featreg.io import as_image
    from featreg.scales import SCALES

    if not isinstance(source, str | Path):
        return ImageSource(as_image(source, mask=mask, nodata=nodata, scale=scale))
    if scale is not None and scale not in SCALES:
        return ImageSource(as_image(source, scale=scale))  # raises, in the words of every other reader
    held: Any = None
    if isinstance(mask, str | Path):
        held = str(mask)
    elif isinstance(mask, np.ndarray) and mask.ndim == 2 and mask.shape[1] != 2:
        # A mask in memory is as large as a scene in memory.
        return ImageSource(as_image(source, mask=mask, nodata=nodata, scale=scale))
    elif mask is not None:
        held = tuple(tuple(map(tuple, polygon.tolist())) for polygon in polygons_of(mask, str(source)))
    return RasterSource(str(source), scale, nodata, mask=held).checked()


def fingerprint(path: str | Path) -> dict[str, Any]:
    """Return size, modification time and a digest of both ends of a file."""
    try:
        known = os.stat(path)
        with open(path, "rb") as file:
            ends = file.read(FINGERPRINT)
            if known.st_size > FINGERPRINT:
                file.seek(max(FINGERPRINT, known.st_size - FINGERPRINT))
                ends += file.read(FINGERPRINT)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give the path of an existing file") from error
    return {"bytes": known.st_size, "time_ns": known.st_mtime_ns, "ends": hashlib.sha256(ends).hexdigest()}


@dataclass(frozen=True, eq=False)
class _Head:
    """What a file says of itself, the samples aside."""

    shape: tuple[int, int]
    dtype: str
    geolocation: Geolocation | None
    way: str  # "windows", "map" or "whole"


def _stamp(path: str) -> tuple[str, int, int]:
    """Names one version of a file; a missing file is left to the reader, whose message says so."""
    try:
        known = os.stat(path)
    except (OSError, ValueError):
        return path, -1, -1
    return path, known.st_size, known.st_mtime_ns


def _head(source: RasterSource) -> _Head:
    return _read_head(_stamp(source.path), source.band)


@lru_cache(maxsize=64)
def _read_head(stamp: tuple[str, int, int], band: int) -> _Head:
    path = stamp[0]
    if Path(path).suffix.lower() == ".npy":
        array = _mapped(stamp)
        return _Head((array.shape[0], array.shape[1]), array.dtype.name, None, "map")
    with gdal_dataset(path) as dataset:
        if dataset is not None and _by_windows(dataset, band):
            shape = dataset.height, dataset.width
            return _Head(shape, _dtype_name(dataset.dtypes[band - 1]), geolocation_of(dataset), "windows")
        if dataset is not None and band > dataset.count:
            raise InputError(f"{path}: has {dataset.count} bands, band {band} was asked for")
    raster = _whole(stamp)
    return _Head((raster.samples.shape[0], raster.samples.shape[1]), raster.dtype, raster.geolocation, "whole")


def _by_windows(dataset: Any, band: int) -> bool:
    from rasterio.enums import ColorInterp

    if not 1 <= band <= dataset.count or len(dataset.subdatasets) > 1:
        return False
    data = [i + 1 for i, colour in enumerate(dataset.colorinterp) if colour != ColorInterp.alpha]
    chosen = data == [1] if band == 1 else band in data
    return chosen and dataset.colorinterp[band - 1] != ColorInterp.palette and dataset.driver != "JPEG"


def _dtype_name(name: str) -> str:
    return "complex64" if name == "complex_int16" else name


def _samples(source: RasterSource, window: Window) -> Raster:
    """The samples of the part of a window inside the scene; (0, 0) of them where it lies outside."""
    head = _head(source)
    part = window.within(head.shape)
    stamp = _stamp(source.path)
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
    return _gdal_samples(source.path, stamp, source.band, part)


def _gdal_samples(path: str, stamp: tuple[str, int, int], band: int, part: Window) -> Raster:
    import rasterio
    from rasterio.enums import MaskFlags
    from rasterio.windows import Window as RasterioWindow

    box = RasterioWindow(part.x, part.y, part.width, part.height)
    with quiet(), rasterio.Env(GDAL_CACHEMAX=CACHE_BYTES):
        try:
            dataset = _opened(path, stamp)
            samples = dataset.read(band, window=box)
            flags = dataset.mask_flag_enums[band - 1]
            mask = None
            if MaskFlags.per_dataset in flags or MaskFlags.alpha in flags:
                mask = dataset.read_masks(band, window=box) != 0
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
        )


_local = threading.local()


def _opened(path: str, stamp: tuple[str, int, int]) -> Any:
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
def _mapped(stamp: tuple[str, int, int]) -> NDArray[Any]:
    path = stamp[0]
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError):
        array = read_raster(path).samples  # says what is wrong with it
    if array.ndim != 2 or array.dtype.kind not in "uifc":
        raise InputError(f"{path}: holds {array.dtype} of shape {array.shape}, one band of numbers (H, W) is needed")
    return np.asarray(array) if not isinstance(array, np.memmap) else array


@lru_cache(maxsize=2)
def _whole(stamp: tuple[str, int, int]) -> Raster:
    return read_raster(stamp[0])


@lru_cache(maxsize=64)
def _scale_of(stamp: tuple[str, int, int], nodata: complex | None, band: int) -> str:
    source = RasterSource(stamp[0], nodata=nodata, band=band)
    height, width = source.shape
    lowest = max(1, SAMPLE * 256 // max(width, 1))
    parts = []
    for top in np.unique(np.linspace(0, max(0, height - lowest), 4).astype(int)).tolist():
        raster = _samples(source, Window(0, top, width, min(lowest, height)))
        hole = holds_nodata(raster.samples, raster.nodata if nodata is None else nodata)
        values = raster.samples if hole is None else raster.samples[~hole]
        parts.append(values.ravel()[values.ravel() < np.inf])
    values = np.concatenate(parts) if parts else np.zeros(0)
    if not len(values):
        return "amplitude"
    return real_pixels(values[None], None, None, stamp[0], owned=False, content=False)[2]


def _told_scale(source: RasterSource) -> str:
    if np.dtype(source.dtype).kind == "u":
        return "amplitude"
    return _scale_of(_stamp(source.path), source.nodata, source.band)


def _padded(
    pixels: NDArray[Any], mask: BoolArray, window: Window, shape: tuple[int, int]
) -> tuple[NDArray[Any], BoolArray]:
    """The part inside the scene on the whole window, what is outside masked."""
    part = window.within(shape)
    if part == window:
        return pixels, mask
    whole, valid = np.zeros(window.shape, pixels.dtype), np.zeros(window.shape, np.bool_)
    if part is not None:
        rows = slice(part.y - window.y, part.y - window.y + part.height)
        cols = slice(part.x - window.x, part.x - window.x + part.width)
        whole[rows, cols], valid[rows, cols] = pixels, mask
    return whole, valid
