"""Rasters that GDAL reads, by windows: bands with their roles and names, masks, palettes, where they lie."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.io.bands import COLOURS, luminance
from featreg.io.calibration import Calibration
from featreg.io.gdal_confined import ARCHIVE, check_companions
from featreg.io.gdal_drivers import BY_NAME
from featreg.io.gdal_errors import GDAL_OPTIONS, NO_NETWORK, decoding, quiet, reason
from featreg.io.nodata import holds_nodata
from featreg.io.plausible import ANY_BYTES, check_size, sample_bytes
from featreg.io.products.sentinel1_tops import TopsTerms
from featreg.io.products.stated import stated_calibration, stated_sensor, stated_tops
from featreg.io.reader import Band, Raster
from featreg.io.rpc_file import rpc_beside
from featreg.io.scales import scale_in_name, scale_in_words
from featreg.io.window import Window
from featreg.runtime.digests import digest_value
from featreg.types import BoolArray, Geolocation

#: Bytes that GDAL may keep of the tiles it has decoded, in each process; two rows of tiles of a wide scene.
CACHE_BYTES = 64 << 20
#: Bands of a file; hyperspectral ones have some hundred, a damaged header may state 65 535.
MOST_BANDS = 4096

#: Bytes that an image in JPEG 2000 may state in a file of any size.
WAVELET_BYTES = 16 << 20
#: Map units a pixel, below which a geotransform is none.
SMALLEST_STEP = 1e-100

logger = logging.getLogger("featreg.io")


class GdalReader:
    """A raster of GDAL.

    Parameters
    ----------
    name : what GDAL is given; an absolute path, a name below /vsi, or one in GDAL's manner
    drivers : GDAL's names of those that may open it, so that neither the name nor the content sends it elsewhere
    called : what the file is called in messages

    Raises
    ------
    InputError
        The file is broken, or none of the drivers takes it.
    """

    def __init__(self, name: str, drivers: Sequence[str], called: str) -> None:
        import rasterio
        from rasterio.io import DatasetReader

        self.called = called
        first = BY_NAME.get(drivers[0])
        self.title = first.title if first is not None and len(drivers) == 1 else ""
        # An address that the user typed is looked up, one that stands in a file is not.
        typed = "/vsi" in name.removeprefix("/vsizip/{")
        self._options = {**GDAL_OPTIONS, "GDAL_CACHEMAX": CACHE_BYTES, **({} if typed else NO_NETWORK)}
        with quiet(), rasterio.Env(**self._options), decoding(called, self.title or "image"):
            self.dataset: Any = DatasetReader(name, driver=list(drivers))
            try:
                check_companions(self.dataset, called)
            except BaseException:
                self.dataset.close()
                raise
        self.driver: str = self.dataset.driver
        self.title = self.title or (BY_NAME[self.driver].title if self.driver in BY_NAME else self.driver)
        self.whole = (self.driver in BY_NAME and BY_NAME[self.driver].whole) or self._tall()

    @cached_property
    def bands(self) -> Sequence[Band]:
        from rasterio.enums import ColorInterp

        dataset = self.dataset
        with decoding(self.called, self.title), quiet():
            pages = dataset.subdatasets
            if len(pages) > 1 and (self.driver == "GTiff" or dataset.count == 0):
                raise InputError(
                    f"{self.called}: holds {len(pages)} pages, one image is needed; name one, as in '{pages[0]}'"
                )
            if dataset.count > MOST_BANDS:
                raise InputError(
                    f"{self.called}: states {dataset.count} bands, more than {MOST_BANDS} are not read; is it damaged?"
                )
            # Each of these is looked up for all bands at once.
            names, units, kinds = dataset.descriptions, dataset.units, dataset.dtypes
            colours, holes, gains, offsets = dataset.colorinterp, dataset.nodatavals, dataset.scales, dataset.offsets
            roles = {getattr(ColorInterp, name): name for name in (*COLOURS, "alpha")}
            found = []
            alone = scale_in_name(Path(self.called).stem) if dataset.count == 1 else None
            for i in range(dataset.count):
                tags = dataset.tags(i + 1)
                more = [tags.get(name) for name in ("units", "long_name", "standard_name", "DESCRIPTION")]
                said = scale_in_words(names[i], units[i], *more)
                by_file = said is None and alone is not None and not names[i]
                palette = self._palette(i) if colours[i] == ColorInterp.palette else None
                found.append(
                    Band(
                        names[i] or tags.get("POLARIMETRIC_INTERP") or "",
                        (dataset.height, dataset.width),
                        kinds[i],
                        roles.get(colours[i], ""),
                        alone if by_file else said,
                        holes[i],
                        gains[i],
                        offsets[i],
                        by_file,
                        "" if palette is None else digest_value(palette),
                    )
                )
            return found

    def _palette(self, band: int) -> dict[int, Any] | None:
        """The colours that stand for the samples of a band of a palette; None where these stand for themselves.

        Colours of signed numbers are for display: those of elevations.
        """
        if not self.dataset.dtypes[band].startswith("uint"):
            return None
        try:
            found: dict[int, Any] = self.dataset.colormap(band + 1)
        except ValueError:
            # Said to be numbers of a palette that the file does not have.
            return None
        return found

    @property
    def files(self) -> Sequence[str]:
        found = [ARCHIVE.sub(r"\1", name) for name in self.reached]
        return [name for name in dict.fromkeys(found) if not name.startswith("/vsi")]

    @property
    def reached(self) -> Sequence[str]:
        """Names of all files that the image is made of, also those in archives and elsewhere."""
        import rasterio

        with decoding(self.called, self.title), quiet(), rasterio.Env(**self._options):
            return list(self.dataset.files)

    def geolocation(self, band: int) -> Geolocation | None:
        """Where the file says it lies, the same for all its bands."""
        return self._place

    @cached_property
    def _place(self) -> Geolocation | None:
        with decoding(self.called, self.title), quiet():
            return geolocation_of(self.dataset, self.called)

    def read(self, band: int, window: Window | None = None) -> Raster:
        import rasterio
        from rasterio.enums import ColorInterp
        from rasterio.windows import Window as RasterioWindow

        box = None if window is None else RasterioWindow(window.x, window.y, window.width, window.height)
        known, dataset, nodata = self.bands[band], self.dataset, self.bands[band].nodata
        with quiet(), rasterio.Env(**self._options), decoding(self.called, self.title):
            self._check_block(band)
            samples = dataset.read(band + 1, window=box)
            mask = self._shown(band + 1, box)
            palette = self._palette(band) if dataset.colorinterp[band] == ColorInterp.palette else None
            if palette is not None:
                hole = holds_nodata(samples, nodata)
                samples, shown = _through_palette(samples, palette)
                shown = shown if hole is None else shown & ~hole
                mask, nodata = shown if mask is None else mask & shown, None
        return Raster(samples, known.dtype, mask, nodata, known.gain, known.offset, said=known.said)

    def calibration(self, band: int) -> Calibration | None:
        """What the metadata of its product state; RADARSAT-2 is calibrated by GDAL itself, under another name."""
        if self.driver == "RS2":
            raise InputError(
                f"{self.called}: is calibrated by GDAL: give RADARSAT_2_CALIB:SIGMA0:{self.dataset.name} (or BETA0, "
                "GAMMA) in place of the product, and leave calibrate out"
            )
        return self._calibration

    def tops(self, band: int) -> TopsTerms | None:
        """What the annotation of a Sentinel-1 measurement states, the same for all its bands."""
        return stated_tops(self.dataset.name, (self.dataset.height, self.dataset.width))

    @cached_property
    def _calibration(self) -> Calibration | None:
        with decoding(self.called, self.title), quiet():
            tags = self.dataset.tags()
        return stated_calibration(self.dataset.name, tags)

    def close(self) -> None:
        self.dataset.close()

    def _tall(self) -> bool:
        """Whether a row of blocks outgrows the cache, so that each strip of an image would be decoded anew for all of
        them; of an image that is itself small enough to be kept.
        """
        (height, _), dataset = self._blocks[0] if self._blocks else (0, 0), self.dataset
        if self.driver != "JP2OpenJPEG" or not height:
            return False
        row = dataset.width * sample_bytes(dataset.dtypes[0])
        return bool(height * row > CACHE_BYTES and dataset.height * row <= ANY_BYTES)

    @cached_property
    def _blocks(self) -> list[tuple[int, int]]:
        return list(self.dataset.block_shapes)

    def _check_block(self, band: int) -> None:
        """Raise where one block, which is read as a whole however small the window, is more than the file can hold.

        JPEG 2000 is decoded block by block even where its bytes have ended long before, each at a great cost.
        """
        known, (height, width) = self.bands[band], self._blocks[band]
        each = sample_bytes(known.dtype)
        if height * width * each > ANY_BYTES:
            check_size(self.called, (height, width), each, self.files, "pixels in one block")
        if self.driver == "JP2OpenJPEG" and known.shape[0] * known.shape[1] * each > WAVELET_BYTES:
            check_size(self.called, known.shape, each, self.files, most=WAVELET_BYTES)

    def _shown(self, band: int, box: Any) -> BoolArray | None:
        """(H, W) what the file's mask band or alpha band shows of one of its bands; None where it has neither.

        GDAL's own mask leaves out an alpha band where the band also has a nodata value, which the caller compares. A
        band may have a mask of its own, which has no flag.
        """
        from rasterio.enums import ColorInterp, MaskFlags

        dataset = self.dataset
        flags = dataset.mask_flag_enums[band - 1]
        mask: BoolArray | None = None
        if not flags or MaskFlags.per_dataset in flags or MaskFlags.alpha in flags:
            mask = dataset.read_masks(band, window=box) != 0
        if MaskFlags.alpha not in flags and ColorInterp.alpha in dataset.colorinterp:
            opaque = dataset.read(dataset.colorinterp.index(ColorInterp.alpha) + 1, window=box) != 0
            mask = opaque if mask is None else mask & opaque
        return mask


def _through_palette(samples: NDArray[Any], palette: dict[int, Any]) -> tuple[NDArray[Any], BoolArray]:
    """Return the luminance of a palette's colours, and where they are opaque; most palettes are gray ones."""
    table = np.zeros((np.iinfo(samples.dtype).max + 1, 4), np.uint8)
    table[:, 3] = 255
    for entry, colour in palette.items():
        if 0 <= entry < len(table):
            table[entry] = colour
    gray = luminance([table[:, 0], table[:, 1], table[:, 2]])
    return gray[samples], table[samples, 3] > 0


