"""A simulated image as a SICD, whose projection is the simulation's exact geometry (the `sicd` extra)."""

from __future__ import annotations

import warnings
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from featreg.io.ellipsoid import earth_fixed
from featreg.io.writers import replacing
from featreg.simulate.orbit import ORBIT, RATE, RangeDoppler
from featreg.types import FloatArray

NAMESPACE = "urn:SICD:1.4.0"
#: Carrier of the made-up radar, 1/m: X band.
WAVENUMBER = 64.0


def write_sicd(path: str | Path, samples: NDArray[np.complex64], view: RangeDoppler, level: float) -> None:
    """Write the samples of a simulated image as a SICD; it appears whole or not at all.

    Parameters
    ----------
    path : of the file
    samples : (H, W) complex64; columns are slant range and rows flight, as `view` has them. A SICD holds them with
        rows in range and columns in flight
    view : the geometry of the image
    level : height of the scene centre point, metres
    """
    etree: Any = import_module("lxml.etree")
    sicd: Any = import_module("sarkit.sicd")
    part = {"security": {"clas": "U"}}
    tree = etree.ElementTree(etree.fromstring(sicd_xml(view, samples.shape, level)))
    meta = sicd.NitfMetadata(
        xmltree=tree, file_header_part={"ostaid": "featreg", **part}, im_subheader_part={"isorce": "simulated", **part},
        de_subheader_part=part,
    )  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with replacing(Path(path)) as temporary, temporary.open("wb") as file, sicd.NitfWriter(file, meta) as writer:
            writer.write_image(np.ascontiguousarray(samples.T))


def sicd_xml(view: RangeDoppler, shape: tuple[int, ...], level: float) -> str:
    """The metadata of a SICD (range migration, zero-Doppler grid) of an image of (H, W) pixels: exact to 1e-6 px."""
    rows, columns = shape[1], shape[0]
    row, column = rows // 2, columns // 2
    place = np.array([[float(row), float(column)]])
    ground = view.image_to_ground(place, level)
    centre = earth_fixed(ground, np.array([level]))[0]
    interval = view.spacing[1] / RATE
    metres = view.spacing[1] * 6.4e6
    time = (column - view.middle[1]) * interval
    position, velocity = _state(view, time)
    distance = float(np.linalg.norm(centre - position))
    away, along = (centre - position) / distance, velocity / np.linalg.norm(velocity)
    lon, lat = ground[0].tolist()
    corners = "".join(
        f'<ICP index="{name}"><Lat>{b!r}</Lat><Lon>{a!r}</Lon></ICP>'
        for name, (a, b) in zip(
            ("1:FRFC", "2:FRLC", "3:LRLC", "4:LRFC"),
            view.image_to_ground(
                np.array([[0, 0], [0, columns - 1], [rows - 1, columns - 1], [rows - 1, 0.0]]), level
            ).tolist(),
            strict=True,
        )
    )
    return f"""<SICD xmlns="{NAMESPACE}">
    <CollectionInfo><CollectorName>simulated</CollectorName><CoreName>simulated</CoreName>
      <CollectType>MONOSTATIC</CollectType><RadarMode><ModeType>STRIPMAP</ModeType></RadarMode>
      <Classification>UNCLASSIFIED</Classification></CollectionInfo>
    <ImageData><PixelType>RE32F_IM32F</PixelType><NumRows>{rows}</NumRows><NumCols>{columns}</NumCols>
      <FirstRow>0</FirstRow><FirstCol>0</FirstCol><FullImage><NumRows>{rows}</NumRows><NumCols>{columns}</NumCols>
      </FullImage><SCPPixel><Row>{row}</Row><Col>{column}</Col></SCPPixel></ImageData>
    <GeoData><EarthModel>WGS_84</EarthModel><SCP>{_vector("ECF", centre)}
      <LLH><Lat>{lat!r}</Lat><Lon>{lon!r}</Lon><HAE>{level!r}</HAE></LLH></SCP>
      <ImageCorners>{corners}</ImageCorners></GeoData>
    <Grid><ImagePlane>SLANT</ImagePlane><Type>RGZERO</Type>
      {_plane("TimeCOAPoly", [[time, interval / metres]])}
      <Row>{_vector("UVectECF", away)}{_direction(view.spacing[0])}</Row>
      <Col>{_vector("UVectECF", along)}{_direction(metres)}</Col></Grid>
    <Timeline><CollectStart>2020-01-01T00:00:00.000000Z</CollectStart><CollectDuration>1.0</CollectDuration></Timeline>
    <Position><ARPPoly>{_orbit(view)}</ARPPoly></Position>
    <ImageFormation><RcvChanProc><NumChanProc>1</NumChanProc><ChanIndex>1</ChanIndex></RcvChanProc>
      <TxRcvPolarizationProc>V:V</TxRcvPolarizationProc><ImageFormAlgo>RMA</ImageFormAlgo></ImageFormation>
    <SCPCOA><SCPTime>{time!r}</SCPTime>{_vector("ARPPos", position)}{_vector("ARPVel", velocity)}
      {_vector("ARPAcc", -(RATE**2) * position)}<SideOfTrack>R</SideOfTrack>
      <SlantRange>{distance!r}</SlantRange></SCPCOA>
    <RMA><RMAlgoType>OMEGA_K</RMAlgoType><ImageType>INCA</ImageType><INCA>
      {_line("TimeCAPoly", [time, interval / metres])}<R_CA_SCP>{distance!r}</R_CA_SCP><FreqZero>9.6E9</FreqZero>
      {_plane("DRateSFPoly", [[1.0]])}</INCA></RMA></SICD>"""


def _state(view: RangeDoppler, time: float) -> tuple[FloatArray, FloatArray]:
    s, c = np.sin(RATE * time), np.cos(RATE * time)
    toward, along = np.array(view.toward), np.array(view.along)
    return ORBIT * (c * toward + s * along), ORBIT * RATE * (c * along - s * toward)


def _orbit(view: RangeDoppler) -> str:
    """The circle as powers of time, to the eighth."""
    powers = np.zeros((9, 3))
    term = 1.0
    for k in range(9):
        if k:
            term *= RATE / k
        direction = (view.toward, view.along)[k % 2]
        powers[k] = (-1.0) ** (k // 2) * term * ORBIT * np.array(direction)
    return "".join(_line(axis, powers[:, i].tolist()) for i, axis in enumerate("XYZ"))


def _vector(name: str, values: FloatArray) -> str:
    x, y, z = values.tolist()
    return f"<{name}><X>{x!r}</X><Y>{y!r}</Y><Z>{z!r}</Z></{name}>"


def _line(name: str, powers: list[float]) -> str:
    terms = "".join(f'<Coef exponent1="{k}">{c!r}</Coef>' for k, c in enumerate(powers))
    return f'<{name} order1="{len(powers) - 1}">{terms}</{name}>'


def _plane(name: str, powers: list[list[float]]) -> str:
    terms = "".join(
        f'<Coef exponent1="{i}" exponent2="{j}">{c!r}</Coef>'
        for i, line in enumerate(powers)
        for j, c in enumerate(line)
    )
    return f'<{name} order1="{len(powers) - 1}" order2="{len(powers[0]) - 1}">{terms}</{name}>'


def _direction(spacing: float) -> str:
    return (
        f"<SS>{spacing!r}</SS><ImpRespWid>{1.2 * spacing!r}</ImpRespWid><Sgn>-1</Sgn>"
        f"<ImpRespBW>{0.8 / spacing!r}</ImpRespBW><KCtr>{WAVENUMBER!r}</KCtr>"
    )
