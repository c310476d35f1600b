"""Products that are folders or archives: Sentinel SAFE, RADARSAT-2, TerraSAR-X, ALOS; an archive with one image.

The measurements of a SAFE are those that its manifest names, whether or not its annotation is there.
"""

from __future__ import annotations

import logging
import os
import posixpath
import re
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol
from xml.etree import ElementTree

from featreg.errors import InputError
from featreg.io.calibration import Calibration, calibration_of
from featreg.io.gdal_confined import within_archive, within_folder
from featreg.io.gdal_drivers import DRIVERS, TOLD_BY_GDAL, driver_by_content
from featreg.io.gdal_errors import decoding
from featreg.io.gdal_reader import GdalReader
from featreg.io.palsar import VOLUME, PalsarReader
from featreg.io.plausible import check_size, sample_bytes
from featreg.io.products.sentinel1_tops import TopsTerms, tops_of
from featreg.io.reader import Band, Raster, Reader
from featreg.io.window import Window
from featreg.io.xml_text import DoctypeError, root_of
from featreg.types import Geolocation

MANIFEST = "manifest.safe"
LARGEST_MANIFEST, MOST_MEMBERS, MOST_MEASUREMENTS = 32 << 20, 100_000, 400
MEASURED = re.compile(r"\.(tiff?|jp2)$", re.IGNORECASE)
IMAGES = tuple(suffix for driver in DRIVERS for suffix in driver.suffixes if suffix != ".xml")
#: Names of the files that stand for a product: pattern and GDAL's driver.
LEADING = (
    (re.compile(r"product\.xml", re.IGNORECASE), "RS2"),
    (re.compile(r"T[SD]X1_SAR__.+\.xml", re.IGNORECASE), "TSX"),
    (re.compile(r"DAT_\d\d\.\d{3}"), "SAR_CEOS"),
)
#: What a measurement of Sentinel-1 is, in its name: swath, product, polarisation.
SENTINEL_1 = re.compile(r"s1.-(\w+?)-(\w+?)-(\w\w)-.*?(?:-(\d{3}))?\.tiff?$", re.IGNORECASE)
#: Band and resolution of Sentinel-2.
SENTINEL_2 = re.compile(r"_((?:B\w\w|AOT|SCL|TCI|WVP)(?:_\d\dm)?)\.jp2$")

logger = logging.getLogger("featreg.io")


class Tree(Protocol):
    """Files below a folder, or in an archive."""

    called: str

    def names(self) -> Sequence[str]:
        """Paths of all files, with "/" between their parts."""

    def holds(self, name: str) -> bool:
        """Whether a file is there."""

    def content(self, name: str, most: int) -> bytes:
        """The bytes of a file, at most so many."""

    def gdal_name(self, name: str) -> str:
        """What GDAL is given for a file."""


