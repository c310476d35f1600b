"""The grids of SIDDs: on their surface as sarkit has them, above it by the range and range rate of the same pixel."""

from __future__ import annotations

import pickle
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.cli.info import describe
from featreg.errors import InputError
from featreg.geolocation import SiddSensor, Transfer, sensor_from_dict, sensor_of
from featreg.geolocation.heights import ConstantHeight
from featreg.io import as_image
from featreg.io.ellipsoid import earth_fixed, geodetic
from featreg.types import FloatArray

sidd: Any = pytest.importorskip("sarkit.sidd")
etree: Any = pytest.importorskip("lxml.etree")

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

SHAPE = (90, 120)
PLACE = np.array([[11.5, 46.5]])
LEVEL = 640.0
CENTRE = earth_fixed(PLACE, np.array([LEVEL]))[0]
UP = CENTRE / np.linalg.norm(CENTRE)
EAST = np.cross([0.0, 0.0, 1.0], UP) / np.linalg.norm(np.cross([0.0, 0.0, 1.0], UP))
NORTH = np.cross(UP, EAST)
#: An antenna that flies north, 500 km up and 400 km west of the scene: it looks to the right.
ORBIT = np.array([CENTRE + 5e5 * UP - 4e5 * EAST, 7500.0 * NORTH, -4.1 * UP])


def xyz(values: FloatArray) -> str:
    return "".join(
        f"<{axis}>{value!r}</{axis}>" for axis, value in zip("XYZ", np.asarray(values).tolist(), strict=True)
    )


def pair(row: Any, col: Any) -> str:
    return f"<Row>{row!r}</Row><Col>{col!r}</Col>"


def plane_terms(values: tuple[float, float, float]) -> str:
    return "".join(
        f"<Coef exponent1='{i}' exponent2='{j}'>{value!r}</Coef>"
        for (i, j), value in zip(((0, 0), (1, 0), (0, 1)), values, strict=True)
    )


def xml(kind: str, *, orbit: FloatArray = ORBIT) -> str:
    """Metadata of one of the four grids; the time at the centre of aperture changes from row to row."""
    point = pair(40.0, 50.0)
    reference = f"<ReferencePoint><ECEF>{xyz(CENTRE)}</ECEF><Point>{point}</Point></ReferencePoint>"
    coefficients = [(0, 0, 0.6), (1, 0, 1e-3), (0, 1, 0.0), (1, 1, 0.0)]
    terms = "".join(f"<Coef exponent1='{i}' exponent2='{j}'>{c}</Coef>" for i, j, c in coefficients)
    time = f"<TimeCOAPoly order1='1' order2='1'>{terms}</TimeCOAPoly>"
    if kind == "PGD":
        axes = f"<RowUnitVector>{xyz(-NORTH)}</RowUnitVector><ColUnitVector>{xyz(EAST)}</ColUnitVector>"
        spacing = f"<SampleSpacing>{pair(4.0, 5.0)}</SampleSpacing>"
        plane = f"<ProductPlane>{axes}</ProductPlane>"
        grid = f"<PlaneProjection>{reference}{spacing}{time}{plane}</PlaneProjection>"
    elif kind == "GGD":
        spacing = f"<SampleSpacing>{pair(0.15, 0.2)}</SampleSpacing>"
        grid = f"<GeographicProjection>{reference}{spacing}{time}</GeographicProjection>"
    elif kind == "PFGD":
        lon, lat = PLACE[0].tolist()
        polynomials = {
            "RowColToLat": (lat, -4e-5, 0.0), "RowColToLon": (lon, 0.0, 5e-5),
            "LatLonToRow": (lat / 4e-5, -1 / 4e-5, 0.0), "LatLonToCol": (-lon / 5e-5, 0.0, 1 / 5e-5),
        }  # fmt: skip
        parts = "".join(f"<{name}>{plane_terms(values)}</{name}>" for name, values in polynomials.items())
        grid = f"<PolynomialProjection>{reference}{parts}</PolynomialProjection>"
    else:
        spacing = f"<SampleSpacing>{pair(4.0, 5.0)}</SampleSpacing>"
        strip = f"<StripmapDirection>{xyz(0.8 * NORTH + 0.6 * EAST)}</StripmapDirection>"
        grid = f"<CylindricalProjection>{reference}{spacing}{time}{strip}</CylindricalProjection>"
    track = "".join(
        f"<{axis} order1='2'>"
        + "".join(f"<Coef exponent1='{k}'>{value!r}</Coef>" for k, value in enumerate(column.tolist()))
        + f"</{axis}>"
        for axis, column in zip("XYZ", orbit.T, strict=True)
    )
    places = ((0.002, -0.003), (0.002, 0.004), (-0.002, 0.004), (-0.002, -0.003))
    corners = "".join(
        f"<ICP index='{name}'><Lat>{PLACE[0, 1] + lat}</Lat><Lon>{PLACE[0, 0] + lon}</Lon></ICP>"
        for name, (lat, lon) in zip(("1:FRFC", "2:FRLC", "3:LRLC", "4:LRFC"), places, strict=True)
    )
    return (
        '<SIDD xmlns="urn:SIDD:3.0.0"><Display><PixelType>MONO8I</PixelType></Display>'
        f"<GeoData><ImageCorners>{corners}</ImageCorners></GeoData>"
        f"<Measurement>{grid}<PixelFootprint>{pair(*SHAPE)}</PixelFootprint><ARPPoly>{track}</ARPPoly></Measurement>"
        "<ExploitationFeatures><Collection><Information><SensorName>made up</SensorName>"
        "<CollectionDateTime>2024-01-02T03:04:05Z</CollectionDateTime></Information></Collection></ExploitationFeatures>"
        "</SIDD>"
    )


