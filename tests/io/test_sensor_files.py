"""Files as sensors' processors deliver them: Sentinel-1 measurement TIFFs, NITF with RPC, SICD."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.io import as_image
from featreg.io.raster_source import RasterSource, Window
from featreg.io.sicd import _samples

rasterio = pytest.importorskip("rasterio")
pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

SHAPE = (60, 80)
SLC = (np.random.default_rng(0).integers(-900, 900, (2, *SHAPE)) * np.array([1, 1j])[:, None, None]).sum(axis=0)


def control_points() -> list[Any]:
    from rasterio.control import GroundControlPoint

    return [
        GroundControlPoint(row=r, col=c, x=10 + c / 1e3, y=50 - r / 1e3, z=30.0)
        for r in (0.0, 30.0, 59.0)
        for c in (0.0, 40.0, 79.0)
    ]


@pytest.mark.parametrize("product", ["grd", "slc"])
def test_sentinel_1_measurements_bring_their_control_points(tmp_path: Path, product: str) -> None:
    dtype = {"grd": "uint16", "slc": "complex_int16"}[product]
    samples = np.abs(SLC).astype(np.uint16) if product == "grd" else SLC.astype(np.complex64)
    path = tmp_path / f"s1a-iw-{product}-vv.tiff"
    profile: dict[str, Any] = {"driver": "GTiff", "height": SHAPE[0], "width": SHAPE[1], "count": 1, "dtype": dtype}
    with rasterio.open(path, "w", crs="EPSG:4326", gcps=control_points(), **profile) as dataset:
        dataset.write(samples, 1)
    image = as_image(path)
    assert image.pixels.dtype == (np.float32 if product == "grd" else np.complex64)
    np.testing.assert_array_equal(image.pixels, samples)
    assert image.geolocation is not None
    assert image.geolocation.gcps is not None
    # GDAL's column 40 is 40 from the corner of the first pixel, 39.5 from its centre.
    np.testing.assert_allclose(image.geolocation.gcps[4], [39.5, 29.5, 10.04, 49.97, 30])
    window = RasterSource(str(path)).read(Window(10, 20, 30, 16))
    np.testing.assert_array_equal(window.pixels, samples[20:36, 10:40])


def test_nitf_with_rpc(tmp_path: Path) -> None:
    from rasterio.rpc import RPC

    one = [1.0] + [0.0] * 19
    rpc = RPC(
        line_off=30.0, samp_off=40.0, line_scale=30.0, samp_scale=40.0, lat_off=41.0, lat_scale=0.1, long_off=15.0,
        long_scale=0.1, height_off=0.0, height_scale=100.0, line_num_coeff=[0.0, 0.0, 1.0] + [0.0] * 17,
        line_den_coeff=one, samp_num_coeff=[0.0, 1.0] + [0.0] * 18, samp_den_coeff=one, err_bias=1.0, err_rand=1.0,
    )  # fmt: skip
    path = tmp_path / "scene.ntf"
    samples = np.abs(SLC).astype(np.uint16)
    with rasterio.open(path, "w", driver="NITF", height=60, width=80, count=1, dtype="uint16", rpcs=rpc) as dataset:
        dataset.write(samples, 1)
    image = as_image(path)
    np.testing.assert_array_equal(image.pixels, samples)
    assert image.geolocation is not None
    assert image.geolocation.rpcs is not None
    assert image.geolocation.rpcs["samp_off"] == 40
    np.testing.assert_array_equal(RasterSource(str(path)).read(Window(5, 6, 20, 20)).pixels, samples[6:26, 5:25])
    (tmp_path / "none.ntf").write_bytes(b"II*\0 and so on")
    with pytest.raises(InputError, match="broken"):
        as_image(tmp_path / "none.ntf")


SCP = np.array([6378137.0, 0.0, 0.0])  # longitude 0, latitude 0, height 0
NAMESPACE = "urn:SICD:1.4.0"


def vector(name: str, values: Any) -> str:
    x, y, z = (float(v) for v in values)
    return f"<{name}><X>{x}</X><Y>{y}</Y><Z>{z}</Z></{name}>"


def polynomial(name: str, *coefficients: float) -> str:
    terms = "".join(f'<Coef exponent1="{k}">{c}</Coef>' for k, c in enumerate(coefficients))
    return f'<{name} order1="{len(coefficients) - 1}">{terms}</{name}>'


def sicd_xml(pixel_type: str, first: tuple[int, int] = (0, 0)) -> str:
    """A platform 700 km up flies north past a plane grid at the equator; rows go east, columns north, 10 m apart.

    The image is the part of the grid that starts at the row and column `first`.
    """
    arp, velocity = SCP + np.array([700e3, -500e3, 0.0]), np.array([0.0, 0.0, 7500.0])
    corners = "".join(
        f'<ICP index="{name}"><Lat>{lat}</Lat><Lon>{lon}</Lon></ICP>'
        for name, lat, lon in [("1:FRFC", 0.1, 0.1), ("2:FRLC", 0.2, 0.1), ("3:LRLC", 0.2, 0.2), ("4:LRFC", 0.1, 0.2)]
    )
    direction = "<SS>10.0</SS><ImpRespWid>12.0</ImpRespWid><Sgn>-1</Sgn><ImpRespBW>0.08</ImpRespBW><KCtr>0.0</KCtr>"
    return f"""<SICD xmlns="{NAMESPACE}">
    <CollectionInfo><CollectorName>test</CollectorName><CoreName>test</CoreName><CollectType>MONOSTATIC</CollectType>
      <RadarMode><ModeType>STRIPMAP</ModeType></RadarMode><Classification>UNCLASSIFIED</Classification></CollectionInfo>
    <ImageData><PixelType>{pixel_type}</PixelType><NumRows>60</NumRows><NumCols>80</NumCols><FirstRow>{first[0]}</FirstRow>
      <FirstCol>{first[1]}</FirstCol><FullImage><NumRows>{60 + first[0]}</NumRows>
      <NumCols>{80 + first[1]}</NumCols></FullImage>
      <SCPPixel><Row>30</Row><Col>40</Col></SCPPixel></ImageData>
    <GeoData><EarthModel>WGS_84</EarthModel><SCP>{vector("ECF", SCP)}
      <LLH><Lat>0.0</Lat><Lon>0.0</Lon><HAE>0.0</HAE></LLH></SCP><ImageCorners>{corners}</ImageCorners></GeoData>
    <Grid><ImagePlane>GROUND</ImagePlane><Type>PLANE</Type>
      <TimeCOAPoly order1="0" order2="0"><Coef exponent1="0" exponent2="0">0.0</Coef></TimeCOAPoly>
      <Row>{vector("UVectECF", [0, 1, 0])}{direction}</Row><Col>{vector("UVectECF", [0, 0, 1])}{direction}</Col></Grid>
    <Timeline><CollectStart>2020-01-01T00:00:00.000000Z</CollectStart><CollectDuration>1.0</CollectDuration></Timeline>
    <Position><ARPPoly>{polynomial("X", arp[0], velocity[0])}{polynomial("Y", arp[1], velocity[1])}
      {polynomial("Z", arp[2], velocity[2])}</ARPPoly></Position>
    <SCPCOA><SCPTime>0.0</SCPTime>{vector("ARPPos", arp)}{vector("ARPVel", velocity)}{vector("ARPAcc", [0, 0, 0])}
      <SideOfTrack>R</SideOfTrack></SCPCOA></SICD>"""


def write_sicd(path: Path, raw: NDArray[Any], pixel_type: str, first: tuple[int, int] = (0, 0)) -> None:
    sicd = pytest.importorskip("sarkit.sicd")
    etree = pytest.importorskip("lxml.etree")
    tree = etree.ElementTree(etree.fromstring(sicd_xml(pixel_type, first)))
    part = {"security": {"clas": "U"}}
    meta = sicd.NitfMetadata(
        xmltree=tree, file_header_part={"ostaid": "here"} | part, im_subheader_part={"isorce": "test"} | part,
        de_subheader_part=part,
    )  # fmt: skip
    with path.open("wb") as file, sicd.NitfWriter(file, meta) as writer:
        writer.write_image(raw)


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore:.*SCHEMASV:UserWarning")  # of sarkit
@pytest.mark.parametrize("pixel_type", ["RE32F_IM32F", "RE16I_IM16I"])
def test_sicd_samples_and_geometry(tmp_path: Path, pixel_type: str) -> None:
    raw: NDArray[Any] = SLC.astype(np.complex64)
    if pixel_type == "RE16I_IM16I":
        raw = np.zeros(SHAPE, [("real", "i2"), ("imag", "i2")])
        raw["real"], raw["imag"] = SLC.real, SLC.imag
    path = tmp_path / "scene.nitf"
    write_sicd(path, raw, pixel_type)
    image = as_image(path)
    assert image.is_complex
    np.testing.assert_array_equal(image.pixels, SLC.astype(np.complex64))
    assert image.geolocation is not None
    gcps = image.geolocation.gcps
    assert gcps is not None
    # 10 m are 10 / 6378137 radians of longitude along rows (y), and of geodetic latitude along columns (x).
    degrees = np.degrees(10 / 6378137.0)
    north = np.degrees(10 / (6378137.0 * (1 - 0.00669438)))
    np.testing.assert_allclose(
        gcps[:, 2], (gcps[:, 1] - 30) * degrees, atol=1e-6
    )  # 0.01 px: rows are on the tangent plane
    np.testing.assert_allclose(
        gcps[:, 3], (gcps[:, 0] - 40) * north, atol=1e-6
    )  # 0.01 px: rows are on the tangent plane
    np.testing.assert_allclose(gcps[:, 4], 0, atol=0.5)
    np.testing.assert_array_equal(RasterSource(str(path)).read(Window(3, 4, 20, 20)).pixels, image.pixels[4:24, 3:23])


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore:.*SCHEMASV:UserWarning")  # of sarkit
def test_a_sicd_that_is_a_part_of_a_larger_image_lies_where_that_part_does(tmp_path: Path) -> None:
    path = tmp_path / "part.nitf"
    write_sicd(path, SLC.astype(np.complex64), "RE32F_IM32F", first=(20, 10))
    place = as_image(path).geolocation
    assert place is not None
    assert place.gcps is not None
    centre = place.gcps[(place.gcps[:, :2] == [0, 0]).all(axis=1)][0]
    # The scene centre point is pixel (30, 40) of the whole image.
    degrees, north = np.degrees(10 / 6378137.0), np.degrees(10 / (6378137.0 * (1 - 0.00669438)))
    np.testing.assert_allclose(centre[2:4], [(20 - 30) * degrees, (10 - 40) * north], atol=1e-6)


def test_sicd_amplitude_and_phase() -> None:
    raw = np.array([[(2, 64)]], [("amp", "u1"), ("phase", "u1")])
    assert abs(_samples(raw, None)[0, 0] - 2j) < 1e-6
    assert abs(_samples(raw, np.linspace(0.0, 2550.0, 256))[0, 0] - 20j) < 1e-5


def test_a_sicd_without_sarkit_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "scene.nitf"
    path.write_bytes(b"NITF02.10" + b" " * 500 + b'<SICD xmlns="urn:SICD:1.4.0">')
    for name in ("sarkit", "sarkit.sicd"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(InputError, match=r"pip install 'featreg\[sicd\]'"):
        as_image(path)
    monkeypatch.undo()
    pytest.importorskip("sarkit")
    with pytest.raises(InputError, match="SICD file is broken"):
        as_image(path)
