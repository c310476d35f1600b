"""The projection of a SICD: against sarkit on the whole metadata, and against a geometry that is known otherwise."""

from __future__ import annotations

import json
import pickle
import sys
from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError
from featreg.geolocation import ConstantHeight, SicdSensor, Transfer, ground_level, sensor_from_dict
from featreg.io.ellipsoid import earth_fixed
from featreg.io.products.sicd import sensor_of_sicd
from featreg.simulate.orbit import RangeDoppler
from featreg.simulate.sicd import sicd_xml

sicd = pytest.importorskip("sarkit.sicd")
etree = pytest.importorskip("lxml.etree")
SHAPE = (1500, 2000)
HEIGHTS = [0.0, 400.0, 1500.0, 3000.0]


def view(incidence: float = 35.0) -> RangeDoppler:
    return RangeDoppler.over((12.0, 47.0), SHAPE, incidence_deg=incidence, heading_deg=-12.0, pixel=3.0, height=400.0)


@pytest.fixture(scope="module")
def tree() -> Any:
    return etree.ElementTree(etree.fromstring(sicd_xml(view(), SHAPE, 400.0)))


@pytest.fixture(scope="module")
def sensor(tree: Any) -> SicdSensor:
    made = sensor_from_dict(sensor_of_sicd(tree))
    assert isinstance(made, SicdSensor)
    return made


def points(count: int = 60) -> Any:
    return np.random.default_rng(0).uniform(0, [SHAPE[0], SHAPE[1]], (count, 2))


@pytest.mark.parametrize("height", HEIGHTS)
def test_agrees_with_sarkit_on_the_whole_metadata(tree: Any, sensor: SicdSensor, height: float) -> None:
    p = points()
    plane = sicd.rowcol_to_xrowycol(tree, p[:, ::-1])
    ecef, _, converged = sicd.image_to_constant_hae_surface(tree, plane, np.full(len(p), height), nlim=10)
    assert converged
    ground = sensor.image_to_ground(p, height)
    metres = earth_fixed(ground, np.full(len(p), height)) - ecef
    assert np.linalg.norm(metres, axis=1).max() < 0.01 * 3.0
    back, _, found = sicd.scene_to_image(tree, ecef)
    assert found
    expected = sicd.xrowycol_to_rowcol(tree, back)[:, ::-1]
    assert np.abs(sensor.ground_to_image(ground, height) - expected).max() < 0.01
    np.testing.assert_allclose(sensor.ground_to_image(ground, height), p, atol=1e-3)


@pytest.mark.parametrize("height", HEIGHTS)
def test_agrees_with_the_orbit_that_it_was_made_of(sensor: SicdSensor, height: float) -> None:
    """Columns of a SICD are flight and its rows are range, so x and y stand the other way round there."""
    p = points()
    ground = view().image_to_ground(p[:, ::-1], height)
    np.testing.assert_allclose(sensor.ground_to_image(ground, height), p, atol=1e-3)
    np.testing.assert_allclose(sensor.image_to_ground(p, height), ground, atol=1e-8)


def test_from_one_image_to_another_over_high_ground(sensor: SicdSensor) -> None:
    other = SicdSensor(sicd_xml(view(45.0), SHAPE, 400.0))
    p = points()
    transfer = Transfer(sensor, other, ConstantHeight(2500.0))
    expected = Transfer(view(), view(45.0), ConstantHeight(2500.0))(p[:, ::-1])[:, ::-1]
    np.testing.assert_allclose(transfer(p), expected, atol=2e-3)


def test_a_point_does_not_depend_on_its_company(sensor: SicdSensor) -> None:
    p, heights = points(300), np.linspace(0, 3000, 300)
    ground = sensor.image_to_ground(p, heights)
    assert np.array_equal(ground[11:12], sensor.image_to_ground(p[11:12], heights[11:12]))
    seen = sensor.ground_to_image(ground, heights)
    assert np.array_equal(seen[11:12], sensor.ground_to_image(ground[11:12], heights[11:12]))


def test_points_that_are_nowhere(sensor: SicdSensor) -> None:
    p = np.array([[np.nan, 1.0], [5.0, 5.0], [5.0, -1.5e5]])
    assert np.isnan(sensor.image_to_ground(p, [0.0, np.nan, 0.0])).all()
    assert np.isnan(sensor.ground_to_image(np.array([[np.nan, 40.0]]), 0.0)).all()
    assert sensor.image_to_ground(np.zeros((0, 2)), 0.0).shape == (0, 2)


def test_record(sensor: SicdSensor, tree: Any) -> None:
    p = points(5)
    for again in (sensor_from_dict(json.loads(json.dumps(sensor.to_dict()))), pickle.loads(pickle.dumps(sensor))):
        assert np.array_equal(again.image_to_ground(p, 10.0), sensor.image_to_ground(p, 10.0))
    assert ground_level(sensor) == (400.0, "scene centre point of the SICD")
    assert sensor.centre == ((SHAPE[0] - 1) / 2, (SHAPE[1] - 1) / 2)
    assert np.allclose(sensor.pixel_size(400.0), 3.0, rtol=0.02)
    assert "Timeline" not in sensor.xml
    assert "ImageCorners" not in sensor.xml
    assert sensor.uncertainty_px == pytest.approx(5.0, rel=0.02)


def test_stated_errors_make_the_uncertainty(tree: Any) -> None:
    errors = "<ErrorStatistics><CompositeSCP><Rg>3.0</Rg><Az>4.0</Az><RgAz>0.0</RgAz></CompositeSCP></ErrorStatistics>"
    stated = SicdSensor(sicd_xml(view(), SHAPE, 400.0).replace("<RMA>", f"{errors}<RMA>"))
    assert stated.uncertainty_px == pytest.approx(3 * 5.0 / 3.0, rel=0.02)


@pytest.mark.parametrize("xml", ["", "<SICD>", "<SICD xmlns='urn:SICD:1.4.0'/>"])
def test_metadata_without_a_projection(xml: str) -> None:
    with pytest.raises(InputError, match="do not make a projection"):
        SicdSensor(xml)


def test_without_sarkit(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("sarkit", "sarkit.sicd", "sarkit.sicd.projection"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(InputError, match=r"featreg\[sicd\]"):
        SicdSensor("<SICD/>")
