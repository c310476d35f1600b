"""Sentinel-1's annotation: a made one of an orbit that is known exactly, and broken ones."""

from __future__ import annotations

import math
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError
from featreg.geolocation import RangeDopplerSensor, sensor_from_dict
from featreg.io.products.sentinel1 import annotation_of, grid_of, parsed, sensor_of_annotation
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


def annotation(kind: str) -> tuple[str, FloatArray]:
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


@pytest.fixture
def safe(tmp_path: Path) -> Path:
    folder = tmp_path / "S1A.SAFE"
    for name in ("annotation", "measurement"):
        (folder / name).mkdir(parents=True)
    return folder


@pytest.mark.parametrize("kind", ["grd", "stripmap", "tops"])
def test_the_sensor_meets_the_grid_of_the_annotation(safe: Path, kind: str) -> None:
    text, points = annotation(kind)
    path = safe / "annotation" / "s1a-vv.xml"
    path.write_text(text)
    measurement = safe / "measurement" / "s1a-vv.tiff"
    assert annotation_of(measurement) == path
    sensor = sensor_from_dict(sensor_of_annotation(path))
    assert isinstance(sensor, RangeDopplerSensor)
    assert sensor.shape == SHAPE
    # Times of an annotation are told to a microsecond: 0.001 px.
    np.testing.assert_allclose(sensor.image_to_ground(points[:, 3:], points[:, 2]), points[:, :2], atol=1e-7)
    seen = sensor.ground_to_image(points[:, :2], points[:, 2])
    inside = np.ones(len(points), bool) if kind != "tops" else points[:, 4] % 300 > 5
    np.testing.assert_allclose(seen[inside], points[inside, 3:], atol=0.01)
    assert sensor.ground_m == pytest.approx(np.median(points[:, 2]))
    grid = np.array(list(grid_of(parsed(path))))
    np.testing.assert_allclose(grid[:, :2], points[:, 3:])


def test_ground_range_that_changes_fast_counts_as_inaccurate(safe: Path) -> None:
    path = safe / "annotation" / "s1a-vv.xml"
    path.write_text(annotation("grd")[0])
    # At the far end the polynomials of neighbouring seconds are 20 m + 1e-4 x 12 km = 21.2 m of range apart.
    assert sensor_of_annotation(path)["accuracy_m"] == pytest.approx(math.hypot(15.0, 10.6), rel=1e-6)


def test_a_file_without_annotation(safe: Path, tmp_path: Path) -> None:
    assert annotation_of(safe / "measurement" / "other.tiff") is None
    assert annotation_of(tmp_path / "s1a-vv.tiff") is None


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda t: t[: len(t) // 2], "is no XML"),
        (lambda t: t.replace("azimuthTimeInterval", "other"), "azimuthTimeInterval is missing"),
        (lambda t: t.replace("<product>", "<other>").replace("</product>", "</other>"), "not a whole annotation"),
        (lambda t: t.replace("Earth Fixed", "GM2000"), "Earth Fixed"),
        (lambda t: '<!DOCTYPE a [<!ENTITY b "c">]>' + t, "entities"),
        (lambda t: t.replace("2024-05-06", "yesterday"), "not a whole annotation"),
    ],
)
def test_broken_annotations_are_named(safe: Path, change: Any, text: str) -> None:
    path = safe / "annotation" / "s1a-vv.xml"
    path.write_text(change(annotation("stripmap")[0]))
    with pytest.raises(InputError, match=text) as caught:
        sensor_of_annotation(path)
    assert "s1a-vv.xml" in str(caught.value)
    assert "\n" not in str(caught.value)
