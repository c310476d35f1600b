"""NISAR: the orbit and timing of a range-Doppler single-look complex product (RSLC, HDF5) as a sensor."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from featreg.errors import InputError
from featreg.io.products.vectors import seconds, thinned
from featreg.types import FloatArray

#: Metres (three standard errors) by which orbit, timing and atmosphere put a pixel off.
ACCURACY_M = 15.0
#: Numbers of one of its tables at most.
LONGEST = 1 << 24
#: Where the samples of an RSLC stand, and the part of it that belongs to them.
SAMPLES = re.compile(r"/?(science/[LS]SAR/(?:RSLC|SLC))/swaths/frequency([AB])/[HV]{2}")


def sensor_of_nisar(file: Any, dataset: str) -> dict[str, Any] | None:
    """Return what `featreg.geolocation.RangeDopplerSensor` takes, for one dataset of an open h5py file.

    None where it is not that of an RSLC's samples.

    Raises
    ------
    InputError
        The product lacks what says where it lies.
    """
    found = SAMPLES.fullmatch(dataset)
    if found is None:
        return None
    root, frequency = found.groups()
    try:
        lines = _inside(file, f"{root}/swaths/zeroDopplerTime")
        ranges = np.asarray(_inside(file, f"{root}/swaths/frequency{frequency}/slantRange"), np.float64)
        rows = np.asarray(lines, np.float64)
        when, position, velocity = (
            _inside(file, f"{root}/metadata/orbit/{name}") for name in ("time", "position", "velocity")
        )
        epoch = _epoch(lines)
        times = np.asarray(when, np.float64) + float(seconds([_epoch(when)], epoch)[0])
        kept = thinned(times, float(rows[0]), float(rows[-1]))
        identification = _inside(file, f"{root.rpartition('/')[0]}/identification/lookDirection")
        return {
            "type": "range-doppler",
            "times": times[kept].tolist(),
            "positions": np.asarray(position, np.float64)[kept].tolist(),
            "velocities": np.asarray(velocity, np.float64)[kept].tolist(),
            "first_line_time": float(rows[0]),
            "line_interval": _even(rows, "zeroDopplerTime"),
            "near_range": float(ranges[0]),
            "range_spacing": _even(ranges, "slantRange"),
            "shape": [len(rows), len(ranges)],
            "look": _text(identification[()]).lower(),
            "accuracy_m": ACCURACY_M,
            "epoch": epoch,
        }
    except (KeyError, ValueError, TypeError, IndexError, AttributeError) as error:
        raise InputError(
            f"{dataset}: the RSLC lacks what says where it lies ({type(error).__name__}: {error})"
        ) from error


def _inside(file: Any, path: str) -> Any:
    """A dataset whose samples lie in the file itself: no link to another file is followed."""
    part = file
    for name in path.split("/"):
        link = part.get(name, getlink=True)
        if link is None or type(link).__name__ != "HardLink":
            raise KeyError(f"{path} is not in the file itself")
        part = part[name]
    if part.external or part.is_virtual or part.size > LONGEST:
        raise ValueError(f"{path} lies in another file or is too long")
    return part


def _even(values: FloatArray, name: str) -> float:
    """The step of an even axis."""
    step = float((values[-1] - values[0]) / (len(values) - 1))
    if not np.abs(values - (values[0] + step * np.arange(len(values)))).max() <= 0.01 * abs(step):
        raise ValueError(f"{name} is not even")
    return step


def _epoch(dataset: Any) -> str:
    return _text(dataset.attrs["units"]).partition("since ")[2].strip().replace(" ", "T")


def _text(value: Any) -> str:
    return value.decode() if isinstance(value, bytes) else str(value)
