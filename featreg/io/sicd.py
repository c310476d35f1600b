"""SICD: complex SAR images in NITF with their geometry, by sarkit (the `sicd` extra), read by windows."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.io.calibration import Calibration
from featreg.io.ellipsoid import geodetic
from featreg.io.gdal_errors import decoding
from featreg.io.products.sicd import calibration_of_sicd, sensor_of_sicd
from featreg.io.reader import Band, Raster
from featreg.io.sarkit_metadata import sarkit_module, silent
from featreg.io.window import Window
from featreg.types import FloatArray, Geolocation

#: Bytes at the end of a file among which the XML of a SICD begins: it follows the image segments.
TAIL = 8 << 20
#: Points along each axis at which the projection is evaluated.
GRID = 9


def standard_of(path: Path) -> tuple[str, str]:
    """("SICD", "1.4.0") or ("SIDD", "3.0.0") of a NITF file that holds one; ("", "") of any other."""
    with path.open("rb") as file:
        file.seek(0, 2)
        file.seek(max(0, file.tell() - TAIL))
        found = re.search(rb"urn:(SICD|SIDD):(\d+(?:\.\d+)*)", file.read())
    return ("", "") if found is None else (found[1].decode(), found[2].decode())


class SicdReader:
    """A SICD.

    Parameters
    ----------
    path : of the file
    version : of the standard, as the file states it

    Raises
    ------
    InputError
        sarkit is not installed or does not know this version, or the file is broken.
    """

    driver = "SICD"
    whole = False

    def __init__(self, path: Path, version: str) -> None:
        self._sicd = sarkit_module("sicd", f"{path}: is a SICD, which")
        known = [name.rpartition(":")[2] for name in self._sicd.VERSION_INFO]
        # A version within one that is listed is read alike: 1.2.0 as 1.2.1.
        if version.split(".")[:2] not in [name.split(".")[:2] for name in known]:
            raise InputError(
                f"{path}: is a SICD of version {version}, and {', '.join(known)} are read; convert it to one of these"
            )
        self.path = path
        self.files: Sequence[str] = [str(path)]
        self._file = path.open("rb")
        try:
            with decoding(path, "SICD"), silent():
                self._reader = self._sicd.NitfReader(self._file)
                self.tree = self._reader.metadata.xmltree
                size = [int(self.tree.findtext(f"{{*}}ImageData/{{*}}{name}")) for name in ("NumRows", "NumCols")]
                if min(size) < 1:
                    raise InputError(f"{path}: the SICD file states {size[1]} x {size[0]} pixels, an image has some")
        except BaseException:
            self._file.close()
            raise
        name = self.tree.findtext("{*}ImageFormation/{*}TxRcvPolarizationProc") or ""
        self.bands: Sequence[Band] = [Band(name.replace(":", ""), (size[0], size[1]), "complex64")]

    @cached_property
    def _lookup(self) -> FloatArray | None:
        table = self.tree.findall("{*}ImageData/{*}AmpTable/{*}Amplitude")
        if not table:
            return None
        lookup = np.zeros(256)
        for entry in table:
            lookup[int(entry.get("index"))] = float(entry.text)
        return lookup

    def read(self, band: int, window: Window | None = None) -> Raster:
        """Samples (rows, columns) as complex64, of any of the three pixel types."""
        height, width = self.bands[0].shape
        w = window or Window(0, 0, width, height)
        with decoding(self.path, "SICD"), silent():
            raw = self._reader.read_sub_image(w.y, w.x, w.y + w.height, w.x + w.width)[0]
            samples = _samples(raw, self._lookup)
        return Raster(samples, "complex64")

    def geolocation(self, band: int) -> Geolocation | None:
        """The SICD's own projection as a sensor, and ground control points from it at the height of the scene centre
        point, longitude and latitude on WGS84; None where it does not converge.
        """
        with decoding(self.path, "SICD"), silent():
            return _geolocation(self._sicd, self.tree, self.bands[0].shape)

    def calibration(self, band: int) -> Calibration | None:
        """By the scale factors of its ``Radiometric``."""
        return self._calibration

    @cached_property
    def _calibration(self) -> Calibration | None:
        with silent():
            return calibration_of_sicd(self._sicd, self.tree, str(self.path))

    def close(self) -> None:
        self._file.close()


def _samples(raw: NDArray[Any], lookup: FloatArray | None) -> NDArray[np.complex64]:
    names = raw.dtype.names
    if names is None:
        return raw.astype(np.complex64)
    out = np.empty(raw.shape, np.complex64)
    if "real" in names:
        out.real, out.imag = raw["real"], raw["imag"]
        return out
    amplitude = raw["amp"].astype(np.float64) if lookup is None else lookup[raw["amp"]]
    phase = raw["phase"] * (2 * np.pi / 256)
    out.real, out.imag = amplitude * np.cos(phase), amplitude * np.sin(phase)
    return out


def _geolocation(sicd: Any, tree: Any, shape: tuple[int, int]) -> Geolocation | None:
    """The SICD's projection, and control points by it: a grid of pixels at the height of the scene centre point."""
    helper = sicd.XmlHelper(tree)
    height = float(helper.load("{*}GeoData/{*}SCP/{*}LLH")[2])
    # A SICD may be a part of a larger image, in which its projection counts.
    first = [int(helper.load(f"{{*}}ImageData/{{*}}{name}")) for name in ("FirstRow", "FirstCol")]
    rows, cols = (np.linspace(0, n - 1, GRID) for n in shape)
    row, col = (grid.ravel() for grid in np.meshgrid(rows, cols, indexing="ij"))
    try:
        metres = sicd.rowcol_to_xrowycol(tree, np.column_stack([row, col]) + first)
        ecef, _, converged = sicd.image_to_constant_hae_surface(tree, metres, height)
    except (ValueError, TypeError, AttributeError, LookupError):
        return None
    if not converged or not np.isfinite(ecef).all():
        return None
    return Geolocation(crs="EPSG:4326", gcps=np.column_stack([col, row, geodetic(ecef)]), sensor=sensor_of_sicd(tree))
