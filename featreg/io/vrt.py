"""Whether a virtual raster of GDAL may be opened: it can run code and name any file or address."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

from featreg.errors import InputError
from featreg.io.gdal_confined import within_folder
from featreg.io.gdal_drivers import TOLD_BY_GDAL, driver_by_content
from featreg.io.gdal_reader import GdalReader
from featreg.io.xml_text import DoctypeError, root_of

#: Bytes of the largest description, files it may name, virtual rasters that may rest on each other.
LARGEST, MOST_FILES, DEEPEST = 16 << 20, 20_000, 4
SOURCES = ("SimpleSource", "ComplexSource", "AveragedSource", "KernelFilteredSource")
RAW, WARPED = "VRTRawRasterBand", "VRTWarpedDataset"
BANDS = (None, "VRTSourcedRasterBand", "VRTDerivedRasterBand", RAW)
#: What is looked at below. GDAL takes these names in any case, an attribute for an element and the other way round.
ELEMENTS = (
    *(
        "VRTDataset",
        "VRTRasterBand",
        "MaskBand",
        *SOURCES,
        "SourceFilename",
        "SourceDataset",
        "OpenOptions",
        "Metadata",
    ),
    *("PixelFunctionCode", "PixelFunctionLanguage", "PixelFunctionArguments", "GeoLocTransformer", "DEMPath"),
)
#: What a warped raster may consist of; what else there is may name files (a height model, arrays of coordinates).
WARPS = frozenset(
    (
        *("VRTDataset", "SRS", "GeoTransform", "GCPList", "GCP", "Metadata", "MDI", "BlockXSize", "BlockYSize"),
        *("VRTRasterBand", "NoDataValue", "ColorInterp", "ColorTable", "Entry", "Description", "UnitType", "Offset"),
        *("Scale", "GDALWarpOptions", "WarpMemoryLimit", "ResampleAlg", "WorkingDataType", "Option", "SourceDataset"),
        *("Transformer", "ApproxTransformer", "MaxError", "BaseTransformer", "GenImgProjTransformer"),
        *("SrcGeoTransform", "SrcInvGeoTransform", "DstGeoTransform", "DstInvGeoTransform", "ReprojectTransformer"),
        *("ReprojectionTransformer", "SourceSRS", "TargetSRS", "Options", "SrcGCPTransformer", "GCPTransformer"),
        *("Order", "Reversed", "Refine", "MinimumGcps", "Tolerance", "SrcTPSTransformer", "TPSTransformer"),
        *("SrcRPCTransformer", "RPCTransformer", "HeightOffset", "HeightScale", "PixErrThreshold", "BandList"),
        *("BandMapping", "SrcNoDataReal", "SrcNoDataImag", "DstNoDataReal", "DstNoDataImag", "SrcAlphaBand"),
        *("DstAlphaBand", "Cutline", "CutlineBlendDist", "OverviewList", "SrcOvrLevel", "InputPixelType"),
    )
)
ATTRIBUTES = ("subClass", "relativeToVRT", "relativetoVRT", "key", "domain")
#: Names that GDAL does not take for those of files: its own folders, XML, prefixes of drivers, addresses; and those
#: whose blanks it would drop.
OUTSIDE = re.compile(r"/vsi|<|\s|[A-Za-z][\w+.-]+:|.*\s\Z", re.DOTALL)
#: Bytes of a file among which a virtual raster begins, as many as GDAL looks at and more.
HEAD = 4096


def is_vrt(head: bytes) -> bool:
    """Whether a file begins as a virtual raster does."""
    return b"<VRTDataset" in head or b"<VRTTiledDataset" in head


def check_vrt(path: Path, depth: int = 0, folder: Path | None = None) -> None:
    """Raise where a virtual raster is more than bands put together, or warped, from images in its own folder or below.

    Raises
    ------
    InputError
        It runs code, names an address or a file elsewhere, names a file that is no image, or cannot be read.
    """
    home = path.parent.resolve() if folder is None else folder
    if depth > DEEPEST:
        raise InputError(f"{path}: virtual rasters rest on each other more than {DEEPEST} deep; make one image of them")
    root = _parsed(path)
    odd = next((name for element in root.iter() if (name := _odd(element))), "")
    if odd:
        raise InputError(f"{path}: is a virtual raster that spells '{odd[:40]}' oddly, which is refused; {_cure(path)}")
    kind = root.get("subClass")
    if root.tag != "VRTDataset" or kind not in (None, WARPED):
        raise InputError(
            f"{path}: is a virtual raster of the kind {kind or root.tag}, which is not opened; {_cure(path)}"
        )
    more = next((str(element.tag) for element in root.iter() if kind == WARPED and element.tag not in WARPS), "")
    if more:
        raise InputError(f"{path}: is a warped raster with a '{more[:40]}', which is refused; {_cure(path)}")
    bands = (*BANDS, "VRTWarpedRasterBand") if kind == WARPED else BANDS
    raw = {name for band in root.iter("VRTRasterBand") if band.get("subClass") == RAW for name in _named(band)}
    for element in root.iter():
        if element.tag in ("PixelFunctionCode", "PixelFunctionLanguage", "PixelFunctionArguments"):
            language = (element.text or "").strip().lower()
            if element.tag != "PixelFunctionArguments" and language not in ("c", ""):
                raise InputError(
                    f"{path}: is a virtual raster that runs code ({element.tag}), which is refused; {_cure(path)}"
                )
        elif element.tag in ("VRTRasterBand", "MaskBand") and element.get("subClass") not in bands:
            raise InputError(
                f"{path}: has a band of the kind {element.get('subClass')}, which is refused; {_cure(path)}"
            )
        elif element.tag.endswith("Source") and element.tag not in SOURCES:
            raise InputError(f"{path}: has a source of the kind {element.tag}, which is refused; {_cure(path)}")
        elif element.tag in ("OpenOptions", "GeoLocTransformer", "Metadata") and _names_files(element):
            raise InputError(f"{path}: names files in its {element.tag}, which is refused; {_cure(path)}")
    names = _named(root)
    if len(names) > MOST_FILES:
        raise InputError(f"{path}: names {len(names)} files, at most {MOST_FILES} are opened; {_cure(path)}")
    for name, relative in sorted(names):
        _check_source(path, home, name, relative, depth, image=(name, relative) not in raw)


def _parsed(path: Path) -> ElementTree.Element:
    try:
        if path.stat().st_size > LARGEST:
            raise InputError(f"{path}: is a virtual raster of more than {LARGEST >> 20} MB; {_cure(path)}")
        content = path.read_bytes()
        return root_of(content)
    except DoctypeError as error:
        raise InputError(f"{path}: is a virtual raster with a DOCTYPE, which is refused; {_cure(path)}") from error
    except (OSError, ElementTree.ParseError, ValueError, LookupError, RecursionError) as error:
        raise InputError(f"{path}: the VRT file is broken or cut short ({error}); a complete file is needed") from error


def _named(element: ElementTree.Element) -> set[tuple[str, bool]]:
    """Names of the files below an element, and whether each is relative to the virtual raster."""
    found = (child for child in element.iter() if child.tag in ("SourceFilename", "SourceDataset"))
    return {(e.text or "", e.get("relativeToVRT", e.get("relativetoVRT")) == "1") for e in found}


def _names_files(element: ElementTree.Element) -> bool:
    """Whether options or metadata name a file: those of a warp's grid, of a height model, of subdatasets."""
    said = [*(child.get("key", "") for child in element), element.get("domain", "")]
    return any(key.upper() in ("X_DATASET", "Y_DATASET", "GEOLOCATION", "RPC_DEM", "SUBDATASETS") for key in said)


