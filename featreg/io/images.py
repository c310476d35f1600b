"""From a path or an array to an `Image` in linear amplitude.

The scale is never guessed in silence: non-negative real samples are amplitude, negative ones must be stated or be
plausible decibels (then a warning is logged), anything else is an error that says what to state.
"""

from __future__ import annotations

import math
from dataclasses import replace
from numbers import Real
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError, ParameterError, suggest
from featreg.io.arrays import count_of, is_array, plain_array
from featreg.io.bands import BandLike, check_band
from featreg.io.calibration import check_calibration
from featreg.io.data_arrays import NAME, DataArrayLike, is_data_array, read_data_array
from featreg.io.masks import MaskLike, as_mask
from featreg.io.nodata import holds_nodata
from featreg.io.opening import read_raster, read_small_raster
from featreg.io.reader import Raster, physical
from featreg.io.scales import SCALES, NoContentError, check_content, complex_pixels, real_pixels
from featreg.types import BoolArray, Image, everywhere, read_only

SMALLEST = 16
#: Largest amplitude.
LARGEST = float(np.finfo(np.float32).max)

ImageLike = str | Path | NDArray[Any] | Image | DataArrayLike


def as_image(
    source: ImageLike,
    *,
    mask: MaskLike | None = None,
    nodata: complex | None = None,
    scale: str | None = None,
    band: BandLike = None,
    calibrate: str | None = None,
) -> Image:
    """Return `source` as an `Image` of linear amplitude or complex samples.

    Parameters
    ----------
    source : path of an image file, a product's folder or an archive with one image, the name of a dataset inside a file
        (``file.h5:/group/name``, ``file.mat:variable``, or as GDAL has it), a 2-D numeric array, or an `Image`, which
        is returned as it is when nothing else is given; docs/formats.md lists what is read. A DataArray of xarray may
        have a dimension of bands, and brings its coordinate system and its value for no data along
    mask : pixels that are data: (H, W) array, mask file or polygons; see `featreg.io.masks.as_mask`
    nodata : value of the samples that are not data, before any conversion; it overrides the nodata value of a file (not
        its mask band). Compared with linear amplitude where `source` is an `Image`. Without it, 0 is data in an array.
    scale : what real samples are: "amplitude", "intensity" (square root is taken) or "db" (10 ** (v / 20))
    band : of a file: its name ("VV"), its number from 1, "iq" for complex samples of an I and a Q band, "rgb"; None
        takes the only one, and of a colour image the Rec. 601 luminance
    calibrate : "sigma0", "beta0" or "gamma0": samples of a product as amplitudes whose squares are that quantity, by
        what its metadata state (docs/geolocation.md); thermal noise is left in

    Returns
    -------
    Image
        Range and sign of the amplitude are kept, nothing is stretched. NaN, infinite and nodata samples are masked;
        with a stated scale of amplitude, so are negative samples, with a logged warning; negative intensities are very
        dark data and become 0.

    Raises
    ------
    InputError
        The file cannot be read, has no such band, or several and none was named; the array is not 2-D and numeric, the
        scale cannot be told, the image is smaller than 16 x 16, holds no valid pixel, or the same value everywhere; the
        file does not state the calibration that is asked for.
    ParameterError
        An unknown scale or quantity, a scale that contradicts the calibration, or a nodata that is no number.

    Notes
    -----
    Real samples without a stated scale are what the file's band names and units say, else the name of a file of one
    band ("sigma0", "gamma0", "beta0", "db"); digital numbers, whole and not negative, are amplitude. Without a word,
    samples without a negative value are amplitude; of others, small negatives below a long upper tail are those of an
    intensity from which noise was removed; else samples count as decibels where all lie within -90 .. 60 and at least
    1 % are negative. Arrays are copied, never locked or
    shared. A scale and offset kept in a GeoTIFF are applied.
    """
    if scale is not None and scale not in SCALES:
        raise ParameterError(f"unknown scale '{scale}', {suggest(scale, SCALES)}")
    check_band(band)
    check_calibration(calibrate, scale)
    if isinstance(source, Image):
        if calibrate not in (None, source.calibration):
            raise InputError(f"{source.name}: is an Image already, calibrate='{calibrate}' is for files of products")
        if band not in (None, source.band):
            raise InputError(f"{source.name}: is an Image already, band '{band}' is for files")
        return _restricted(source, mask, nodata, scale)
    if isinstance(source, str | Path):
        raster = read_raster(source, band, calibrate)
        return _image(raster, str(source), mask, nodata, scale, owned=True, calibration=calibrate)
    if calibrate is not None:
        raise InputError(f"calibrate='{calibrate}' is for files of products, whose metadata say how; arrays have none")
    if is_data_array(source):
        read = read_data_array(source, band, math.inf)
        return _image(cast(Raster, read), NAME, mask, nodata, scale, owned=False)
    if not is_array(source):
        given = type(source).__name__
        raise InputError(f"cannot make an image from {given}; give a path, a 2-D array or a featreg Image")
    if band is not None:
        raise InputError(f"band '{band}' is for files; of an array give the band itself, e.g. a[..., 0]")
    array, shown = plain_array(source)
    raster = Raster(array, array.dtype.name, shown)
    return _image(raster, "array", mask, nodata, scale, owned=False)


