"""Sentinel-1: what the annotation of a TOPS image states of its azimuth phase: bursts, steering, rates, centroids."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Protocol, runtime_checkable
from xml.etree import ElementTree

import numpy as np

from featreg.errors import InputError
from featreg.io.products.sentinel1 import LIGHT, parsed
from featreg.io.reader import Reader
from featreg.types import FloatArray


@dataclass(frozen=True, eq=False)
class TopsTerms:
    """The numbers from which the phase of a TOPS image follows.

    Parameters
    ----------
    lines : of each burst, which stand one below the other
    line_interval : s of azimuth time between two lines
    near_time, sample_interval : two-way s of the first sample, and from one to the next
    steering_rates : (B,) Hz/s that the steering of the antenna adds to the Doppler frequency, one of each burst
    fm_rates, centroids : B polynomials each, (two-way s at which they begin, coefficients from the constant on): the
        azimuth FM rate in Hz/s, < 0, and the Doppler centroid in Hz
    """

    lines: int
    line_interval: float
    near_time: float
    sample_interval: float
    steering_rates: FloatArray
    fm_rates: list[tuple[float, FloatArray]]
    centroids: list[tuple[float, FloatArray]]


@runtime_checkable
class TopsReader(Protocol):
    """A reader that may know the phase of its bands."""

    def tops(self, band: int) -> TopsTerms | None:
        """What the metadata state of a band, counted from 0; None of what is no TOPS image.

        Raises
        ------
        InputError
            They are broken.
        """


def tops_of(reader: Reader, band: int) -> TopsTerms | None:
    """As `TopsReader.tops`, of any reader."""
    return reader.tops(band) if isinstance(reader, TopsReader) else None


def tops_terms(name: str, content: bytes, shape: tuple[int, int]) -> TopsTerms | None:
    """Return the terms of the phase of a measurement of (H, W), from its annotation.

    None of an image without bursts (GRD, stripmap, wave mode), and of one of another size than the annotation's.

    Raises
    ------
    InputError
        It is no annotation, or lacks what a TOPS image has.
    """
    root = parsed(name, content)
    bursts = list(root.iterfind("swathTiming/burstList/burst"))
    image = root.find("imageAnnotation/imageInformation")
    projection = root.findtext("generalAnnotation/productInformation/projection")
    if not bursts or image is None or projection != "Slant Range":
        return None
    try:
        if (int(_number(image, "numberOfLines")), int(_number(image, "numberOfSamples"))) != tuple(shape):
            return None
        # Numbers of a damaged file may be anything.
        with np.errstate(all="ignore"):
            return _terms(root, image, bursts)
    except (TypeError, ValueError, AttributeError, IndexError) as error:
        raise InputError(f"{name}: does not state the phase of its bursts ({type(error).__name__}: {error})") from error


def _terms(root: ElementTree.Element, image: ElementTree.Element, bursts: list[ElementTree.Element]) -> TopsTerms:
    product = "generalAnnotation/productInformation"
    lines, interval = int(_number(root, "swathTiming/linesPerBurst")), _number(image, "azimuthTimeInterval")
    steering = np.deg2rad(_number(root, f"{product}/azimuthSteeringRate"))
    wave_number = _number(root, f"{product}/radarFrequency") / LIGHT
    sampling = _number(root, f"{product}/rangeSamplingRate")
    epoch = _time(bursts[0])
    middles = np.array([(_time(one) - epoch).total_seconds() for one in bursts]) + 0.5 * (lines - 1) * interval
    orbit = list(root.iterfind("generalAnnotation/orbitList/orbit"))
    times = np.array([(_time(one, "time") - epoch).total_seconds() for one in orbit])
    speeds = np.array([np.hypot.reduce([_number(one, f"velocity/{axis}") for axis in "xyz"]) for one in orbit])
    rates = list(root.iterfind("generalAnnotation/azimuthFmRateList/azimuthFmRate"))
    centroids = list(root.iterfind("dopplerCentroid/dcEstimateList/dcEstimate"))
    found = TopsTerms(
        lines, interval, _number(image, "slantRangeTime"), 1.0 / sampling,
        2.0 * np.interp(middles, times, speeds) * wave_number * steering,
        [_rate(_nearest(rates, epoch, middle)) for middle in middles.tolist()],
        [_polynomial(_nearest(centroids, epoch, middle), "dataDcPolynomial") for middle in middles.tolist()],
    )  # fmt: skip
    scalars = np.array([interval, found.near_time, found.sample_interval, *found.steering_rates])
    if lines * len(bursts) != int(_number(image, "numberOfLines")):
        raise ValueError(f"{len(bursts)} bursts of {lines} lines are not those of the image")
    if lines < 1 or not (np.isfinite(scalars) & (scalars > 0)).all():
        raise ValueError("a number that must be above 0 is not")
    if not all(rate[0] < 0 for _, rate in found.fm_rates):
        raise ValueError("an azimuth FM rate is not below 0")
    return found


def _rate(entry: ElementTree.Element) -> tuple[float, FloatArray]:
    """The FM rate of an entry; products of before 2015 have elements of their own for the coefficients."""
    if entry.find("azimuthFmRatePolynomial") is not None:
        return _polynomial(entry, "azimuthFmRatePolynomial")
    return _number(entry, "t0"), np.array([_number(entry, name) for name in ("c0", "c1", "c2")])


def _polynomial(entry: ElementTree.Element, name: str) -> tuple[float, FloatArray]:
    powers = np.array(str(entry.findtext(name)).split(), np.float64)
    if not len(powers) or not np.isfinite(powers).all():
        raise ValueError(f"{name} holds no coefficients")
    return _number(entry, "t0"), powers


def _nearest(entries: list[ElementTree.Element], epoch: datetime, when: float) -> ElementTree.Element:
    return min(entries, key=lambda entry: abs((_time(entry) - epoch).total_seconds() - when))


def _time(element: ElementTree.Element, name: str = "azimuthTime") -> datetime:
    return datetime.fromisoformat(str(element.findtext(name)))


def _number(element: ElementTree.Element, name: str) -> float:
    value = float(str(element.findtext(name)))
    if not np.isfinite(value):
        raise ValueError(f"{name} is {value}")
    return value
