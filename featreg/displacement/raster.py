"""Displacement fields as files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from featreg._version import __version__
from featreg.displacement.cells import MEANINGS, CellGrid
from featreg.displacement.ground import is_on_map
from featreg.errors import ParameterError
from featreg.io.gdal_errors import quiet
from featreg.io.writers import geolocation_profile, replacing
from featreg.types import FloatArray, Geolocation

if TYPE_CHECKING:
    from featreg.displacement.field import Offsets

#: Side of the tiles in the file, px.
TILE = 256
#: Endings of HDF5 files.
HDF5 = (".h5", ".he5", ".hdf5")
TIFF = (".tif", ".tiff")


def bands_of(field: Offsets) -> dict[str, tuple[FloatArray, str]]:
    """Return the bands of a field by name: values and unit.

    Displacements are NaN where a cell is not good: who reads a raster may pass its reasons over.
    """

    def kept(values: FloatArray) -> FloatArray:
        return np.where(field.good, values, np.nan)

    covariance = field.covariance
    bands: dict[str, tuple[Any, str]] = {
        "dx": (kept(field.dx), "pixel"),
        "dy": (kept(field.dy), "pixel"),
        "cov_xx": (kept(covariance[..., 0, 0]), "pixel^2"),
        "cov_xy": (kept(covariance[..., 0, 1]), "pixel^2"),
        "cov_yy": (kept(covariance[..., 1, 1]), "pixel^2"),
        "peak": (field.peak, ""),
        "snr": (field.snr, ""),
        "reason": (field.reason, ""),
    }
    metres = field.metres()
    if metres is not None:
        names = ("east", "north") if is_on_map(field) else ("along_x", "along_y")
        bands |= {f"{name}_m": (kept(metres[..., k]), "metre") for k, name in enumerate(names)}
    return bands


def days_of(
    path: Path, reference: str | None, secondary: str | None, dates: Sequence[str] | None = None
) -> tuple[str, str] | None:
    """Return the days under which a file keeps the field of two images; None for a GeoTIFF, which keeps none.

    Raises
    ------
    ParameterError
        The name ends otherwise; the dates are no days, not known, or given for a GeoTIFF.
    """
    if path.suffix.lower() not in (*TIFF, *HDF5):
        raise ParameterError(
            f"'{path}': displacements are written as a GeoTIFF (.tif) or for MintPy (.h5), give a name with one of "
            "these endings"
        )
    if path.suffix.lower() in HDF5:
        from featreg.displacement.mintpy import dates_of

        return dates_of(reference, secondary, dates)
    if dates is not None:
        raise ParameterError(f"dates are kept in files for MintPy (.h5) only, '{path}' would lose them; leave them out")
    return None


def write_offsets(field: Offsets, path: Path, dates: Sequence[str] | None = None) -> None:
    """Write a field as the file that its name asks for; see `Offsets.to_file`."""
    days = days_of(path, field.reference.path, field.secondary.path, dates)
    if days is not None:
        from featreg.displacement.mintpy import write_mintpy

        write_mintpy([field], path, cell_geolocation(field.reference.geolocation, field.grid), [days])
        return
    import rasterio

    rows, cols = field.grid.cells
    bands = bands_of(field)
    profile: dict[str, Any] = {"driver": "GTiff", "height": rows, "width": cols, "count": len(bands)}
    profile |= {"dtype": "float32", "nodata": float("nan"), "compress": "deflate", "predictor": 3}
    profile |= {"tiled": True, "blockxsize": TILE, "blockysize": TILE, "interleave": "band", "bigtiff": "if_safer"}
    profile |= geolocation_profile(cell_geolocation(field.reference.geolocation, field.grid))
    tags = {
        "TIFFTAG_SOFTWARE": f"featreg {__version__}",
        "FEATREG_PRODUCT": "offsets",
        "FEATREG_REFERENCE": field.reference.path,
        "FEATREG_SECONDARY": field.secondary.path,
        "FEATREG_STEP": str(field.grid.step),
        "FEATREG_WINDOW": str(field.grid.window),
        "FEATREG_FIRST_X": str(field.x[0]),
        "FEATREG_FIRST_Y": str(field.y[0]),
    }
    inputs = (field.reference.path, field.secondary.path)
    with (
        replacing(path, inputs=inputs) as temporary,
        quiet(),
        rasterio.open(temporary.absolute(), "w", **profile) as dataset,
    ):
        dataset.update_tags(**tags)
        for number, (name, (values, unit)) in enumerate(bands.items(), 1):
            dataset.write(np.asarray(values, np.float32), number)
            dataset.set_band_description(number, name)
            if unit:
                dataset.set_band_unit(number, unit)
            if name == "reason":
                dataset.update_tags(number, **{f"REASON_{reason.value}": text for reason, text in MEANINGS.items()})


def cell_geolocation(place: Geolocation | None, grid: CellGrid) -> Geolocation | None:
    """Return where the cells of a grid lie, as an image of one pixel a cell, from where the image lies."""
    if place is None:
        return None
    step, first = grid.step, (float(grid.x[0]), float(grid.y[0]))
    transform, rpcs, gcps = place.transform, place.rpcs, place.gcps
    if transform is not None:
        a, b, c, d, e, f = transform
        # The corner of the first cell, from the corner of the first pixel.
        x, y = (middle + 0.5 - step / 2 for middle in first)
        transform = (a * step, b * step, a * x + b * y + c, d * step, e * step, d * x + e * y + f)
    if rpcs is not None:
        scaled = {f"{name}_scale": float(rpcs[f"{name}_scale"]) / step for name in ("samp", "line")}
        # RPCs count from the centre of the first pixel, as the middles do.
        moved = {
            f"{name}_off": (float(rpcs[f"{name}_off"]) - middle) / step
            for name, middle in zip(("samp", "line"), first, strict=True)
        }
        rpcs = {**rpcs, **scaled, **moved}
    if gcps is not None:
        gcps = np.column_stack([(gcps[:, :2] - first) / step, gcps[:, 2:]])
    return replace(place, transform=transform, rpcs=rpcs, gcps=gcps)