def _odd(element: ElementTree.Element) -> str:
    """A name that GDAL takes for one that is looked at here, and this parser for another; "" where there is none."""
    elements, attributes = ({name.lower() for name in names} for names in (ELEMENTS, ATTRIBUTES))
    tag = str(element.tag)
    if tag.startswith("{") or tag.lower() in attributes or (tag.lower() in elements and tag not in ELEMENTS):
        return tag
    if len({name.lower() for name in element.attrib}) < len(element.attrib):
        return tag
    for name in element.attrib:
        known = name.lower() in attributes and name not in ATTRIBUTES
        if name.startswith("{") or known or name.lower() in elements:
            return name
    return ""


def _check_source(path: Path, home: Path, name: str, relative: bool, depth: int, *, image: bool) -> None:
    # GDAL looks for a name that is not relative to the virtual raster in the working folder.
    source = path.parent / name if relative else Path(name)
    try:
        inside = bool(name) and source.resolve().is_relative_to(home) and not OUTSIDE.match(name)
        there = inside and source.is_file()
        head = _head(source) if there else b""
    except (OSError, ValueError, RuntimeError) as error:
        raise InputError(f"{path}: names a file that cannot be looked at ({error})") from error
    if not inside:
        said = " ".join(name.split())[:80]
        raise InputError(f"{path}: reaches outside its folder ('{said}'), which is refused; {_cure(path)}")
    if not there:
        raise InputError(
            f"{path}: names '{name[:80]}', which is not there; put it into the folder of the virtual raster"
        )
    if not image:
        return
    if is_vrt(head):
        check_vrt(source, depth + 1, home)
        return
    driver = driver_by_content(head)
    # GDAL opens a source with whatever driver likes it, also those that read from the network.
    reader = GdalReader(str(source.absolute()), [driver.name] if driver else TOLD_BY_GDAL, f"{path}: its source {name}")
    # A header among the sources can name any file, too.
    within_folder(home / path.name, reader).close()


def _head(source: Path) -> bytes:
    with source.open("rb") as file:
        return file.read(HEAD)


def _cure(path: Path) -> str:
    return f"make an image of it: gdal_translate {path.name} {path.stem}.tif"