class FolderTree:
    """The files of a folder, three levels deep."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.called = folder, str(folder)

    def names(self) -> Sequence[str]:
        found: list[str] = []
        root = str(self.folder)
        try:
            for here, folders, files in os.walk(root):
                inner = Path(here).relative_to(root)
                if len(inner.parts) >= 3:
                    folders.clear()
                folders.sort()
                found += [(inner / name).as_posix() for name in sorted(files)]
                if len(found) > MOST_MEMBERS:
                    break
        except OSError as error:
            raise InputError(f"{self.called}: the folder cannot be looked through ({error.strerror})") from error
        return found

    def holds(self, name: str) -> bool:
        try:
            return (self.folder / name).is_file()
        except (OSError, ValueError):
            return False

    def content(self, name: str, most: int) -> bytes:
        try:
            with (self.folder / name).open("rb") as file:
                return file.read(most)
        except OSError as error:
            raise InputError(f"{self.folder / name}: cannot be read ({error.strerror})") from error

    def gdal_name(self, name: str) -> str:
        try:
            path = (self.folder / name).resolve()
            there = path.is_file()
        except (
            OSError,
            ValueError,
            RuntimeError,
        ) as error:  # a name that is too long, holds a null byte, goes in circles
            raise InputError(f"{self.called}: names '{name[:80]}', which cannot be looked for") from error
        if not path.is_relative_to(self.folder.resolve()):
            raise InputError(f"{self.called}: names '{name[:80]}' outside its folder, which is refused")
        if not there:
            raise InputError(f"{self.called}: names '{name[:80]}', which is not there; the product must be complete")
        return str(path)


class ZipTree:
    """The members of a ZIP archive."""

    def __init__(self, path: Path) -> None:
        self.path, self.called = path, str(path)
        with decoding(path, "ZIP"), zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            if len(members) > MOST_MEMBERS:
                raise InputError(f"{path}: holds {len(members)} files; unpack it, and give the image")
            self._names = [m.filename for m in members if not m.is_dir()]
            if any(m.flag_bits & 1 for m in members):
                raise InputError(f"{path}: is an archive with a password; unpack it, and give the image")

    def names(self) -> Sequence[str]:
        return self._names

    def holds(self, name: str) -> bool:
        return name in self._names

    def content(self, name: str, most: int) -> bytes:
        with decoding(self.path, "ZIP"), zipfile.ZipFile(self.path) as archive, archive.open(name) as file:
            return file.read(most)

    def gdal_name(self, name: str) -> str:
        if name not in self._names:
            raise InputError(f"{self.called}: holds no '{name[:80]}'; the product must be complete")
        # Braces keep GDAL from looking for the end of the archive's name itself.
        return f"/vsizip/{{{self.path.absolute()}}}/{name}"


def open_product(tree: Tree) -> Reader | None:
    """Open the product in a folder or an archive; None where there is none.

    Raises
    ------
    InputError
        The product is not complete, or several lie there.
    """
    names = tree.names()
    manifests = [n for n in names if posixpath.basename(n).lower() == MANIFEST]
    if len(manifests) > 1:
        raise InputError(
            f"{tree.called}: holds {len(manifests)} SAFE products, one is needed: {', '.join(manifests[:6])}"
        )
    if manifests:
        return open_safe(tree, manifests[0])
    volumes = [n for n in names if VOLUME.fullmatch(posixpath.basename(n))]
    if len(volumes) == 1:
        if not isinstance(tree, FolderTree):
            raise InputError(f"{tree.called}: holds a product of ALOS PALSAR, which is read unpacked; unpack it")
        return PalsarReader(tree.folder / volumes[0])
    for pattern, driver in LEADING:
        found = [n for n in names if pattern.fullmatch(posixpath.basename(n))]
        if len(found) == 1:
            reader = GdalReader(tree.gdal_name(found[0]), [driver], tree.called)
            if isinstance(tree, FolderTree):
                return within_folder(tree.folder / found[0], reader)
            return within_archive(tree.called, reader)
    return None


def open_member(tree: Tree, name: str | None) -> Reader:
    """Open one image of an archive: the one that is named, or the only one.

    Raises
    ------
    InputError
        There is none or there are several, or it is not of a format that is read inside archives.
    """
    names = tree.names()
    if name is None:
        images = [n for n in names if n.lower().endswith(IMAGES)]
        if len(images) != 1:
            held = ", ".join((images or list(names))[:8]) or "nothing"
            what = f"{len(images)} images, name one as {tree.called}:NAME" if images else "no image that is known"
            raise InputError(f"{tree.called}: holds {what}; in it: {held}")
        name = images[0]
    place = tree.gdal_name(name)
    driver = driver_by_content(tree.content(name, 1024))
    drivers = TOLD_BY_GDAL if driver is None else (driver.name,)
    reader = within_archive(tree.called, GdalReader(place, drivers, f"{tree.called}:{name}"))
    try:
        # What is packed twice may state anything, and each window of it would be unpacked from the beginning.
        for band in reader.bands[:1]:
            check_size(reader.called, band.shape, sample_bytes(band.dtype), reader.files)
    except InputError:
        reader.close()
        raise
    return reader


def open_safe(tree: Tree, manifest: str) -> Reader:
    """Open the measurements that a manifest.safe names.

    Raises
    ------
    InputError
        The manifest cannot be read, names no measurement, or none that is there.
    """
    content = tree.content(manifest, LARGEST_MANIFEST + 1)
    where = f"{tree.called}: its {MANIFEST}"
    try:
        if len(content) > LARGEST_MANIFEST:
            raise InputError(f"{where} is larger than {LARGEST_MANIFEST >> 20} MB, which is refused")
        root = root_of(content)
    except DoctypeError as error:
        raise InputError(f"{where} has a DOCTYPE, which is refused") from error
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise InputError(f"{where} is broken or cut short ({error}); a complete product is needed") from error
    home = posixpath.dirname(manifest)
    hrefs = [e.get("href", "") for e in root.iter() if e.tag.rpartition("}")[2] == "fileLocation"]
    files = [posixpath.normpath(posixpath.join(home, h)) for h in hrefs if MEASURED.search(h) and _measures(h)]
    if any(f.startswith(("..", "/")) for f in files):
        raise InputError(f"{where} names files outside the product, which is refused")
    files = list(dict.fromkeys(files))[:MOST_MEASUREMENTS]
    if not files:
        raise InputError(
            f"{where} names no measurement; products of Sentinel-1, Sentinel-2 and RADARSAT Constellation are read"
        )
    # Who needs one polarisation or swath often has no other.
    present = [file for file in files if tree.holds(file)]
    if not present:
        raise InputError(f"{where} names {len(files)} measurements, and none is there, such as '{files[0][:120]}'")
    if len(present) < len(files):
        logger.info("%s names %d measurements, of which %d are there", where, len(files), len(present))
    opened: list[tuple[str, GdalReader]] = []
    try:
        for file in present:
            driver = "JP2OpenJPEG" if file.lower().endswith(".jp2") else "GTiff"
            reader = GdalReader(tree.gdal_name(file), [driver], f"{tree.called}: {file}")
            # A mask beside a measurement may be a virtual raster.
            if isinstance(tree, FolderTree):
                reader = within_folder(tree.folder / manifest, reader)
            else:
                reader = within_archive(tree.called, reader)
            opened.append((measurement_name(file), reader))
    except BaseException:
        for _, reader in opened:
            reader.close()
        raise
    return JoinedReader("SAFE", opened)


def _measures(href: str) -> bool:
    folders = href.replace("\\", "/").split("/")[:-1]
    return any(name in folders for name in ("measurement", "IMG_DATA", "imagery"))


def measurement_name(file: str) -> str:
    """What a measurement is asked for by: "VV", "IW1 VV" of a single-look complex product, "B04" of Sentinel-2."""
    name = posixpath.basename(file)
    found = SENTINEL_1.match(name)
    if found is not None:
        swath, product, polarisation, number = found.groups()
        words = [swath.upper()] if product.lower() in ("slc", "ocn") else []
        more = [number] if number and swath.lower().startswith("wv") else []
        return " ".join([*words, polarisation.upper(), *more])
    found = SENTINEL_2.search(name)
    return found[1].replace("_", " ") if found is not None else posixpath.splitext(name)[0]


class JoinedReader:
    """The bands of several files as one; they may differ in size and place."""

    whole = False

    def __init__(self, driver: str, parts: Sequence[tuple[str, Reader]]) -> None:
        self.driver = driver
        self._close: list[Callable[[], None]] = [reader.close for _, reader in parts]
        self._of: list[tuple[Reader, int]] = []
        bands: list[Band] = []
        for name, reader in parts:
            for k, band in enumerate(reader.bands):
                more = f" {band.role or k + 1}" if len(reader.bands) > 1 else ""
                bands.append(replace(band, name=f"{name}{more}"))
                self._of.append((reader, k))
        self.bands: Sequence[Band] = bands
        self.files: Sequence[str] = [file for _, reader in parts for file in reader.files]

    def geolocation(self, band: int) -> Geolocation | None:
        reader, own = self._of[band]
        return reader.geolocation(own)

    def read(self, band: int, window: Window | None = None) -> Raster:
        reader, own = self._of[band]
        return reader.read(own, window)

    def calibration(self, band: int) -> Calibration | None:
        return calibration_of(*self._of[band])

    def tops(self, band: int) -> TopsTerms | None:
        return tops_of(*self._of[band])

    def close(self) -> None:
        for close in self._close:
            close()
