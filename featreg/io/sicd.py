"""SICD: complex SAR images in NITF with their geometry, by sarkit (the `sicd` extra)."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.types import FloatArray, Geolocation

#: Bytes at the end of a file among which the XML of a SICD begins: it follows the image segments.
TAIL = 8 << 20
#: Points along each axis at which the projection is evaluated.
GRID = 9
# WGS84.
SEMI_MAJOR, FLATTENING = 6378137.0, 1 / 298.257223563


def is_sicd(path: Path) -> bool:
    """Whether a NITF file holds a SICD."""
    with path.open("rb") as file:
        file.seek(0, 2)
        file.seek(max(0, file.tell() - TAIL))
        return b"urn:SICD:" in file.read()


def read_sicd(path: Path) -> tuple[NDArray[np.complex64], Geolocation | None]:
    """Read the samples (rows, columns) and the geometry of a SICD.

    Returns
    -------
    samples : complex64, of any of the three pixel types
    geolocation : ground control points at the height of the scene centre point, longitude and latitude on WGS84; None
        where the projection does not converge

    Raises
    ------
    InputError
        sarkit is not installed.
    """
    try:
        sicd: Any = import_module("sarkit.sicd")
    except ImportError as error:
        message = f"{path}: is a SICD, which needs sarkit; install it with: pip install 'featreg[sicd]'"
        raise InputError(message) from error
    with path.open("rb") as file, sicd.NitfReader(file) as reader:
        tree = reader.metadata.xmltree
        raw = reader.read_image()
    table = tree.findall("{*}ImageData/{*}AmpTable/{*}Amplitude")
    lookup = None
    if table:
        lookup = np.zeros(256)
        for entry in table:
            lookup[int(entry.get("index"))] = float(entry.text)
    return _samples(raw, lookup), _geolocation(sicd, tree, raw.shape)


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
    """Control points from the SICD's own projection of a grid of pixels to the height of the scene centre point."""
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
    return Geolocation(crs="EPSG:4326", gcps=np.column_stack([col, row, _geodetic(ecef)]))


def _geodetic(ecef: FloatArray) -> FloatArray:
    """(N, 3) longitude, latitude in degrees and height in metres of earth-centred points."""
    x, y, z = ecef.T
    e2 = FLATTENING * (2 - FLATTENING)
    distance = np.hypot(x, y)
    latitude = np.arctan2(z, distance * (1 - e2))
    for _ in range(6):
        normal = SEMI_MAJOR / np.sqrt(1 - e2 * np.sin(latitude) ** 2)
        latitude = np.arctan2(z + e2 * normal * np.sin(latitude), distance)
    normal = SEMI_MAJOR / np.sqrt(1 - e2 * np.sin(latitude) ** 2)
    height = distance * np.cos(latitude) + z * np.sin(latitude) - SEMI_MAJOR**2 / normal
    return np.column_stack([np.degrees(np.arctan2(y, x)), np.degrees(latitude), height])
