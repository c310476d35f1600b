"""A Sentinel-1 annotation that is made of an orbit that is known exactly."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timedelta

import numpy as np
import pytest

from featreg.geolocation import RangeDopplerSensor
from featreg.simulate.orbit import RangeDoppler
from featreg.types import FloatArray

LIGHT = 299_792_458.0
START = datetime(2024, 5, 6, 7, 8, 9, 123456)
SHAPE = (900, 1200)


def orbit() -> RangeDopplerSensor:
    exact = RangeDoppler.over((12.0, 47.0), SHAPE, incidence_deg=35.0, heading_deg=-12.0, pixel=10.0, height=400.0)
    return exact.sensor(SHAPE, 400.0)


def stamp(seconds: float) -> str:
    return (START + timedelta(seconds=seconds)).isoformat()


def triple(values: FloatArray) -> str:
    return "".join(f"<{axis}>{value!r}</{axis}>" for axis, value in zip("xyz", values.tolist(), strict=True))


def _annotation(kind: str) -> tuple[str, FloatArray]:
    """The text of an annotation, and (M, 5) longitude, latitude, height, pixel, line of its grid as they truly are.

    The rows are `orbit`'s; its processor corrected for the way of the pulse in the middle of the swath only.
    """
    o = orbit()
    far = o.near_range + SHAPE[1] * o.range_spacing
    middle = 0.5 * (o.near_range + far)
    vectors = "".join(
        f"<orbit><time>{stamp(t - o.first_line_time)}</time><frame>Earth Fixed</frame>"
        f"<position>{triple(p)}</position><velocity>{triple(v)}</velocity></orbit>"
        for t, p, v in zip(o.times, o.positions, o.velocities, strict=True)
    )
    lines, step = 300, 280 * o.line_interval
    starts = [k * step for k in range(3)] if kind == "tops" else []
    valid = " ".join(["-1"] * 5 + ["10"] * (lines - 10) + ["-1"] * 5)
    bursts = "".join(
        f"<burst><azimuthTime>{stamp(t)}</azimuthTime><firstValidSample>{valid}</firstValidSample></burst>"
        for t in starts
    )
    points, grid = [], []
    for line in (0, 250, 500, 750):
        for pixel in range(0, SHAPE[1], 200):
            row = starts[line // lines] + line % lines * o.line_interval if starts else line * o.line_interval
            slant = o.near_range + pixel * o.range_spacing
            if kind == "grd":
                slant = slant_of(o, pixel * 10.0, row)
            late = (slant - middle) / LIGHT
            height = 100.0 + pixel / 2 + line
            place = np.array([[(slant - o.near_range) / o.range_spacing, (row + late) / o.line_interval]])
            lon, lat = o.image_to_ground(place, height)[0].tolist()
            points.append([lon, lat, height, pixel, line])
            grid.append(
                f"<geolocationGridPoint><azimuthTime>{stamp(row + late)}</azimuthTime>"
                f"<slantRangeTime>{2 * slant / LIGHT!r}</slantRangeTime>"
                f"<line>{line}</line><pixel>{pixel}</pixel><latitude>{lat!r}</latitude><longitude>{lon!r}"
                f"</longitude><height>{height}</height></geolocationGridPoint>"
            )
    conversions = "".join(
        f"<coordinateConversion><azimuthTime>{stamp(t)}</azimuthTime><gr0>0.0</gr0><grsrCoefficients count='3'>"
        + " ".join(repr(c) for c in powers(o, float(t)))
        + "</grsrCoefficients></coordinateConversion>"
        for t in np.arange(-1, 4) * 1.0
    )
    projection = "Ground Range" if kind == "grd" else "Slant Range"
    text = f"""<product><generalAnnotation><productInformation><projection>{projection}</projection>
      <rangeSamplingRate>{0.5 * LIGHT / o.range_spacing!r}</rangeSamplingRate></productInformation>
      <orbitList>{vectors}</orbitList></generalAnnotation>
      <imageAnnotation><imageInformation><productFirstLineUtcTime>{stamp(0)}</productFirstLineUtcTime>
      <slantRangeTime>{2 * o.near_range / LIGHT!r}</slantRangeTime><rangePixelSpacing>10.0</rangePixelSpacing>
      <azimuthTimeInterval>{o.line_interval!r}</azimuthTimeInterval><numberOfSamples>{SHAPE[1]}</numberOfSamples>
      <numberOfLines>{SHAPE[0]}</numberOfLines></imageInformation></imageAnnotation>
      <swathTiming><linesPerBurst>{lines if starts else 0}</linesPerBurst><burstList>{bursts}</burstList></swathTiming>
      <coordinateConversion><coordinateConversionList>{conversions if kind == "grd" else ""}</coordinateConversionList>
      </coordinateConversion><geolocationGrid><geolocationGridPointList>{"".join(grid)}</geolocationGridPointList>
      </geolocationGrid></product>"""
    return text, np.array(points)


def powers(o: RangeDopplerSensor, time: float) -> list[float]:
    return [o.near_range + 20.0 * time, 0.55 + 1e-4 * time, 4e-7]


def slant_of(o: RangeDopplerSensor, ground: float, time: float) -> float:
    return sum(c * ground**k for k, c in enumerate(powers(o, time)))


@pytest.fixture(scope="session")
def annotation() -> Callable[[str], tuple[str, FloatArray]]:
    """`_annotation`, for "grd", "stripmap" or "tops"."""
    return _annotation