def sicommon(text: str) -> str:
    """The text with what belongs to the common namespace in it."""
    root = etree.fromstring(text)
    for element in root.iter():
        name = etree.QName(element).localname
        if name in ("Row", "Col", "X", "Y", "Z", "Coef", "ECEF", "Point", "Lat", "Lon"):
            element.tag = f"{{urn:SICommon:1.0}}{name}"
    return str(etree.tostring(root, encoding="unicode"))


def points() -> FloatArray:
    rng = np.random.default_rng(0)
    return rng.uniform(0, [SHAPE[1] - 1, SHAPE[0] - 1], (200, 2))


@pytest.mark.parametrize("kind", ["PGD", "GGD", "PFGD"])
def test_on_its_surface_it_is_that_of_sarkit(kind: str) -> None:
    text = sicommon(xml(kind))
    sensor, xy = SiddSensor(text), points()
    tree = etree.ElementTree(etree.fromstring(text))
    wanted = geodetic(sidd.pixel_to_ecef(tree, xy[:, ::-1]))
    found = sensor.image_to_ground(xy, wanted[:, 2])
    np.testing.assert_allclose(found, wanted[:, :2], atol=1e-9)
    np.testing.assert_allclose(sensor.ground_to_image(wanted[:, :2], wanted[:, 2]), xy, atol=1e-4)
    assert sensor.level == pytest.approx(LEVEL, abs=1.0)


def test_above_it_range_and_range_rate_are_those_of_the_pixel() -> None:
    text = sicommon(xml("PGD"))
    sensor, xy = SiddSensor(text), points()
    heights = np.random.default_rng(1).uniform(0.0, 3000.0, len(xy))
    ground = sensor.image_to_ground(xy, heights)
    high = earth_fixed(ground, heights)
    surface = sidd.pixel_to_ecef(etree.ElementTree(etree.fromstring(text)), xy[:, ::-1])
    time = 0.6 + 1e-3 * xy[:, 1]
    position = ORBIT[0] + ORBIT[1] * time[:, None] + ORBIT[2] * time[:, None] ** 2
    velocity = ORBIT[1] + 2 * ORBIT[2] * time[:, None]
    moved, reached = (np.linalg.norm(place - position, axis=1) for place in (high, surface))
    np.testing.assert_allclose(moved, reached, atol=1e-3)
    np.testing.assert_allclose(np.sum(velocity * (high - surface), axis=1) / 7500.0, 0.0, atol=1e-3)
    # What is higher lies further from the antenna, which flies west of the scene, than it seems.
    seems = geodetic(surface)
    assert ((ground[:, 0] - seems[:, 0])[heights > 1000] > 0).all()
    np.testing.assert_allclose(sensor.ground_to_image(ground, heights), xy, atol=1e-3)


