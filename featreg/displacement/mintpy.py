"""Displacement fields as MintPy reads them: an HDF5 file with one dataset a layer and the attributes of a raster."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from featreg._version import __version__
from featreg.displacement.cells import Reason
from featreg.errors import ParameterError
from featreg.io.writers import replacing
from featreg.types import Geolocation

if TYPE_CHECKING:
    from featreg.displacement.field import Offsets


def write_mintpy(field: Offsets, path: Path, place: Geolocation | None) -> None:
    """Write a field as an HDF5 file of MintPy's kind "offset".

    Datasets: rangeOffset and azimuthOffset (px along columns and rows, NaN where a cell is not good), their standard
    deviations rangeOffsetStd and azimuthOffsetStd, offsetSNR, and reason.

    Raises
    ------
    ParameterError
        h5py is not installed.
    """
    try:
        import h5py
    except ImportError as error:
        raise ParameterError("an HDF5 file needs h5py: pip install 'featreg[hdf5]'") from error
    good = field.reason == Reason.GOOD
    rows, cols = field.grid.cells
    layers: dict[str, Any] = {
        "rangeOffset": np.where(good, field.dx, np.nan),
        "azimuthOffset": np.where(good, field.dy, np.nan),
        "rangeOffsetStd": np.where(good, np.sqrt(field.covariance[..., 0, 0]), np.nan),
        "azimuthOffsetStd": np.where(good, np.sqrt(field.covariance[..., 1, 1]), np.nan),
        "offsetSNR": field.snr,
    }
    # MintPy keeps every attribute as text.
    attributes = {
        "FILE_TYPE": "offset",
        "LENGTH": str(rows),
        "WIDTH": str(cols),
        "UNIT": "pixel",
        "PROCESSOR": f"featreg {__version__}",
        "NO_DATA_VALUE": "nan",
        "ALOOKS": str(field.grid.step),
        "RLOOKS": str(field.grid.step),
    }
    if place is not None and place.transform is not None and place.transform[1] == place.transform[3] == 0:
        a, _, c, _, e, f = place.transform
        attributes |= {"X_FIRST": repr(c), "Y_FIRST": repr(f), "X_STEP": repr(a), "Y_STEP": repr(e)}
        degrees = field.reference.pixel_size is not None and field.reference.pixel_size.unit == "degree"
        attributes |= {"X_UNIT": "degrees" if degrees else "meters", "Y_UNIT": "degrees" if degrees else "meters"}
        code = (place.crs or "").upper()
        if code.startswith("EPSG:"):
            attributes["EPSG"] = code.removeprefix("EPSG:")
    with (
        replacing(path, inputs=(field.reference.path, field.secondary.path)) as temporary,
        h5py.File(temporary, "w") as out,
    ):
        for name, values in layers.items():
            out.create_dataset(name, data=np.asarray(values, np.float32), compression="gzip", shuffle=True)
        out.create_dataset("reason", data=field.reason, compression="gzip")
        out.attrs.update(attributes)
