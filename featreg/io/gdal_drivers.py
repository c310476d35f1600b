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
    Driver("SAR_CEOS", "CEOS SAR", (), (), ""),
    Driver("GIF", "GIF", ((0, b"GIF87a"), (0, b"GIF89a")), (".gif",), whole=True),
    Driver("WEBP", "WebP", ((8, b"WEBPVP8"),), (".webp",), whole=True),
    Driver("PNM", "PNM", ((0, b"P5\n"), (0, b"P6\n"), (0, b"P5 "), (0, b"P6 ")), (".pgm", ".ppm", ".pnm")),
    Driver("DTED", "DTED", ((0, b"UHL1"), (80, b"UHL1"), (160, b"UHL1")), (".dt0", ".dt1", ".dt2")),
    Driver("RMF", "RMF", ((0, b"RSW\0"), (0, b"MTW\0"), (0, b"\0WSR"), (0, b"\0WTM")), (".rsw", ".mtw")),
    Driver("CEOS", "CEOS", (), (), ""),
    Driver("AirSAR", "AIRSAR", (), (), "a file of compressed Stokes matrices, *_l, *_c or *_p"),
    Driver("CPG", "Convair PolGASP", (), (".img",), "the .hdr and the files of all polarisations"),
    Driver("COASP", "COASP", (), (".rc",), "the .hdr of the same stem"),
    Driver("GFF", "GFF", (), (".gff",)),
    Driver("MFF", "Vexcel MFF", (), (), "the .hdr, and .b00, .j00, .r00, ... beside it"),
    Driver("MFF2", "Vexcel HKV", (), (), "the folder of image_data and attrib"),
    Driver("EIR", "Erdas raw", (), (".raw",), "the .hdr of the same stem"),
    Driver("GenBin", "generic binary", (), (".bil",), "the .hdr of the same stem"),
    Driver("FAST", "EOSAT FAST", (), (".fst",), "the .DAT files of the bands"),
    Driver("DIPEx", "ELAS DIPEx", (), ()),
    Driver("DOQ1", "DOQ", (), ()),
    Driver("DOQ2", "DOQ 2", (), ()),
    Driver("LAN", "ERDAS 7.x", (), (".lan", ".gis")),
    Driver("PAux", "PCI .aux", (), (".raw",), "the .aux of the same stem"),
    Driver("ISIS2", "ISIS 2", (), (".cub",)),
    Driver("ISIS3", "ISIS 3", (), (".cub", ".lbl")),
    Driver("PDS", "PDS", (), (".img", ".lbl")),
    Driver("PDS4", "PDS 4", (), (".xml",), "the .img that the label names"),
    Driver("VICAR", "VICAR", (), (".vic",)),
    Driver("TGA", "TGA", (), (".tga",)),
    Driver("RST", "Idrisi", (), (".rst",), "the .rdc of the same stem"),
    Driver("SAGA", "SAGA", (), (".sdat",), "the .sgrd of the same stem"),
    Driver("RRASTER", "R raster", (), (".grd",), "the .gri of the same stem"),
    Driver("AAIGrid", "Arc/Info ASCII grid", (), (".asc",)),
    Driver("AIG", "Arc/Info binary grid", (), (".adf",), "the grid's folder"),
    Driver("SRTMHGT", "SRTM", (), (".hgt",), "a name such as N40W110.hgt"),
    Driver("USGSDEM", "USGS DEM", (), (".dem",)),
    Driver("GSAG", "Surfer ASCII grid", (), (".grd",)),
    Driver("GSBG", "Surfer binary grid", (), (".grd",)),
    Driver("GS7BG", "Surfer 7 grid", (), (".grd",)),
    Driver("PCRaster", "PCRaster", (), (".map",)),
    Driver("BT", "VTP terrain", (), (".bt",)),
)  # fmt: skip
#: How a header of ER Mapper begins, after comments and in any case.
ERS = re.compile(rb"(?:\s|#[^\n]*\n)*DatasetHeader\s+Begin", re.IGNORECASE)
BY_NAME = {driver.name: driver for driver in DRIVERS}
#: Told by GDAL, which looks at what lies beside a file.
TOLD_BY_GDAL = tuple(driver.name for driver in DRIVERS if not driver.magic)
#: Those whose files are named by a header that ends in .hdr.
BY_HEADER = ("MFF", "CPG", "COASP", "GenBin")
#: Prefixes of names in GDAL's manner, PREFIX:NUMBER:FILE.
PREFIXES = {"GTIFF_DIR": "GTiff", "NITF_IM": "NITF", "RADARSAT_2_CALIB": "RS2"}
KNOWN = (
    "GeoTIFF, PNG, JPEG, BMP, JPEG 2000, NITF, SICD, NPY, MATLAB, HDF5, netCDF, VRT, ENVI, ISCE, ROI_PAC, ERDAS "
    "Imagine, ER Mapper, CEOS, COSAR, TerraSAR-X, RADARSAT-2, Sentinel SAFE and those that docs/formats.md lists"
)


def driver_by_content(head: bytes) -> Driver | None:
    """The driver whose files begin with these bytes; None where only what lies beside a file can tell."""
    for driver in DRIVERS:
        if driver.name == "ERS" and re.match(ERS, head):
            return driver
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
