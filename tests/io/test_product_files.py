"""Products of RADARSAT-2, TerraSAR-X and COSMO-SkyMed, made small with the elements that readers ask for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from featreg.errors import InputError
from featreg.io import as_image
from featreg.io.raster_source import Window, open_source

rasterio = pytest.importorskip("rasterio")
pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

H, W = 60, 90
RNG = np.random.default_rng(6)
AMPLITUDE = RNG.integers(1, 900, (H, W)).astype(np.uint16)
COMPLEX = (RNG.integers(-900, 900, (H, W)) + 1j * RNG.integers(-900, 900, (H, W))).astype(np.complex64)


def radarsat(folder: Path) -> Path:
    for pol, gain in (("HH", 1), ("HV", 2)):
        size = {"driver": "GTiff", "height": H, "width": W, "count": 1, "dtype": "uint16"}
        with rasterio.open(folder / f"imagery_{pol}.tif", "w", **size) as dataset:
            dataset.write(AMPLITUDE * gain, 1)
    points = "".join(
        f"<imageTiePoint><imageCoordinate><line>{r}</line><pixel>{c}</pixel></imageCoordinate><geodeticCoordinate>"
        f"<latitude>{45 - r * 1e-4}</latitude><longitude>{-75 + c * 1e-4}</longitude><height>10</height>"
        "</geodeticCoordinate></imageTiePoint>"
        for r in (0, H)
        for c in (0, W)
    )
    (folder / "product.xml").write_text(
        '<product xmlns="http://www.rsi.ca/rs2/prod/xml/schemas"><imageGenerationParameters>'
        "<generalProcessingInformation><productType>SGF</productType></generalProcessingInformation>"
        "</imageGenerationParameters><imageAttributes><rasterAttributes><dataType>Magnitude Detected</dataType>"
        f"<bitsPerSample dataStream='Magnitude'>16</bitsPerSample><numberOfSamplesPerLine>{W}</numberOfSamplesPerLine>"
        f"<numberOfLines>{H}</numberOfLines></rasterAttributes><geographicInformation><geolocationGrid>{points}"
        "</geolocationGrid><referenceEllipsoidParameters><ellipsoidName>WGS84</ellipsoidName><semiMajorAxis>6378137"
        "</semiMajorAxis><semiMinorAxis>6356752.314</semiMinorAxis></referenceEllipsoidParameters>"
        '</geographicInformation><fullResolutionImageData pole="HH">imagery_HH.tif</fullResolutionImageData>'
        '<fullResolutionImageData pole="HV">imagery_HV.tif</fullResolutionImageData></imageAttributes></product>'
    )
    return folder


@pytest.mark.parametrize(("name", "dtype"), [("S01/SBI", ">i2"), ("S01/IMG", "float32")])
def test_cosmo_keeps_complex_samples_along_a_third_axis(name: str, dtype: str, tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "CSKS1_SCS.h5", "w") as file:
        file[name] = np.stack([COMPLEX.real, COMPLEX.imag], axis=-1).astype(dtype)
        file["S01/QLK"] = RNG.integers(0, 255, (H // 4, W // 4)).astype(np.uint8)
    for given in (tmp_path / "CSKS1_SCS.h5", f"{tmp_path / 'CSKS1_SCS.h5'}:/{name}"):
        np.testing.assert_array_equal(as_image(given).pixels, COMPLEX)
        part = open_source(given).read(Window(5, 7, 30, 20))
        np.testing.assert_array_equal(part.pixels, COMPLEX[7:27, 5:35])


def test_envisat_is_named_with_what_to_run(tmp_path: Path) -> None:
    path = tmp_path / "ASA_IMP_1P.N1"
    path.write_bytes(b'PRODUCT="ASA_IMP_1P.N1"\nPROC_STAGE=N\n'.ljust(2000))
    with pytest.raises(InputError, match=r"is a product in Envisat's format.*gdal_translate .*ASA_IMP_1P\.N1 .*\.tif"):
        as_image(path)


def terrasar(folder: Path) -> Path:
    """One burst: 4 lines of annotation, then lines of first and last valid sample and pairs of 16-bit numbers."""
    words = np.zeros((H + 4, W + 2), ">u4")
    words[0, :9] = 4 * (W + 2) * (H + 4), 1, W, H, 1, 4 * (W + 2), H + 4, int.from_bytes(b"CSAR", "big"), 1
    words[4:, 0], words[4:, 1] = 1, W
    pairs = words.view(">i2").reshape(H + 4, W + 2, 2)
    pairs[4:, 2:, 0], pairs[4:, 2:, 1] = COMPLEX.real, COMPLEX.imag
    root = folder / "TSX1_SAR__SSC"
    (root / "IMAGEDATA").mkdir(parents=True)
    (root / "IMAGEDATA" / "IMAGE_HH_SRA.cos").write_bytes(words.tobytes())
    (root / "TSX1_SAR__SSC.xml").write_text(
        "<level1Product><productInfo><missionInfo><mission>TSX-1</mission></missionInfo><productVariantInfo>"
        "<productType>SSC</productType><productVariant>SSC</productVariant></productVariantInfo><imageDataInfo>"
        "<imageDataType>COMPLEX</imageDataType><imageDataFormat>COSAR</imageDataFormat><imageDataDepth>16"
        f"</imageDataDepth><imageRaster><numberOfRows>{H}</numberOfRows><numberOfColumns>{W}</numberOfColumns>"
        "</imageRaster></imageDataInfo></productInfo><productComponents><imageData layerIndex='1'><polLayer>HH"
        "</polLayer><file><location><path>IMAGEDATA</path><filename>IMAGE_HH_SRA.cos</filename></location></file>"
        "</imageData></productComponents></level1Product>"
    )
    return root


@pytest.mark.parametrize("name", ["", "product.xml"])
def test_radarsat_2(name: str, tmp_path: Path) -> None:
    folder = radarsat(tmp_path)
    image = as_image(folder / name, band="HV")
    np.testing.assert_array_equal(image.pixels, AMPLITUDE * 2)
    part = open_source(folder / name, band="HV").read(Window(9, 8, 30, 20))
    np.testing.assert_array_equal(part.pixels, AMPLITUDE[8:28, 9:39] * 2)
    assert image.geolocation is not None
    assert image.geolocation.gcps is not None
    np.testing.assert_allclose(image.geolocation.gcps[3, 2:], [-75 + W * 1e-4, 45 - H * 1e-4, 10])
    (tmp_path / "in").mkdir()
    header = (tmp_path / "product.xml").read_text().replace("imagery_", "../imagery_")
    (tmp_path / "in" / "product.xml").write_text(header)
    for given in (tmp_path / "in" / "product.xml", tmp_path / "in"):
        with pytest.raises(InputError, match="reaches outside its folder"):
            as_image(given)
    with pytest.raises(InputError, match="reaches outside its folder"):
        as_image(f"RADARSAT_2_CALIB:SIGMA0:{tmp_path}/in/product.xml", band="HV")
    (tmp_path / "in" / "product.xml").unlink()
    with pytest.raises(InputError, match=r"has 2 bands.*1 'HH' .*2 'HV'"):
        as_image(folder)


def test_radarsat_2_as_gdal_calibrates_it(tmp_path: Path) -> None:
    header = radarsat(tmp_path) / "product.xml"
    named = '<lookupTable incidenceAngleCorrection="Sigma Nought">lutSigma.xml</lookupTable>'
    text, image = header.read_text(), '<fullResolutionImageData pole="HH">'
    header.write_text(text.replace(image, named + image))
    gains = np.linspace(2.0, 5.0, W)
    table = f"<lut><offset>7.0</offset><gains>{' '.join(map(str, gains))}</gains></lut>"
    (tmp_path / "lutSigma.xml").write_text(table)
    source = f"RADARSAT_2_CALIB:SIGMA0:{header}"
    found = as_image(source, band="HH")
    assert found.scale == "intensity"
    np.testing.assert_allclose(found.pixels**2, (AMPLITUDE.astype(np.float64) ** 2 + 7) / gains, rtol=1e-5)
    plain = as_image(f"RADARSAT_2_CALIB:UNCALIB:{header}", band="HH")
    np.testing.assert_array_equal(plain.pixels, AMPLITUDE)
    with pytest.raises(InputError, match="unknown quantity 'SIGMA', did you mean 'SIGMA0'"):
        as_image(f"RADARSAT_2_CALIB:SIGMA:{header}", band="HH")
    # GDAL reads beyond a short table and ends the process without one.
    (tmp_path / "lutSigma.xml").write_text(table.replace("2.0 ", "", 1))
    with pytest.raises(InputError, match=r"no whole table to calibrate by 'sigma nought' .*does not hold 90 gains"):
        as_image(source, band="HH")
    (tmp_path / "lutSigma.xml").unlink()
    with pytest.raises(InputError, match="No such file"):
        as_image(source, band="HH")
    with pytest.raises(InputError, match=r"'beta nought' .the header names none"):
        as_image(f"RADARSAT_2_CALIB:BETA0:{header}", band="HH")
    header.write_text(text.replace(image, named.replace("lutS", "../lutS") + image))
    with pytest.raises(InputError, match="outside"):
        as_image(source, band="HH")


@pytest.mark.parametrize("name", ["", "TSX1_SAR__SSC.xml", "IMAGEDATA/IMAGE_HH_SRA.cos"])
def test_terrasar_x(name: str, tmp_path: Path) -> None:
    source = terrasar(tmp_path) / name
    np.testing.assert_array_equal(as_image(source).pixels, COMPLEX)
    part = open_source(source).read(Window(9, 8, 30, 20))
    np.testing.assert_array_equal(part.pixels, COMPLEX[8:28, 9:39])
