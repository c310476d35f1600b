"""Sentinel-1's annotation: a made one of an orbit that is known exactly, and broken ones."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError
from featreg.geolocation import RangeDopplerSensor, sensor_from_dict
from featreg.io.products.sentinel1 import annotation_of, grid_of, parsed, sensor_of_annotation

SHAPE = (900, 1200)


@pytest.fixture
def safe(tmp_path: Path) -> Path:
    folder = tmp_path / "S1A.SAFE"
    for name in ("annotation", "measurement"):
        (folder / name).mkdir(parents=True)
    return folder


@pytest.mark.parametrize("kind", ["grd", "stripmap", "tops"])
def test_the_sensor_meets_the_grid_of_the_annotation(safe: Path, kind: str, annotation: Any) -> None:
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


def test_ground_range_that_changes_fast_counts_as_inaccurate(safe: Path, annotation: Any) -> None:
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
def test_broken_annotations_are_named(safe: Path, change: Any, text: str, annotation: Any) -> None:
    path = safe / "annotation" / "s1a-vv.xml"
    path.write_text(change(annotation("stripmap")[0]))
    with pytest.raises(InputError, match=text) as caught:
        sensor_of_annotation(path)
    assert "s1a-vv.xml" in str(caught.value)
    assert "\n" not in str(caught.value)
