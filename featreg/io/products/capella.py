"""Capella: the metadata in an image's TIFF tag or in the JSON beside it; geometry and calibration.

The JSON is read by the standard library: a sensor needs a dozen of its numbers, for which capella-reader would bring
pydantic and tifffile.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from featreg.errors import InputError
from featreg.io.calibration import Calibration, constant
from featreg.io.ellipsoid import geodetic
from featreg.io.products.vectors import seconds, thinned

#: Metres (three standard errors) by which orbit, timing and atmosphere put a pixel off.
ACCURACY_M = 10.0
#: Hertz of Doppler centroid that count as none.
ZERO_HZ = 1e-6
#: What the radiometry of an image is called -> the quantity.
RADIOMETRY = {"sigma_nought": "sigma0", "beta_nought": "beta0", "gamma_nought": "gamma0"}
#: Bytes of a JSON beside an image at most.
LARGEST = 64 << 20


def metadata_of(path: str | Path, description: str | None) -> str | None:
    """Return the JSON of a Capella image: its TIFF description, else ``NAME_extended.json`` or ``NAME.json`` beside it.

    None where neither is there.
    """
    if description and description.lstrip().startswith("{") and '"collect"' in description:
        return description
    for name in (f"{Path(path).stem}_extended.json", f"{Path(path).stem}.json"):
        beside = Path(path).with_name(name)
        if beside.is_file() and beside.stat().st_size <= LARGEST:
            text = beside.read_text(encoding="utf-8", errors="replace")
            return text if '"collect"' in text else None
    return None


def capella_calibration(text: str, name: str) -> Calibration | None:
    """Return the calibration that the JSON of a Capella image states; None where it states none.

    Raises
    ------
    InputError
        It is no such JSON; the text names the file.

    Notes
    -----
    A sample times ``scale_factor`` is an amplitude of the quantity that ``radiometry`` names: one of the three.
    """
    try:
        image = json.loads(text)["collect"]["image"]
        quantity = RADIOMETRY.get(str(image.get("radiometry")).lower())
        factor = image.get("scale_factor")
        if quantity is None or factor is None:
            return None
        value = float(factor)
        if not 0 < value < float("inf"):
            raise ValueError(f"a scale_factor of {value}")
    except (TypeError, ValueError, AttributeError, LookupError, RecursionError) as error:
        raise InputError(
            f"{name}: the metadata of Capella state no calibration ({type(error).__name__}: {error})"
        ) from error
    return Calibration({quantity: constant(value)}, f"its radiometry is {image['radiometry']}")


def sensor_of_capella(text: str, name: str) -> dict[str, Any] | None:
    """Return what `featreg.geolocation.RangeDopplerSensor` takes, from the JSON of a Capella SLC.

    None of images that are not in range and time of zero Doppler: geocoded ones, whose geotransform says where they
    lie, and those of the polar format algorithm.

    Raises
    ------
    InputError
        It is no such JSON; the text names the file.
    """
    try:
        collect = json.loads(text)["collect"]
        image = collect["image"]
        geometry = image.get("image_geometry") or {}
        if geometry.get("type") != "slant_plane" or _squinted(geometry):
            return None
        state = collect["state"]
        if str(state["coordinate_system"]["type"]).lower() != "ecef":
            raise ValueError("its orbit is not Earth-fixed")
        vectors = state["state_vectors"]
        epoch = str(geometry["first_line_time"])
        times = seconds([vector["time"] for vector in vectors], epoch)
        interval, rows = float(geometry["delta_line_time"]), int(image["rows"])
        kept = thinned(times, 0.0, rows * interval)
        centre = image.get("center_pixel", {}).get("target_position")
        return {
            "type": "range-doppler",
            "times": times[kept].tolist(),
            "positions": np.array([vector["position"] for vector in vectors], np.float64)[kept].tolist(),
            "velocities": np.array([vector["velocity"] for vector in vectors], np.float64)[kept].tolist(),
            "line_interval": interval,
            "near_range": float(geometry["range_to_first_sample"]),
            "range_spacing": float(geometry["delta_range_sample"]),
            "shape": [rows, int(image["columns"])],
            "look": str(collect["radar"]["pointing"]).lower(),
            "accuracy_m": ACCURACY_M,
            "ground_m": None if centre is None else float(geodetic(np.array([centre], np.float64))[0, 2]),
            "epoch": epoch,
        }
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"{name}: its metadata are not those of a Capella image ({type(error).__name__}: {error})"
        ) from error


def _squinted(geometry: dict[str, Any]) -> bool:
    """Whether rows are times of another Doppler than zero."""
    powers = geometry.get("doppler_centroid_polynomial", {}).get("coefficients", [0.0])
    return bool(np.abs(np.array(powers, np.float64)).max(initial=0.0) > ZERO_HZ)