def small_image(
    source: ImageLike,
    most: float,
    *,
    mask: MaskLike | None = None,
    nodata: complex | None = None,
    scale: str | None = None,
    band: BandLike = None,
    calibrate: str | None = None,
) -> Image | None:
    """As `as_image`, of at most `most` pixels; None where there are more, and a file was opened but not read."""
    if isinstance(source, str | Path) and scale in (None, *SCALES):
        check_band(band)
        check_calibration(calibrate, scale)
        raster = read_small_raster(source, most, band, calibrate)
        if raster is None:
            return None
        return _image(raster, str(source), mask, nodata, scale, owned=True, calibration=calibrate)
    if is_data_array(source) and scale in (None, *SCALES) and calibrate is None:
        check_band(band)
        raster = read_data_array(source, band, most)
        return None if raster is None else _image(raster, NAME, mask, nodata, scale, owned=False)
    pixels = source.mask.size if isinstance(source, Image) else count_of(source) if is_array(source) else 0
    if pixels > most:
        return None
    return as_image(source, mask=mask, nodata=nodata, scale=scale, band=band, calibrate=calibrate)


def read_image(
    path: str | Path,
    *,
    mask: MaskLike | None = None,
    nodata: complex | None = None,
    scale: str | None = None,
    band: BandLike = None,
    calibrate: str | None = None,
) -> Image:
    """Read an image file; the same as `as_image` with a path."""
    return as_image(str(path), mask=mask, nodata=nodata, scale=scale, band=band, calibrate=calibrate)


def image_or_none(array: NDArray[Any], mask: NDArray[Any] | None = None) -> Image | None:
    """Return an array as an `Image`, None where there is nothing on it: the manners of OpenCV's feature classes.

    Parameters
    ----------
    array : (H, W) of any depth
    mask : (H, W), non-zero where pixels are data

    Raises
    ------
    InputError
        Misuse: more dimensions than two, a mask of another shape, samples that are no numbers. An image smaller than
        16 x 16, without a valid pixel or of one value is none.
    """
    valid: NDArray[Any] | None = None
    if mask is not None:
        given, shown = plain_array(mask)
        valid = given != 0 if shown is None else (given != 0) & shown
    if valid is not None and valid.shape != np.shape(array)[:2]:
        raise InputError(f"the mask must have the shape of the array, {np.shape(array)[:2]}, got {valid.shape}")
    try:
        return as_image(array, mask=valid)
    except NoContentError:
        return None


def _restricted(image: Image, mask: MaskLike | None, nodata: complex | None, scale: str | None) -> Image:
    if scale not in (None, image.scale):
        raise InputError(f"{image.name}: was already made as '{image.scale}', scale='{scale}' contradicts it")
    valid = _combine(None, mask, holds_nodata(image.pixels, nodata), image.shape, image.name)
    if valid is None:
        if image.all_valid or not image.pixels[~image.mask].any():
            return image
        valid = image.mask.copy()  # an image that the caller made may hide anything where it has no data
    valid &= image.mask
    pixels = np.where(valid, image.pixels, image.pixels.dtype.type(0))
    check_content(pixels, valid, image.name)
    return replace(image, pixels=read_only(pixels), mask=read_only(valid))


