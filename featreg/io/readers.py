"""Image files as they are: samples in the file's own dtype, which of them are data, and where they lie.

What the samples mean (amplitude, intensity, decibels) is decided in `featreg.io`.
"""

from __future__ import annotations

import logging
import math
import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError, suggest
from featreg.io.mat_structure import check_mat
from featreg.io.scales import scale_in_words
from featreg.io.sicd import is_sicd, read_sicd
from featreg.types import BoolArray, Geolocation

MAGIC = {
    b"II*\0": "GTiff",
    b"MM\0*": "GTiff",
    b"II+\0": "GTiff",
    b"MM\0+": "GTiff",
    b"\x89PNG": "PNG",
    b"\xff\xd8\xff": "JPEG",
    b"BM": "BMP",
    b"NITF": "NITF",
    b"NSIF": "NITF",
}
# GDAL's fast path for whole 8-bit PNGs returns garbage, without an error, for a truncated file (3.10); a broken JPEG
# is only a warning to it unless told otherwise.
GDAL_OPTIONS = {"GDAL_PNG_WHOLE_IMAGE_OPTIM": "NO", "GDAL_ERROR_ON_LIBJPEG_WARNING": "YES"}
# Mean difference, in gray levels, between the bands of a JPEG that still counts as gray.
MOST_TINT = 12.0
NUMERIC = ("double", "single", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Raster:
    """One band of a file.

    Parameters
    ----------
    samples : (H, W) in the file's dtype (complex_int16 as complex64)
    dtype : the name of that dtype
    mask : (H, W) bool, True = valid, from an alpha band, a mask band or a transparent palette entry; None = all valid
    nodata : the file's nodata value, compared with `samples`
    gain, offset : value = gain * sample + offset
    geolocation : where the file says the image lies
    said : the scale that the file's names and units of the band state, if any
    """

    samples: NDArray[Any]
    dtype: str
    mask: BoolArray | None = None
    nodata: float | None = None
    gain: float = 1.0
    offset: float = 0.0
    geolocation: Geolocation | None = None
    said: str | None = None


def read_raster(source: str | Path) -> Raster:
    """Read one image file: GeoTIFF, NITF, SICD, PNG, JPEG, BMP, NPY, or ``file.mat:variable``.

    Errors as `read_small_raster`.
    """
    raster = read_small_raster(source, math.inf)
    if raster is None:
        raise InputError(f"{source}: cannot be read whole")
    return raster


def read_small_raster(source: str | Path, most: float) -> Raster | None:
    """Read an image file of at most `most` pixels; None where it holds more, which its head tells.

    Formats whose size only the whole tells (SICD, MATLAB) are read whatever it is.

    Raises
    ------
    InputError
        The file is missing, cannot be read, is not what its name says, is broken, or holds no single 2-D image.
    """
    path, variable = _split_variable(source)
    reader = READERS.get(path.suffix.lower())
    head = _head(path)
    if reader is None:
        given = f"suffix '{path.suffix}'" if path.suffix else "a name without suffix"
        raise InputError(f"{path}: {given} is not a known image format; use one of {' '.join(READERS)}")
    _check_name(path, reader)
    return reader(path, head, variable, most)


def _check_name(path: Path, reader: Any) -> None:
    """Raise where GDAL cannot be given the name of a file."""
    if reader not in (_read_gdal, _read_nitf):
        return
    try:
        str(path.absolute()).encode()
    except UnicodeEncodeError as error:
        raise InputError(f"{str(path)!a}: its name or folder is no UTF-8 text, which GDAL needs; rename it") from error


def _split_variable(source: str | Path) -> tuple[Path, str | None]:
    found = re.fullmatch(r"(?is)(.+\.mat):(\w*)", str(source))
    return (Path(found[1]), found[2]) if found else (Path(source), None)


def _head(path: Path) -> bytes:
    """Return the first bytes of a file, or say why it cannot be read at all."""
    try:
        if path.is_dir():
            raise InputError(f"{path}: is a directory, an image file is needed")
        if not path.exists():
            raise InputError(f"{path}: no such file; give the path of an existing image file")
        if not path.is_file():
            raise InputError(f"{path}: is not a regular file, an image file is needed")
        with path.open("rb") as file:
            head = file.read(128)
    except InputError:
        raise
    except PermissionError as error:
        raise InputError(f"{path}: permission denied; make the file readable for this user") from error
    except (OSError, ValueError) as error:  # a name that is too long or holds a null byte
        raise InputError(f"{str(path)[:200]!r}: cannot be opened ({reason(error)}); give an image file") from error
    if not head:
        raise InputError(f"{path}: is empty (0 bytes), an image file is needed")
    return head


def reason(error: BaseException) -> str:
    """Return one line on an error; rasterio keeps the telling text in the cause."""
    text = " ".join(str(error.__cause__ or error).split()) or type(error).__name__
    return text if len(text) <= 200 else text[:197] + "..."


@contextmanager
def quiet() -> Iterator[None]:
    """Keep rasterio from warning that an image has no geolocation."""
    from rasterio.errors import NotGeoreferencedWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        yield


@contextmanager
def _decoding(path: Path, kind: str) -> Iterator[None]:
    """Turn whatever a decoder raises into one line: on broken bytes the libraries raise nearly anything."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        message = f"{path}: the {kind} file is broken or cut short ({reason(error)}); a complete file is needed"
        raise InputError(message) from error


@contextmanager
def gdal_dataset(source: str | Path) -> Iterator[Any]:
    """Open a raster of GDAL for reading by windows; None where the file is of another kind.

    Raises
    ------
    InputError
        The file is missing, empty, broken or not what its name says.
    """
    path, _ = _split_variable(source)
    reader = READERS.get(path.suffix.lower())
    _check_name(path, reader)
    if reader not in (_read_gdal, _read_nitf) or (reader is _read_nitf and _holds_sicd(path)):
        yield None
        return
    driver = _gdal_driver(path, _head(path))
    import rasterio

    with quiet(), rasterio.Env(**GDAL_OPTIONS), _decoding(path, driver.removeprefix("G").upper()):
        dataset = rasterio.open(path.absolute(), driver=driver)
    from rasterio._err import CPLE_BaseError

    try:
        with dataset:
            yield dataset
    except CPLE_BaseError as error:  # rasterio lets some of GDAL's errors through as they are
        raise InputError(
            f"{path}: the file is broken or cut short ({reason(error)}); a complete file is needed"
        ) from error


def _gdal_driver(path: Path, head: bytes) -> str:
    driver = next((name for magic, name in MAGIC.items() if head.startswith(magic)), None)
    if driver is None:
        kinds = "NITF" if READERS[path.suffix.lower()] is _read_nitf else "TIFF, PNG, JPEG or BMP"
        raise InputError(f"{path}: the content is not a {kinds} image in spite of its name")
    return driver


def _read_gdal(path: Path, head: bytes, variable: str | None, most: float) -> Raster | None:
    driver = _gdal_driver(path, head)
    import rasterio

    # An absolute Path and one driver: neither a name like "zip://x" nor the content can send GDAL elsewhere.
    with (
        quiet(),
        rasterio.Env(**GDAL_OPTIONS),
        _decoding(path, driver.removeprefix("G").upper()),
        rasterio.open(path.absolute(), driver=driver) as dataset,
    ):
        return None if dataset.width * dataset.height > most else _read_dataset(path, dataset)


def _holds_sicd(path: Path) -> bool:
    _head(path)  # says what is wrong with the file before its end is looked at
    return is_sicd(path)


def _read_nitf(path: Path, head: bytes, variable: str | None, most: float) -> Raster | None:
    if not is_sicd(path):
        return _read_gdal(path, head, variable, most)
    with _decoding(path, "SICD"):
        samples, geolocation = read_sicd(path)
    return Raster(samples, samples.dtype.name, geolocation=geolocation)


def _gray(path: Path, colours: NDArray[Any], driver: str) -> NDArray[Any]:
    """The one band that three equal ones hold; of a JPEG, whose colours are not exact, the luminance of near-grays."""
    first = colours[0]
    if all(np.array_equal(first, other, equal_nan=first.dtype.kind in "fc") for other in colours[1:]):
        return np.asarray(first)
    if driver == "JPEG":
        tint = float((colours.max(axis=0).astype(np.int16) - colours.min(axis=0)).mean())
        if tint <= MOST_TINT:
            logger.warning("%s: three bands that differ by %.1f gray levels; their luminance is used", path, tint)
            luminance = np.tensordot(np.array([0.299, 0.587, 0.114]), colours.astype(np.float64), axes=1)
            return np.asarray(np.rint(luminance), first.dtype)
    raise InputError(
        f"{path}: has 3 bands that differ (a colour image), one band is needed; extract one (gdal_translate -b 1)"
    )


def _read_dataset(path: Path, dataset: Any) -> Raster:
    from rasterio.enums import ColorInterp

    if len(dataset.subdatasets) > 1:
        pages = len(dataset.subdatasets)
        raise InputError(f"{path}: holds {pages} pages, one image is needed; extract a page to a file of its own")
    bands = [i + 1 for i, colour in enumerate(dataset.colorinterp) if colour != ColorInterp.alpha]
    if len(bands) not in (1, 3):
        raise InputError(
            f"{path}: has {len(bands)} bands, one band is needed; extract one (gdal_translate -b 1), "
            "and give complex samples as one complex band"
        )
    samples = dataset.read(bands[0])
    if len(bands) == 3:
        samples = _gray(path, np.stack([samples, *(dataset.read(band) for band in bands[1:])]), dataset.driver)
    mask = shown(dataset, bands[0])
    if dataset.colorinterp[bands[0] - 1] == ColorInterp.palette:
        samples, opaque = _through_palette(path, samples, dataset.colormap(bands[0]))
        mask = opaque if mask is None else mask & opaque
    return Raster(
        samples,
        dataset.dtypes[bands[0] - 1],
        mask,
        dataset.nodatavals[bands[0] - 1],
        dataset.scales[bands[0] - 1],
        dataset.offsets[bands[0] - 1],
        geolocation_of(dataset),
        stated_scale(dataset, bands[0]),
    )


def stated_scale(dataset: Any, band: int) -> str | None:
    """The scale that the description, unit and tags of a band of an open dataset state, if any."""
    tags = dataset.tags(band)
    more = [tags.get(name) for name in ("units", "long_name", "standard_name", "DESCRIPTION")]
    return scale_in_words(dataset.descriptions[band - 1], dataset.units[band - 1], *more)


def shown(dataset: Any, band: int, window: Any = None) -> BoolArray | None:
    """(H, W) what a file's mask band or alpha band shows of one of its bands; None where it has neither.

    GDAL's own mask leaves out an alpha band where the band also has a nodata value, which the caller compares.
    """
    from rasterio.enums import ColorInterp, MaskFlags

    flags = dataset.mask_flag_enums[band - 1]
    mask = None
    if MaskFlags.per_dataset in flags or MaskFlags.alpha in flags:
        mask = dataset.read_masks(band, window=window) != 0
    if MaskFlags.alpha not in flags and ColorInterp.alpha in dataset.colorinterp:
        opaque = dataset.read(dataset.colorinterp.index(ColorInterp.alpha) + 1, window=window) != 0
        mask = opaque if mask is None else mask & opaque
    return mask


def _through_palette(path: Path, samples: NDArray[Any], palette: dict[int, Any]) -> tuple[NDArray[Any], BoolArray]:
    """Return gray values and opacity; every 8-bit BMP has a palette, mostly a gray one."""
    used = np.unique(samples)
    table = np.zeros((int(used[-1]) + 1, 4), np.uint8)
    for entry in used.tolist():
        table[entry] = palette.get(entry, (0, 0, 0, 255))
    if (table[used, :3] != table[used, :1]).any():
        raise InputError(f"{path}: has a colour palette, gray values are needed; convert it to one band of gray")
    return table[samples, 0], table[samples, 3] > 0


def geolocation_of(dataset: Any) -> Geolocation | None:
    """Return where an open dataset says it lies, or None where it says nothing."""
    gcps, gcp_crs = dataset.gcps
    crs = dataset.crs or gcp_crs
    located = Geolocation(
        transform=None if dataset.transform.is_identity else tuple(dataset.transform)[:6],
        crs=crs.to_wkt() if crs else None,
        rpcs=dataset.rpcs.to_dict() if dataset.rpcs else None,
        # GDAL counts from the corner of the first pixel, we from its centre.
        gcps=np.array([(g.col - 0.5, g.row - 0.5, g.x, g.y, g.z or 0.0) for g in gcps]) if gcps else None,
    )
    nothing = located.transform is None and located.rpcs is None and located.gcps is None
    return None if nothing else located


def _read_npy(path: Path, head: bytes, variable: str | None, most: float) -> Raster | None:
    if not head.startswith(b"\x93NUMPY"):
        raise InputError(f"{path}: the content is not an NPY file in spite of its name; write it with numpy.save")
    with _decoding(path, "NPY"):
        try:
            if _npy_pixels(path) > most:
                return None
            array = np.load(path, allow_pickle=False)
        except ValueError as error:
            if "allow_pickle" not in str(error):
                raise
            raise InputError(f"{path}: holds pickled Python objects, a plain 2-D numeric array is needed") from error
    return Raster(array, array.dtype.name)


def _npy_pixels(path: Path) -> int:
    """How many values an NPY file says it holds."""
    with path.open("rb") as file:
        version = np.lib.format.read_magic(file)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        return math.prod(read(file)[0])


def _read_mat(path: Path, head: bytes, variable: str | None, most: float) -> Raster | None:
    if head.startswith((b"MATLAB 7.3", b"\x89HDF")):
        raise InputError(f"{path}: is a MATLAB 7.3 (HDF5) file, MATLAB 5 is needed; save it in MATLAB with '-v7'")
    from scipy.io import loadmat, whosmat

    with _decoding(path, "MATLAB"):
        check_mat(path)
        contents = whosmat(path)
        classes = {name: kind for name, _, kind in contents}
        shapes = {name: shape for name, shape, _ in contents}
        # Every MATLAB number is 2-D: scalars and vectors are no images.
        images = [n for n, s in shapes.items() if classes[n] in NUMERIC and len(s) == 2 and min(s) > 1]
        name = variable or (images[0] if len(images) == 1 else "")
        listing = ", ".join(f"{n} ({'x'.join(map(str, s))} {classes[n]})" for n, s in shapes.items()) or "no variables"
        if not name and not images:
            raise InputError(f"{path}: has no 2-D numeric variable, one is needed; it holds {listing}")
        if not name:
            raise InputError(
                f"{path}: has {len(images)} 2-D numeric variables, name one as {path}:VARIABLE; it holds {listing}"
            )
        if name not in classes:
            raise InputError(f"{path}: has no variable '{name}', {suggest(name, classes)} (it holds {listing})")
        if name not in images:
            raise InputError(f"{path}:{name}: a 2-D numeric array is needed; the file holds {listing}")
        # mat_dtype=True would drop the imaginary part; without it, doubles come as the small integers they are kept in.
        array = loadmat(path, variable_names=[name])[name]
        if array.dtype.kind in "iu" and classes[name] in ("double", "single"):
            array = array.astype(np.float64 if classes[name] == "double" else np.float32)
    return Raster(array, array.dtype.name)


READERS: dict[str, Callable[[Path, bytes, str | None, float], Raster | None]] = {
    **dict.fromkeys((".tif", ".tiff", ".png", ".jpg", ".jpeg", ".bmp"), _read_gdal),
    **dict.fromkeys((".ntf", ".nitf", ".nsf", ".sicd"), _read_nitf),
    ".npy": _read_npy,
    ".mat": _read_mat,
}
