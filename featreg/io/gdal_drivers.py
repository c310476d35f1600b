"""The raster formats that are left to GDAL: how each is told by its content, and what must lie beside it.

GDAL itself knows some 150; those that read from the network, run code or hold no images are not offered to a file.
"""

from __future__ import annotations

import re
from dataclasses import dataclass


@dataclass(frozen=True)
class Driver:
    """A driver of GDAL.

    Parameters
    ----------
    name : GDAL's
    title : for messages
    magic : (place, bytes), any of which tells the format; none where GDAL tells it by what lies beside the file
    suffixes : that its files have by custom; they decide nothing
    needs : what must lie beside the file
    whole : its files are decoded from their beginning, so that windows are cut from the whole
    """

    name: str
    title: str
    magic: tuple[tuple[int, bytes], ...] = ()
    suffixes: tuple[str, ...] = ()
    needs: str = ""
    whole: bool = False


DRIVERS = (
    Driver("GTiff", "TIFF", ((0, b"II*\0"), (0, b"MM\0*"), (0, b"II+\0"), (0, b"MM\0+")), (".tif", ".tiff")),
    Driver("PNG", "PNG", ((0, b"\x89PNG"),), (".png",)),
    Driver("JPEG", "JPEG", ((0, b"\xff\xd8\xff"),), (".jpg", ".jpeg"), whole=True),
    Driver("BMP", "BMP", ((0, b"BM"),), (".bmp",)),
    Driver("NITF", "NITF", ((0, b"NITF"), (0, b"NSIF")), (".ntf", ".nitf", ".nsf")),
    Driver("JP2OpenJPEG", "JPEG 2000", ((4, b"jP  \r\n\x87\n"), (0, b"\xff\x4f\xff\x51")), (".jp2", ".j2k")),
    Driver("HFA", "ERDAS Imagine", ((0, b"EHFA_HEADER_TAG"),), (".img",), "a .ige file where the header names one"),
    Driver("COSAR", "COSAR", ((28, b"CSAR"),), (".cos",)),
    Driver("PCIDSK", "PCIDSK", ((0, b"PCIDSK  "),), (".pix",)),
    Driver("ERS", "ER Mapper", ((0, b"DatasetHeader Begin"),), (".ers",), "the raster, of the same name without .ers"),
    Driver("ISCE", "ISCE", (), (".slc", ".int", ".cor"), "FILE.xml"),
    Driver("ROI_PAC", "ROI_PAC", (), (".slc", ".int", ".amp"), "FILE.rsc"),
    Driver("ENVI", "ENVI", (), (".dat", ".img", ".bin"), "FILE.hdr or the .hdr of the same stem"),
    Driver("EHdr", "ESRI BIL", (), (".bil", ".flt"), "the .hdr of the same stem"),
    Driver("TSX", "TerraSAR-X", (), (".xml",), "the product's folder"),
    Driver("RS2", "RADARSAT-2", (), (".xml",), "the product's folder"),
    Driver("JAXAPALSAR", "ALOS PALSAR", (), (), "the product's VOL, LED and IMG files"),
    Driver("SAR_CEOS", "CEOS SAR", (), (), ""),
)  # fmt: skip
BY_NAME = {driver.name: driver for driver in DRIVERS}
#: Told by GDAL, which looks at what lies beside a file.
TOLD_BY_GDAL = tuple(driver.name for driver in DRIVERS if not driver.magic)
#: Prefixes of names in GDAL's manner, PREFIX:NUMBER:FILE.
PREFIXES = {"GTIFF_DIR": "GTiff", "NITF_IM": "NITF", "RADARSAT_2_CALIB": "RS2"}
KNOWN = (
    "GeoTIFF, PNG, JPEG, BMP, JPEG 2000, NITF, SICD, NPY, MATLAB, HDF5, netCDF, VRT, ENVI, ISCE, ROI_PAC, ERDAS "
    "Imagine, ER Mapper, CEOS, COSAR, TerraSAR-X, RADARSAT-2, Sentinel SAFE"
)


def driver_by_content(head: bytes) -> Driver | None:
    """The driver whose files begin with these bytes; None where only what lies beside a file can tell."""
    for driver in DRIVERS:
        told = any(head[at : at + len(magic)] == magic for at, magic in driver.magic)
        # Two letters are too few to tell a bitmap from samples that begin alike.
        if told and (driver.name != "BMP" or head[6:10] == b"\0\0\0\0"):
            return driver
    return None


def drivers_by_suffix(suffix: str) -> str:
    """The formats whose files usually end so, for a message; "" where there are none."""
    return " or ".join(driver.title for driver in DRIVERS if suffix.lower() in driver.suffixes)


def split_prefix(name: str) -> tuple[str, str] | None:
    """(driver, file) of a name in GDAL's manner such as "GTIFF_DIR:2:scene.tif"."""
    found = re.fullmatch(r"([A-Z0-9_]+):([A-Z0-9_]+):(.+)", name)
    if found is None or found[1] not in PREFIXES:
        return None
    return PREFIXES[found[1]], found[3].strip('"')
