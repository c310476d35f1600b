"""Scenes read by windows: the pixels of a file as `Image` objects, never the whole scene in memory.

The rules are those of `featreg.io.as_image`: linear amplitude or complex64, invalid pixels masked. What reads a scene
asks for a `Source` and never for what is behind it.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from featreg.errors import InputError
from featreg.io.arrays import is_array
from featreg.io.bands import BandLike, check_band
from featreg.io.calibration import check_calibration
from featreg.io.data_arrays import is_data_array
from featreg.io.gdal_reader import CACHE_BYTES
from featreg.io.masks import MaskLike, inside_polygons, polygons_of
from featreg.io.nodata import holds_nodata
from featreg.io.raster_files import Head, absolute_name, files_of, inferred_scale, read_head, read_samples, stamp_of
from featreg.io.reader import Raster
from featreg.io.scales import SCALES
from featreg.io.source import SampleSource, Source, overview_of, padded, spooled
from featreg.io.source_names import parse_source
from featreg.io.window import Window
from featreg.runtime.digests import digest_bytes, digest_value
from featreg.types import BoolArray, Geolocation, Image

__all__ = [
    "CACHE_BYTES",
    "ImageSource",
    "RasterSource",
    "SampleSource",
    "Source",
    "Window",
    "fingerprint",
    "located_source",
    "open_source",
]

#: Bytes at either end of a file that identify it together with its size and time.
FINGERPRINT = 1 << 16
#: Ends of the names of files beside an image that hold none of the samples that are read.
NOT_READ = (".aux.xml", ".ovr", ".OVR")


@dataclass(frozen=True)
class RasterSource(SampleSource):
    """A scene in a file, read by windows; picklable, and holds no open file itself.

    Parameters
    ----------
    path : of the file, folder or archive, or the name of a dataset inside; see `featreg.io.source_names.parse_source`
    scale : "amplitude", "intensity" or "db", what real samples are; None tells it from a sample of the scene, as
        `featreg.io.as_image` does from the whole
    nodata : value of samples that are not data; None takes the file's own
    band : name, number from 1, "iq" or "rgb"; None is the only one, and a file of several bands is then an error
    mask : pixels that are data: path of an image of the same size, or polygons as nested tuples of (x, y)
    calibrate : "sigma0", "beta0" or "gamma0", as `featreg.io.as_image` takes it

    Notes
    -----
    Open files are kept for each thread and process, so that a block does not pay for opening.
    """

    path: str
    scale: str | None = None
    nodata: complex | None = None
    band: BandLike = None
    mask: Any = field(default=None, repr=False)
    calibrate: str | None = None

    @property
    def name(self) -> str:
        return self.path

    @property
    def head(self) -> Head:
        """What the file says of itself."""
        return read_head(stamp_of(self.path), self.band)

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self.head.shape

    @property
    def dtype(self) -> str:
        """Name of the dtype of the samples in the file, or of those that are calibrated."""
        stored = self.head.dtype
        if self.calibrate is None:
            return stored
        return "complex64" if stored.startswith("complex") else "float32"

    @property
    def geolocation(self) -> Geolocation | None:
        """Where the scene lies, as its file says it."""
        return self.head.geolocation

    @property
    def known_scale(self) -> str:
        """What the samples are, told where it was not stated: "amplitude", "intensity", "db" or "complex"."""
        if self.is_complex:
            return "complex"
        if self.calibrate is not None:
            return "amplitude"
        return self.scale or inferred_scale(stamp_of(self.path), self.nodata, self.band, self.masked)

    def samples(self, window: Window) -> Raster:
        return read_samples(self.path, self.band, window, self.calibrate)

    def identity(self) -> dict[str, Any]:
        """What tells this source from another: size, time and both ends of its files, what they say of their samples
        and of their place, scale, nodata and band.
        """
        mask = fingerprint(self.mask) if isinstance(self.mask, str) else self.mask
        more = {} if self.calibrate is None else {"calibrate": self.calibrate}
        head = self.head
        return {
            **more,
            **fingerprint(self.path),
            "says": digest_value([[head.bands[i] for i in head.choice.bands], head.geolocation]),
            "shape": list(self.shape),
            "scale": self.known_scale,
            "nodata": None if self.nodata is None else str(self.nodata),
            "band": list(head.choice.bands),
            "mask": mask,
        }

    def checked(self) -> RasterSource:
        """Return the source with its scale settled, after all that can be checked without reading the whole scene."""
        shape = self.shape
        if min(shape) < 16:
            raise InputError(f"{self.path}: {shape[1]} x {shape[0]} pixels is too small, at least 16 x 16 is needed")
        if isinstance(self.mask, str):
            other = RasterSource(self.mask).shape
            if other != shape:
                given, wanted = f"{other[1]} x {other[0]}", f"{shape[1]} x {shape[0]}"
                raise InputError(f"mask {self.mask} of {self.path}: is {given} pixels, the scene is {wanted}")
        if self.is_complex and self.scale in ("intensity", "db"):
            raise InputError(f"{self.path}: holds complex samples, scale='{self.scale}' cannot be; leave scale out")
        if self.calibrate is not None:
            # What the file lacks shows here, before any work.
            self.read(Window(0, 0, 1, 1))
        return self if self.is_complex else replace(self, scale=self.known_scale)

    def shareable(self, folder: Callable[[], Path], stem: str) -> RasterSource:
        mask = absolute_name(self.mask) if isinstance(self.mask, str) else self.mask
        return replace(self, path=absolute_name(self.path), mask=mask)

    def masked(self, window: Window) -> BoolArray | None:
        part = window.within(self.shape)
        if self.mask is None or part is None:
            return None
        if isinstance(self.mask, str):
            raster = read_samples(self.mask, None, part)
            good = raster.samples != 0
            good &= ~np.isnan(raster.samples)
            hole = holds_nodata(raster.samples, raster.nodata)
            for more in (raster.mask, None if hole is None else ~hole):
                if more is not None:
                    good &= more
            return np.asarray(good)
        return inside_polygons([np.array(polygon, np.float64) - part.origin for polygon in self.mask], part.shape)


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
        return Image(*padded(pixels, mask, window, self.shape), None, self.name, self.dtype, self.known_scale)

    def overview(self, factor: int) -> Image:
        """As `overview_of`."""
        return overview_of(self, factor)

    @property
    def band(self) -> BandLike:
        """What was read of a file of several bands."""
        return self.image.band

    def shareable(self, folder: Callable[[], Path], stem: str) -> RasterSource:
        path = spooled(self, folder(), stem)
        return RasterSource(str(path), scale=None if self.is_complex else "amplitude")

    def identity(self) -> dict[str, Any]:
        """A digest of the pixels and of the mask."""
        sums = [digest_bytes(np.ascontiguousarray(a)) for a in (self.image.pixels, self.image.mask)]
        return {"sha256": sums, "shape": list(self.shape), "scale": self.known_scale}

    @property
    def path(self) -> str:
        return self.name


def open_source(
    source: Any,
    *,
    mask: MaskLike | None = None,
    nodata: complex | None = None,
    scale: str | None = None,
    band: BandLike = None,
    calibrate: str | None = None,
) -> Source:
    """Return the source of a path, an array or an `Image`, checked; parameters and errors as `featreg.io.as_image`."""
    from featreg.io.images import as_image

    check_calibration(calibrate, scale)
    if is_data_array(source) and scale in (None, *SCALES) and calibrate is None:
        from featreg.io.data_array_source import open_data_array

        check_band(band)
        return open_data_array(source, RasterSource, mask=mask, nodata=nodata, scale=scale, band=band)
    if not isinstance(source, str | Path):
        return ImageSource(as_image(source, mask=mask, nodata=nodata, scale=scale, band=band, calibrate=calibrate))
    check_band(band)
    if scale is not None and scale not in SCALES:
        return ImageSource(as_image(source, scale=scale))  # raises, in the words of every other reader
    held: Any = None
    if isinstance(mask, str | Path):
        held = str(mask)
    elif is_array(mask) and len(shape := np.shape(cast(Any, mask))) == 2 and shape[1] != 2:
        # A mask in memory is as large as a scene in memory.
        return ImageSource(as_image(source, mask=mask, nodata=nodata, scale=scale, band=band, calibrate=calibrate))
    elif mask is not None:
        held = tuple(tuple(map(tuple, polygon.tolist())) for polygon in polygons_of(mask, str(source)))
    return RasterSource(str(source), scale, nodata, band, held, calibrate).checked()


def located_source(source: str | Path, band: BandLike = None) -> RasterSource:
    """The source of a file of which size and place are wanted: any band will do, its first where none is named."""
    named = parse_source(source)
    inside = named.dataset is not None
    return RasterSource(str(source), band=None if inside else 1 if band is None else band)


def fingerprint(source: str | Path) -> dict[str, Any]:
    """Return size, modification time and a digest of both ends of every file of an image, product or raster.

    Files of statistics and overviews (`NOT_READ`) are left out: other programs write them beside an image that they
    look at, and what they may say of its place is in the image's head.
    """
    path = parse_source(source).path
    if path is None:
        return {"name": str(source)}
    files = [file for file in files_of(str(source)) if not file.endswith(NOT_READ)]
    if path.is_dir():
        return {"files": [_fingerprint(Path(file)) for file in files], "name": str(path.absolute())}
    more = [_fingerprint(Path(file)) for file in files if Path(file).absolute() != path.absolute()]
    return {**_fingerprint(path), "beside": more} if more else _fingerprint(path)


def _fingerprint(path: Path) -> dict[str, Any]:
    try:
        known = os.stat(path)
        with open(path, "rb") as file:
            ends = file.read(FINGERPRINT)
            if known.st_size > FINGERPRINT:
                file.seek(max(FINGERPRINT, known.st_size - FINGERPRINT))
                ends += file.read(FINGERPRINT)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give the path of an existing file") from error
    return {"bytes": known.st_size, "time_ns": known.st_mtime_ns, "ends": digest_bytes(ends)}
