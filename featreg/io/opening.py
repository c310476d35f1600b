"""The one opener: whatever a name stands for, as a `Reader`; its content decides, not its suffix."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from featreg.errors import InputError
from featreg.io.array_files import open_matlab, open_numpy
from featreg.io.bands import BandLike, Choice, choose, name_of, read_choice
from featreg.io.gdal_confined import within_folder
from featreg.io.gdal_drivers import BY_HEADER, DRIVERS, KNOWN, TOLD_BY_GDAL, driver_by_content, drivers_by_suffix
from featreg.io.gdal_reader import GdalReader
from featreg.io.hdf5 import is_behind_user_block, is_classic_netcdf, is_hdf5, open_classic_netcdf, open_hdf5
from featreg.io.palsar import PalsarReader, is_palsar
from featreg.io.plausible import check_size, sample_bytes
from featreg.io.product_folders import LEADING, MANIFEST, FolderTree, ZipTree, open_member, open_product, open_safe
from featreg.io.radarsat2 import CalibratedRadarsat2Reader
from featreg.io.reader import Raster, Reader
from featreg.io.sicd import SicdReader, standard_of
from featreg.io.sidd import SiddReader
from featreg.io.source_names import SourceName, check_file, check_utf8, parse_source
from featreg.io.vrt import check_vrt, is_vrt

ENVISAT = b'PRODUCT="'
ZIP = (b"PK\x03\x04", b"PK\x05\x06")

#: Endings of what lies beside images and describes them.
DESCRIBES = (".clr", ".prj", ".stx", ".sta", ".tfw", ".wld", ".blw", ".rsc", ".aux.xml", ".kml", ".rdc", ".sgrd")

logger = logging.getLogger("featreg.io")


def open_reader(source: str | Path) -> Reader:
    """Open a file, folder, archive or dataset; whoever opens it closes it.

    Raises
    ------
    InputError
        It does not exist, is of no known format, broken, refused, or needs a library that is not installed.
    """
    name = parse_source(source)
    if name.path is None:
        # GDAL looks for what the user typed, wherever that is; virtual rasters would be opened unseen.
        return GdalReader(name.text, [driver.name for driver in DRIVERS], name.text)
    head = check_file(name.path)
    if name.gdal is not None:
        check_utf8(name.path)
        if name.gdal[0] == "RS2":
            return within_folder(name.path, CalibratedRadarsat2Reader(name.absolute(), name.path, name.text))
        return within_folder(name.path, GdalReader(name.absolute(), [name.gdal[0]], name.text))
    if not head:
        return _open_folder(name.path)
    return _open_file(name, head)


def band_asked(name: SourceName, band: BandLike) -> BandLike:
    """What of a file is asked for: the dataset of its name, else the band.

    Raises
    ------
    InputError
        Both are given and contradict each other.
    """
    if name.dataset is None or _is_archive(name.path):
        return band
    if band is not None and str(band).strip("/") != name.dataset.strip("/"):
        raise InputError(f"{name.text}: names a dataset already, band '{band}' names another; leave one of them out")
    return name.dataset


def _is_archive(path: Path | None) -> bool:
    if path is None or not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(4) in ZIP


def _open_folder(path: Path) -> Reader:
    product = open_product(FolderTree(path))
    if product is None:
        raise InputError(
            f"{path}: is a directory without a product that is known (Sentinel SAFE, RADARSAT-2, TerraSAR-X, ALOS "
            "PALSAR); give an image file"
        )
    return product


def _open_file(name: SourceName, head: bytes) -> Reader:
    path = name.path or Path(name.text)
    if head.startswith(b"\x93NUMPY"):
        return open_numpy(path)
    if is_hdf5(path, head):
        return open_hdf5(path)
    if is_classic_netcdf(head):
        return open_classic_netcdf(path)
    if head[126:128] in (b"IM", b"MI") and head[124:126] in (b"\x00\x01", b"\x01\x00"):
        return open_matlab(path)
    if head.startswith(ZIP):
        check_utf8(path)
        tree = ZipTree(path)
        product = open_product(tree) if name.dataset is None else None
        return product or open_member(tree, name.dataset)
    if path.name.lower() == MANIFEST:
        return open_safe(FolderTree(path.parent), path.name)
    check_utf8(path)
    if is_vrt(head):
        check_vrt(path)
        return GdalReader(str(path.absolute()), ["VRT"], str(path))
    if head.startswith(ENVISAT):
        # GDAL's driver of it ends the process on some damaged headers.
        raise InputError(
            f"{path}: is a product in Envisat's format, which is not read here; convert it: gdal_translate {path} "
            f"{path.with_suffix('.tif').name}"
        )
    driver = driver_by_content(head)
    if driver is not None and driver.name == "NITF":
        standard, version = standard_of(path)
        if standard == "SICD":
            return SicdReader(path, version)
        if standard == "SIDD":
            return within_folder(path, SiddReader(path))
    if driver is not None:
        return within_folder(path, GdalReader(str(path.absolute()), [driver.name], str(path)))
    if path.suffix.lower() == ".mat":
        return open_matlab(path)
    return _by_what_lies_beside(path, head)


def _by_what_lies_beside(path: Path, head: bytes) -> Reader:
    """A raster without a mark of its own, which its header beside it describes."""
    if is_palsar(path, head):
        return PalsarReader(path)
    for pattern, driver in LEADING:
        if pattern.fullmatch(path.name):
            return within_folder(path, GdalReader(str(path.absolute()), [driver], str(path)))
    if path.name.lower().endswith(DESCRIBES):
        raise InputError(f"{path}: describes an image; give the image beside it, which shares its name")
    if path.suffix.lower() == ".hdr":
        return _told(path, BY_HEADER, _unknown(path))
    if is_behind_user_block(path):
        return open_hdf5(path)
    likely = [driver for driver, sidecar in _sidecars(path) if sidecar.is_file()]
    said = _unknown(path)
    if likely:
        try:
            reader = GdalReader(str(path.absolute()), likely, str(path))
        except InputError as error:
            said = str(error)
        else:
            return within_folder(path, reader)
    return _told(path, TOLD_BY_GDAL, said)


def _told(path: Path, drivers: Sequence[str], otherwise: str) -> Reader:
    """What GDAL takes a file for; an `InputError` that says `otherwise` where none of the drivers takes it."""
    try:
        reader = GdalReader(str(path.absolute()), drivers, str(path))
    except InputError as error:
        raise InputError(otherwise) from error
    return within_folder(path, reader)


def _sidecars(path: Path) -> list[tuple[str, Path]]:
    return [
        ("ISCE", path.with_name(path.name + ".xml")),
        ("ROI_PAC", path.with_name(path.name + ".rsc")),
        ("ENVI", path.with_name(path.name + ".hdr")),
        ("ENVI", path.with_suffix(".hdr")),
        ("EHdr", path.with_suffix(".hdr")),
    ]


def _unknown(path: Path) -> str:
    if path.suffix.lower() == ".hdr":
        return f"{path}: is a header; give the raster beside it, of the same name without .hdr"
    if path.suffix.lower() == ".dim" and (bands := sorted(path.with_suffix(".data").glob("*.img"))):
        listed = ", ".join(f"'{band}'" for band in bands[:8])
        return f"{path}: is the header of SNAP; give one of its bands: {listed}"
    usual = {".npy": "NPY", ".mat": "MATLAB", ".h5": "HDF5", ".nc": "netCDF", ".zip": "ZIP", ".vrt": "VRT"}
    wanted = drivers_by_suffix(path.suffix) or usual.get(path.suffix.lower(), "")
    if wanted:
        return f"{path}: the content is not {wanted} in spite of its name, nor of another known format"
    return f"{path}: the content is not a known image format, and no header lies beside it; known are {KNOWN}"


def read_raster(source: str | Path, band: BandLike = None, calibrate: str | None = None) -> Raster:
    """Read an image whole: samples as they are, which of them are data, where they lie.

    Parameters
    ----------
    source : see `featreg.io.source_names.parse_source`
    band : see `featreg.io.bands.choose`
    calibrate : see `featreg.io.as_image`

    Raises
    ------
    InputError
        As `open_reader`, `featreg.io.bands.choose` and `featreg.io.calibration.factor_of`; or the file states more
        pixels than its bytes can hold.
    """
    raster = read_small_raster(source, math.inf, band, calibrate)
    if raster is None:
        raise InputError(f"{source}: cannot be read whole")
    return raster


def read_small_raster(
    source: str | Path, most: float, band: BandLike = None, calibrate: str | None = None
) -> Raster | None:
    """Read an image of at most `most` pixels, as `read_raster`; None where it holds more, which its head tells."""
    reader = open_reader(source)
    name = parse_source(source)
    try:
        choice = choose(reader.bands, band_asked(name, band), str(source))
        first = reader.bands[choice.bands[0]]
        if first.shape[0] * first.shape[1] > most:
            return None
        check_plausible(source, reader, choice)
        raster = read_choice(reader, choice, calibrate=calibrate, called=str(source))
        place = reader.geolocation(choice.bands[0])
        called = None if name.dataset is not None else name_of(reader.bands, choice)
    finally:
        reader.close()
    return replace(raster, geolocation=place, band=called)


def check_plausible(source: str | Path, reader: Reader, choice: Choice) -> None:
    """Raise where a file states far more samples than its bytes can hold, before memory is taken for them."""
    first = reader.bands[choice.bands[0]]
    check_size(str(source), first.shape, sample_bytes(first.dtype) * len(choice.bands), reader.files)