def test_a_map_has_one_place_at_every_height() -> None:
    sensor, xy = SiddSensor(sicommon(xml("GGD"))), points()
    np.testing.assert_array_equal(sensor.image_to_ground(xy, 0.0), sensor.image_to_ground(xy, 2000.0))


def test_a_side_is_told_from_the_orbit() -> None:
    mirrored = ORBIT - 2 * (ORBIT - CENTRE * [[1], [0], [0]]) @ np.outer(EAST, EAST)
    left = SiddSensor(sicommon(xml("PGD", orbit=mirrored)))
    middle = np.array([left.centre])
    assert left.image_to_ground(middle, LEVEL + 500)[0, 0] < left.image_to_ground(middle, LEVEL)[0, 0]


@pytest.fixture
def product(tmp_path: Path) -> Path:
    return written(tmp_path / "a.nitf", sicommon(xml("PGD")))


def written(path: Path, text: str) -> Path:
    part = {"security": {"clas": "U"}}
    image = np.random.default_rng(0).integers(1, 255, SHAPE, dtype=np.uint8)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        tree = etree.ElementTree(etree.fromstring(text))
        meta = sidd.NitfMetadata(
            file_header_part={"ostaid": "featreg", **part},
            images=[sidd.NitfProductImageMetadata(xmltree=tree, im_subheader_part=part, de_subheader_part=part)],
        )
        with path.open("wb") as file, sidd.NitfWriter(file, meta) as writer:
            writer.write_image(0, image)
    return path


def test_a_file_is_read_with_its_place(product: Path) -> None:
    image = as_image(product)
    np.testing.assert_array_equal(image.pixels, np.random.default_rng(0).integers(1, 255, SHAPE, dtype=np.uint8))
    assert image.geolocation is not None
    sensor = sensor_of(image.geolocation, image.shape, "a")
    assert isinstance(sensor, SiddSensor)
    xy = points()
    wanted = SiddSensor(sicommon(xml("PGD"))).image_to_ground(xy, 900.0)
    for one in (sensor, pickle.loads(pickle.dumps(sensor)), sensor_from_dict(sensor.to_dict())):
        np.testing.assert_array_equal(one.image_to_ground(xy, 900.0), wanted)
    place = describe(str(product))["place"]
    assert (place["kind"], place["level_from"]) == ("grid of the SIDD", "surface of the SIDD")
    assert place["ground_level_m"] == pytest.approx(LEVEL, abs=1.0)
    assert Transfer(sensor, sensor, ConstantHeight(100.0))(xy) == pytest.approx(xy, abs=1e-3)


def test_without_sarkit_it_lies_where_its_nitf_says(
    product: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setitem(sys.modules, "sarkit.sidd", None)
    image = as_image(product)
    assert "pip install 'featreg[sicd]'" in caplog.text
    assert image.geolocation is None or image.geolocation.sensor is None
    with pytest.raises(InputError, match="needs sarkit"):
        SiddSensor(sicommon(xml("PGD")))


@pytest.mark.parametrize("name", ["ARPPoly", "TimeCOAPoly"])
def test_a_file_that_lacks_something_lies_where_its_nitf_says(
    name: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = written(tmp_path / "a.nitf", sicommon(xml("PGD")).replace(name, f"{name}2"))
    image = as_image(path)
    assert f"make no projection (it has no {name})" in caplog.text
    assert image.geolocation is None or image.geolocation.sensor is None


@pytest.mark.parametrize("name", ["PlaneProjection", "PixelFootprint", "TimeCOAPoly", "ARPPoly", "ProductPlane"])
def test_what_lacks_something_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="metadata of the SIDD do not make a grid"):
        SiddSensor(sicommon(xml("PGD").replace(name, f"{name}2")))


def test_what_is_no_number_or_cylindrical_is_refused() -> None:
    for text in (sicommon(xml("CGD")), sicommon(xml("PGD", orbit=ORBIT * np.nan)), "<SIDD/>", "no XML"):
        with pytest.raises(InputError, match="metadata of the SIDD"):
            SiddSensor(text)