def _image(
    raster: Raster,
    name: str,
    mask: MaskLike | None,
    nodata: complex | None,
    scale: str | None,
    *,
    owned: bool,
    calibration: str | None = None,
) -> Image:
    samples = raster.samples
    _check_form(samples, name)
    found = _amplitude_at_once(raster, mask, nodata, scale, name)
    if found is not None:
        return Image(
            read_only(found[0]), read_only(found[1]), raster.geolocation, name, raster.dtype, "amplitude",
            band=raster.band, calibration=calibration, nodata=nodata,
        )  # fmt: skip
    hole = holds_nodata(samples, raster.nodata if nodata is None else nodata)
    valid = _combine(raster.mask, mask, hole, (samples.shape[0], samples.shape[1]), name)
    samples = physical(raster)
    pixels: NDArray[Any]
    if samples.dtype.kind == "c":
        if scale in ("intensity", "db"):
            raise InputError(f"{name}: holds complex samples, scale='{scale}' cannot be; leave scale out")
        pixels, valid, scale = *complex_pixels(samples, valid, name, owned), "complex"
    else:
        if scale == "complex":
            raise InputError(f"{name}: holds real {samples.dtype} samples; scale is amplitude, intensity or db")
        pixels, valid, scale = real_pixels(samples, valid, scale, name, owned, said=raster.said)
    if valid is None:
        valid = everywhere((pixels.shape[0], pixels.shape[1]))
    else:
        np.copyto(pixels, 0, where=~valid)
    return Image(
        read_only(pixels), read_only(valid), raster.geolocation, name, raster.dtype, scale,
        band=raster.band, calibration=calibration, nodata=nodata,
    )  # fmt: skip


def _amplitude_at_once(
    raster: Raster, mask: MaskLike | None, nodata: complex | None, scale: str | None, name: str
) -> tuple[NDArray[np.float32], BoolArray] | None:
    """Amplitude and mask of the usual case in one pass over the samples: a stated value without data, no conversion.

    None where it is another case, or where a sample is negative or not finite; what is returned is what the steps for
    all cases give.
    """
    samples, value = raster.samples, raster.nodata if nodata is None else nodata
    kind = samples.dtype
    if kind not in (np.float32, np.uint8, np.uint16) or not kind.isnative or not samples.flags.c_contiguous:
        return None
    if raster.factor is not None or (raster.gain, raster.offset) != (1.0, 0.0) or scale not in (None, "amplitude"):
        return None
    if scale is None and raster.said is not None and kind.kind == "f":
        return None
    if isinstance(value, bool) or not isinstance(value, Real) or not _of_float32(value):
        return None
    if kind.kind == "u" and not (float(value).is_integer() and 0 <= value <= np.iinfo(kind).max):
        return None
    from featreg.io.amplitude_kernels import amplitudes

    pixels, valid = np.empty(samples.shape, np.float32), np.empty(samples.shape, np.bool_)
    if amplitudes(samples, np.float32(value), pixels, valid) < 0:
        return None
    if raster.mask is not None or mask is not None:
        for other in (raster.mask, None if mask is None else as_mask(mask, (len(samples), samples.shape[1]), name)):
            if other is not None:
                valid &= other
        np.copyto(pixels, 0, where=~valid)
    check_content(pixels, valid, name)
    return pixels, valid


def _of_float32(value: Real) -> bool:
    try:
        return abs(float(value)) <= LARGEST
    except OverflowError:
        return False


def _check_form(samples: NDArray[Any], name: str) -> None:
    if samples.dtype.kind not in "uifc":
        advice = "give a bool array as mask=" if samples.dtype.kind == "b" else "convert it to a numeric array"
        raise InputError(f"{name}: holds {samples.dtype} values, real or complex numbers are needed; {advice}")
    if samples.ndim != 2:
        raise InputError(f"{name}: has shape {samples.shape}, one band as an (H, W) array is needed, e.g. a[..., 0]")
    height, width = samples.shape
    if min(height, width) < SMALLEST:
        size = f"{width} x {height} pixels (width x height)"
        raise NoContentError(f"{name}: {size} is too small, at least {SMALLEST} x {SMALLEST} is needed")


def _combine(
    valid: BoolArray | None, mask: MaskLike | None, hole: BoolArray | None, shape: tuple[int, int], name: str
) -> BoolArray | None:
    """Return a new mask that is True where all three say valid; None = everywhere."""
    known = [] if valid is None else [valid]
    known += [] if mask is None else [as_mask(mask, shape, name)]
    known += [] if hole is None else [~hole]
    for other in known[1:]:
        known[0] &= other
    return known[0] if known else None
