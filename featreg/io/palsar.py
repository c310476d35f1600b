"""ALOS and ALOS-2 PALSAR in JAXA's CEOS files: VOL, LED and one IMG of each polarisation.

GDAL's driver of them (JAXAPALSAR, at least to 3.10) reads every row from the one before it, puts the corners of an
image that is not square at wrong columns, and knows no ALOS-2.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.io.reader import Band, Raster
from featreg.io.window import Window
from featreg.types import Geolocation

#: What a volume and an image file are called: the product's name follows.
VOLUME = re.compile(r"VOL-(ALPSR.+|ALOS.+)")
IMAGE = re.compile(r"IMG-(HH|HV|VH|VV)-(.+)")
#: Of a beam of ScanSAR, at the end of the name.
BEAM = re.compile(r"(.+)-(F\d)")
#: First record of an image file: its number and kind, whose first subtype differs from one satellite to the other.
DESCRIPTOR = re.compile(rb"\0\0\0\x01[\x32\x3f]\xc0\x12\x12")
#: Places and lengths of the numbers in it, as text.
LINES, RECORD, PIXELS, DATA, SUFFIX, KIND = (236, 8), (186, 6), (248, 8), (280, 8), (288, 4), (428, 4)
HEAD = 720
#: Code of the samples -> how they stand in the file, and what they become.
SAMPLES = {"C*8": (">c8", "complex64"), "IU2": (">u2", "uint16")}
#: In a leader: where the record of the map projection begins and its length, its code, and its eight corner numbers.
MAP, MAP_LENGTH, MAP_CODE, CORNERS = 720 + 4096, 1620, (10, 20), 1072


@dataclass(frozen=True)
class ImageFile:
    """One image file: where its samples begin, their kind and number."""

    path: Path
    shape: tuple[int, int]
    first: int
    record: int
    before: int
    kind: str


class PalsarReader:
    """The images of a product, by polarisation.

    Parameters
    ----------
    path : its volume (``VOL-...``), or one of its images (``IMG-HH-...``), which is then the only one

    Raises
    ------
    InputError
        An image is missing, cut short, or of raw data.
    """

    driver = "PALSAR"
    whole = False

    def __init__(self, path: Path) -> None:
        single = IMAGE.fullmatch(path.name)
        product = single[2] if single is not None else path.name.removeprefix("VOL-")
        files = [path] if single is not None else images_of(path.parent, product)
        if not files:
            raise InputError(f"{path}: has no image beside it, IMG-HH-{product} or of another polarisation")
        self._images = [image_file(file) for file in files]
        self.files: Sequence[str] = [str(file) for file in files]
        self.bands: Sequence[Band] = [
            Band(_name(image.path), image.shape, SAMPLES[image.kind][1]) for image in self._images
        ]
        beam = BEAM.fullmatch(product)
        self._leader = path.with_name(f"LED-{product if beam is None else beam[1]}")

    def read(self, band: int, window: Window | None = None) -> Raster:
        image = self._images[band]
        height, width = image.shape
        w = window or Window(0, 0, width, height)
        stored, kind = SAMPLES[image.kind]
        size = np.dtype(stored).itemsize
        try:
            whole = np.memmap(image.path, np.uint8, "r", image.first, (height, image.record))
            bytes_ = whole[w.y : w.y + w.height, image.before + size * w.x : image.before + size * (w.x + w.width)]
            samples: NDArray[np.generic] = np.ascontiguousarray(bytes_).view(stored).astype(kind)
        except (OSError, ValueError) as error:
            raise InputError(f"{image.path}: cannot be read ({error})") from error
        return Raster(samples, kind)

    def geolocation(self, band: int) -> Geolocation | None:
        """Four control points at the corners, which level 1.5 states; None of level 1.1, which states none of a map."""
        corners = corners_of(self._leader)
        if corners is None:
            return None
        from rasterio.warp import transform

        height, width = self._images[band].shape
        lat, lon = corners.T
        # In the middle's zone of UTM straight lines of the image are straight, in degrees they are not.
        zone = int((np.degrees(np.angle(np.exp(1j * np.radians(lon)).mean())) + 180.0) // 6.0) % 60 + 1
        crs = f"EPSG:{(32600 if lat.mean() >= 0 else 32700) + zone}"
        x, y = transform("EPSG:4326", crs, lon.tolist(), lat.tolist())
        if not np.isfinite([x, y]).all():
            return None
        columns, rows = (0, width - 1, width - 1, 0), (0, 0, height - 1, height - 1)
        return Geolocation(crs=crs, gcps=np.column_stack([columns, rows, x, y, np.zeros(4)]))

    def close(self) -> None:
        """Nothing is kept open."""


def is_palsar(path: Path, head: bytes) -> bool:
    """Whether a file is the volume or an image of a product."""
    return VOLUME.fullmatch(path.name) is not None or (
        IMAGE.fullmatch(path.name) is not None and DESCRIPTOR.match(head) is not None
    )


def image_file(path: Path) -> ImageFile:
    """Return what the descriptor of an image file states.

    Raises
    ------
    InputError
        It is none, cut short, or holds samples of another kind.
    """
    try:
        with path.open("rb") as file:
            head = file.read(HEAD)
        held = path.stat().st_size
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    if DESCRIPTOR.match(head) is None or len(head) < HEAD:
        raise InputError(f"{path}: is no image file of ALOS PALSAR: its first record is not the descriptor of one")
    kind = head[KIND[0] : KIND[0] + KIND[1]].decode("latin1").strip()
    if kind not in SAMPLES:
        raise InputError(
            f"{path}: holds samples of the kind '{kind}', and {' and '.join(SAMPLES)} are read (levels 1.1 and 1.5); "
            "raw data (level 1.0) must be focused first"
        )
    places = (LINES, RECORD, PIXELS, DATA, SUFFIX)
    try:
        lines, record, pixels, data, suffix = (int(head[at : at + n].strip() or 0) for at, n in places)
    except ValueError as error:
        raise InputError(f"{path}: its descriptor is broken ({error})") from error
    before = record - data - suffix
    if min(lines, pixels) < 1 or before < 12 or data != pixels * np.dtype(SAMPLES[kind][0]).itemsize:
        raise InputError(
            f"{path}: its descriptor contradicts itself: {pixels} x {lines} samples in records of {record} bytes, of "
            f"which {data} are samples"
        )
    wanted = HEAD + lines * record
    if held < wanted:
        raise InputError(f"{path}: is cut short: {lines} records of {record} bytes need {wanted} bytes, it has {held}")
    return ImageFile(path, (lines, pixels), HEAD, record, before, kind)


def corners_of(leader: Path) -> NDArray[np.float64] | None:
    """(4, 2) latitude and longitude of the corners from the top left on clockwise; None where a leader states none."""
    try:
        with leader.open("rb") as file:
            file.seek(MAP)
            record = file.read(MAP_LENGTH)
    except OSError:
        return None
    if len(record) < MAP_LENGTH or (record[5], record[4]) not in ((20, 18), (20, 10)):
        return None
    try:
        numbers = [float(record[CORNERS + 16 * k : CORNERS + 16 * (k + 1)]) for k in range(8)]
    except ValueError:
        return None
    found = np.array(numbers).reshape(4, 2)
    good = np.isfinite(found).all() and (np.abs(found) <= [90.0, 180.0]).all() and np.ptp(found, axis=0).min() > 0
    return found if good else None


def images_of(folder: Path, product: str) -> list[Path]:
    """The image files of a product in a folder, those of beams among them; not what other programs put beside them."""
    found = []
    for file in sorted(folder.iterdir()):
        named = IMAGE.fullmatch(file.name)
        beam = None if named is None else BEAM.fullmatch(named[2])
        if named is not None and product in (named[2], beam and beam[1]):
            found.append(file)
    return found


def _name(path: Path) -> str:
    """ "HH", of a beam of ScanSAR "HH F1"."""
    found = IMAGE.fullmatch(path.name)
    beam = BEAM.fullmatch(path.name)
    return " ".join(part for part in (found and found[1], beam and beam[2]) if part)