def _is_nothing(transform: tuple[float, ...]) -> bool:
    """Whether a geotransform is none: drivers of GDAL that have none may leave what the memory held before."""
    slopes = np.abs([transform[0], transform[1], transform[3], transform[4]])
    return not (np.isfinite(transform).all() and float(slopes.max()) > SMALLEST_STEP)


def geolocation_of(dataset: Any, called: str) -> Geolocation | None:
    """Return where an open dataset says it lies, or None where it says nothing."""
    gcps, gcp_crs = dataset.gcps
    crs = dataset.crs or gcp_crs
    try:
        rpcs = dataset.rpcs.to_dict() if dataset.rpcs else rpc_beside(dataset.name)
    except Exception as error:  # rasterio takes the numbers apart and raises whatever comes of that
        logger.warning(
            "%s: its RPC coefficients cannot be read (%s) and are left out; correct or remove them",
            called,
            reason(error),
        )
        rpcs = None
    transform = tuple(dataset.transform)[:6]
    located = Geolocation(
        transform=None if dataset.transform.is_identity or _is_nothing(transform) else transform,
        crs=crs.to_wkt() if crs else None,
        rpcs=rpcs,
        # GDAL counts from the corner of the first pixel, we from its centre.
        gcps=np.array([(g.col - 0.5, g.row - 0.5, g.x, g.y, g.z or 0.0) for g in gcps]) if gcps else None,
        sensor=stated_sensor(dataset.name, dataset.tags(), (dataset.height, dataset.width)),
    )
    forms = located.transform, located.rpcs, located.gcps, located.sensor
    return None if all(form is None for form in forms) else located
