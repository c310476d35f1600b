"""Displacement fields as MintPy reads them: its stack of pairs ("ifgramStack") with the layers of offsets."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from featreg._version import __version__
from featreg.displacement.cells import Reason
from featreg.errors import InputError, ParameterError
from featreg.io.writers import replacing
from featreg.types import Geolocation

if TYPE_CHECKING:
    from featreg.displacement.field import Offsets

#: A day in the name of a file, as products have it: 20210401, 20210401T052622.
DAY = re.compile(r"(?<!\d)(?:19|20)\d\d(?:0[1-9]|1[0-2])(?:0[1-9]|[12]\d|3[01])(?!\d)")


def dates_of(reference: str | None, secondary: str | None, dates: Sequence[str] | None = None) -> tuple[str, str]:
    """Return the days (YYYYMMDD) of two images: those that are given, else the first in the name of each file.

    Raises
    ------
    ParameterError
        They are no days, or not known.
    """
    if dates is not None:
        days = [str(date).replace("-", "") for date in dates]
        if len(days) != 2 or not all(DAY.fullmatch(day) for day in days):
            raise ParameterError(f"dates must be two days as YYYYMMDD, got {', '.join(map(str, dates)) or 'none'}")
        return days[0], days[1]
    found = [DAY.search(Path(name).name) if name else None for name in (reference, secondary)]
    if found[0] is None or found[1] is None:
        raise ParameterError(
            "MintPy keeps every pair under its two dates, and the names of these images hold none; give dates as "
            "YYYYMMDD,YYYYMMDD"
        )
    return found[0][0], found[1][0]


def write_mintpy(
    fields: Sequence[Offsets], path: Path, place: Geolocation | None, dates: Sequence[tuple[str, str]]
) -> None:
    """Write fields on one grid of cells as a stack of pairs that MintPy opens as it does its own.

    Datasets, the pairs along the first axis: date (YYYYMMDD), bperp (0: not known), dropIfgram (true: kept),
    rangeOffset and azimuthOffset (px along columns and rows, NaN where a cell is not good), their standard deviations
    rangeOffsetStd and azimuthOffsetStd, offsetSNR, and reason.

    Parameters
    ----------
    fields : of equal cells
    path : HDF5 file to write
    place : where the cells lie
    dates : of each field, YYYYMMDD of the reference and of the secondary

    Raises
    ------
    ParameterError
        h5py is not installed.
    InputError
        The fields have other cells than the first.

    References
    ----------
    https://mintpy.readthedocs.io/en/latest/api/data_structure/#ifgramstack
    """
    try:
        import h5py
    except ImportError as error:
        raise ParameterError("an HDF5 file needs h5py: pip install 'featreg[hdf5]'") from error
    field = fields[0]
    if any(other.grid != field.grid for other in fields):
        raise InputError("the fields of a stack must have the same cells; measure them with one step and one reference")
    rows, cols = field.grid.cells
    # MintPy keeps every attribute as text.
    attributes = {
        "FILE_TYPE": "ifgramStack",
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
    inputs = [image.path for other in fields for image in (other.reference, other.secondary)]
    with replacing(path, inputs=inputs) as temporary, h5py.File(temporary, "w") as out:
        out.create_dataset("date", data=np.array(dates, "S8"))
        out.create_dataset("bperp", data=np.zeros(len(fields), np.float32))
        out.create_dataset("dropIfgram", data=np.ones(len(fields), np.bool_))
        for name, values in _layers(fields).items():
            out.create_dataset(name, data=values, compression="gzip", shuffle=True)
        out.attrs.update(attributes)


def _layers(fields: Sequence[Offsets]) -> dict[str, Any]:
    """(pairs, rows, cols) of each layer."""
    made: dict[str, list[Any]] = {}
    for field in fields:
        good = field.reason == Reason.GOOD
        for name, values in (
            ("rangeOffset", field.dx),
            ("azimuthOffset", field.dy),
            ("rangeOffsetStd", np.sqrt(field.covariance[..., 0, 0])),
            ("azimuthOffsetStd", np.sqrt(field.covariance[..., 1, 1])),
        ):
            made.setdefault(name, []).append(np.where(good, values, np.nan).astype(np.float32))
        made.setdefault("offsetSNR", []).append(np.asarray(field.snr, np.float32))
        made.setdefault("reason", []).append(field.reason)
    return {name: np.stack(values) for name, values in made.items()}
