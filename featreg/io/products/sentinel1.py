"""Sentinel-1: the annotation of a measurement, its geometry as a range-Doppler sensor.

The XML is parsed by the standard library. xarray-sentinel and eo-products read it too, but bring xarray, fsspec and
pydantic, and neither gives the numbers that a sensor needs in one piece.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.polynomial.polynomial import polyval

from featreg.errors import InputError
from featreg.io.xml_text import DoctypeError, root_of
from featreg.types import FloatArray

LIGHT = 299_792_458.0
#: Metres (three standard errors) by which orbit, timing and atmosphere put a pixel off.
ACCURACY_M = 15.0
#: Bytes of an annotation at most; real ones have 2 MB.
LARGEST = 64 << 20
#: A measurement of a SAFE folder: what stands before that folder's parts, and its name.
MEASUREMENT = re.compile(r"((?:.*[/\\])?)measurement[/\\]([^/\\]+)\.tiff?", re.IGNORECASE)


def annotation_of(measurement: str | Path) -> Path | None:
    """Return the annotation of a measurement in its SAFE folder, ``annotation/NAME.xml``; None where it has none."""
    name = annotation_name(str(measurement))
    return Path(name) if name is not None and Path(name).is_file() else None


def annotation_name(measurement: str) -> str | None:
    """Return what the annotation of a measurement is called; None of a file that lies in no such folder."""
    found = MEASUREMENT.fullmatch(measurement)
    return None if found is None else f"{found[1]}annotation/{found[2]}.xml"


def sensor_of_annotation(path: str | Path, content: bytes | None = None) -> dict[str, Any]:
    """Return what `featreg.geolocation.RangeDopplerSensor` takes, from the annotation of a GRD or SLC measurement.

    `content` are its bytes, where they are at hand.

    Raises
    ------
    InputError
        The file cannot be read or is not the annotation of a Sentinel-1 image.

    Notes
    -----
    Seconds count from the time of the first line. Rows of an SLC in TOPS mode are divided into its bursts; the state
    vectors, every 10 s, are the annotation's own.

    The geolocation grid shows what the other fields leave open. Its azimuth times grow along a line by half the echo's
    delay, and agree with the line's own time at one range, that of the processor's bistatic correction:
    `bistatic_range`. The polynomials of ground range follow the terrain's height from second to second; where the grid
    agrees with them better when their times are shifted by the fraction of a second that lies between the two series
    (0.07 against 1.5 px in the Alps), they are. Half of what neighbouring polynomials differ by counts as inaccuracy.
    """
    root = parsed(path, content)
    try:
        # Numbers of a damaged file may be anything.
        with np.errstate(all="ignore"):
            return _sensor(root)
    except (AttributeError, TypeError, ValueError, IndexError) as error:
        raise InputError(
            f"{path}: is not a whole annotation of a Sentinel-1 image ({type(error).__name__}: {error})"
        ) from error


def parsed(path: str | Path, content: bytes | None = None) -> ElementTree.Element:
    """Return the root of an XML file; no entity of its own is taken from it.

    Raises
    ------
    InputError
        It cannot be read, is larger than any such file, or is no XML.
    """
    try:
        if content is None and Path(path).stat().st_size > LARGEST:
            raise InputError(f"{path}: is larger than {LARGEST >> 20} MB, no annotation is")
        text = Path(path).read_bytes() if content is None else content
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    try:
        return root_of(text)
    except DoctypeError as error:
        raise InputError(f"{path}: defines entities of its own, which no annotation does") from error
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise InputError(f"{path}: is no XML ({error})") from error


def _sensor(root: ElementTree.Element) -> dict[str, Any]:
    image = root.find("imageAnnotation/imageInformation")
    if root.tag != "product" or image is None:
        raise ValueError("it has no imageAnnotation")
    epoch = _time(image, "productFirstLineUtcTime")
    vectors = list(root.iterfind("generalAnnotation/orbitList/orbit"))
    if any((vector.findtext("frame") or "Earth Fixed") != "Earth Fixed" for vector in vectors):
        raise ValueError("the orbit is not Earth Fixed")
    sensor: dict[str, Any] = {
        "type": "range-doppler",
        "times": [_seconds(vector, "time", epoch) for vector in vectors],
        "positions": [[_number(vector, f"position/{axis}") for axis in "xyz"] for vector in vectors],
        "velocities": [[_number(vector, f"velocity/{axis}") for axis in "xyz"] for vector in vectors],
        "line_interval": _number(image, "azimuthTimeInterval"),
        "first_line_time": 0.0,
        "shape": [int(_number(image, "numberOfLines")), int(_number(image, "numberOfSamples"))],
        "look": "right",
        "accuracy_m": ACCURACY_M,
        "epoch": epoch.isoformat(),
    }
    grid = np.array(list(grid_of(root))).reshape(-1, 7)
    late = grid[:, 5] - _row_times(root, grid[:, 1], sensor["line_interval"], epoch)
    if len(grid):
        sensor["ground_m"] = float(np.median(grid[:, 4]))
        sensor["bistatic_range"] = float(np.median(0.5 * LIGHT * (grid[:, 6] - 2.0 * late)))
    projection = root.findtext("generalAnnotation/productInformation/projection")
    if projection == "Ground Range":
        ranges = _ground_range(root, _number(image, "rangePixelSpacing"), epoch)
        last = sensor["shape"][1] * ranges["spacing"]
        pieces = list(zip(ranges["origins"], ranges["coefficients"], strict=True))
        far = [polyval(last - origin, powers) for origin, powers in pieces]
        if len(grid):
            times = np.array(ranges["times"])
            ranges["times"] = (times - _lag(times, pieces, ranges["spacing"], grid, late)).tolist()
        sensor["ground_range"] = ranges
        sensor["accuracy_m"] = float(np.hypot(ACCURACY_M, 0.5 * np.abs(np.diff(far)).max(initial=0.0)))
        return sensor
    rate = _number(root, "generalAnnotation/productInformation/rangeSamplingRate")
    sensor |= {"near_range": 0.5 * LIGHT * _number(image, "slantRangeTime"), "range_spacing": 0.5 * LIGHT / rate}
    lines = int(_number(root, "swathTiming/linesPerBurst"))
    bursts = list(root.iterfind("swathTiming/burstList/burst"))
    if bursts and lines:
        sensor["bursts"] = {
            "times": [_seconds(burst, "azimuthTime", epoch) for burst in bursts],
            "lines": lines,
            "valid": [_valid(burst, lines) for burst in bursts],
        }
    return sensor


def _row_times(root: ElementTree.Element, rows: FloatArray, interval: float, epoch: datetime) -> FloatArray:
    """(N,) seconds of (N,) lines, burst by burst where there are bursts."""
    lines = int(root.findtext("swathTiming/linesPerBurst") or 0)
    starts = np.array([_seconds(one, "azimuthTime", epoch) for one in root.iterfind("swathTiming/burstList/burst")])
    if not lines or not len(starts):
        return rows * interval
    burst = np.clip(rows // lines, 0, len(starts) - 1).astype(int)
    return np.asarray(starts[burst] + (rows - burst * lines) * interval)


def _lag(
    times: FloatArray, pieces: list[tuple[float, list[float]]], spacing: float, grid: FloatArray, late: FloatArray
) -> float:
    """Seconds by which polynomials of ground range hold before their times: 0, or how far the grid's rows lie off.

    What makes them agree better with the ranges of the grid.
    """
    rows = grid[:, 5] - late
    nearest = np.argmin(np.abs(times[:, None] - rows), axis=0)
    values = np.array([polyval(grid[:, 0] * spacing - origin, powers) for origin, powers in pieces])

    def off(lag: float) -> float:
        at = np.array([np.interp(t, times - lag, column) for t, column in zip(rows, values.T, strict=True)])
        return float(np.abs(at - 0.5 * LIGHT * grid[:, 6]).max())

    return min((0.0, float(np.median(times[nearest] - rows))), key=off)


def _ground_range(root: ElementTree.Element, spacing: float, epoch: datetime) -> dict[str, Any]:
    found: dict[float, tuple[float, list[float]]] = {}
    for entry in root.iterfind("coordinateConversion/coordinateConversionList/coordinateConversion"):
        powers = [float(word) for word in (entry.findtext("grsrCoefficients") or "").split()]
        # Slices that were assembled repeat the time where they meet.
        found[_seconds(entry, "azimuthTime", epoch)] = _number(entry, "gr0"), powers
    times = sorted(found)
    return {
        "spacing": spacing,
        "times": times,
        "origins": [found[time][0] for time in times],
        "coefficients": [found[time][1] for time in times],
    }


def _valid(burst: ElementTree.Element, lines: int) -> list[int]:
    """First and last line of a burst with valid samples."""
    first = np.array([int(word) for word in (burst.findtext("firstValidSample") or "").split()])
    held = np.flatnonzero(first >= 0)
    return [int(held[0]), int(held[-1])] if len(held) else [0, lines - 1]


def _time(element: ElementTree.Element, name: str) -> datetime:
    return datetime.fromisoformat(str(element.findtext(name)))


def _seconds(element: ElementTree.Element, name: str, epoch: datetime) -> float:
    return (_time(element, name) - epoch).total_seconds()


def _number(element: ElementTree.Element, name: str) -> float:
    text = element.findtext(name)
    if text is None:
        raise ValueError(f"{name} is missing")
    return float(text)


def grid_of(root: ElementTree.Element) -> Iterator[tuple[float, ...]]:
    """Yield (pixel, line, longitude, latitude, height, azimuth time, slant range time) of the geolocation grid.

    The azimuth time counts in seconds from the first line.
    """
    image = root.find("imageAnnotation/imageInformation")
    if image is None:
        raise InputError("the annotation has no imageInformation")
    epoch = _time(image, "productFirstLineUtcTime")
    names = ("pixel", "line", "longitude", "latitude", "height")
    for point in root.iterfind("geolocationGrid/geolocationGridPointList/geolocationGridPoint"):
        yield (
            *(_number(point, name) for name in names),
            _seconds(point, "azimuthTime", epoch),
            _number(point, "slantRangeTime"),
        )
