"""Products of CEOS that the test writes, record by record: ALOS PALSAR, and what GDAL reads of ERS and RADARSAT-1."""

from __future__ import annotations

import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.cli.info import describe
from featreg.errors import InputError
from featreg.geolocation import sensor_of
from featreg.io import as_image
from featreg.io.raster_source import Window, open_source

H, W = 30, 44
RNG = np.random.default_rng(0)
DETECTED = RNG.integers(1, 65_535, (2, H, W)).astype(np.uint16)
COMPLEX = RNG.normal(size=(2, H, W, 2)).astype(np.float32).view(np.complex64)[..., 0]
#: Latitude and longitude of the four corners, clockwise from the top left.
CORNERS = np.array([[35.70, 139.50], [35.72, 139.58], [35.66, 139.60], [35.64, 139.52]])


def descriptor(samples: Any, before: int, record: int, kind: str) -> bytearray:
    head = bytearray(b" " * 720)
    head[:12] = struct.pack(">I4BI", 1, 50, 192, 18, 18, 720)
    numbers = {180: (6, H), 186: (6, record), 236: (8, H), 248: (8, W), 276: (4, before), 280: (8, record - before)}
    for at, (width, value) in numbers.items():
        head[at : at + width] = str(value).rjust(width).encode()
    head[428:432] = kind.ljust(4).encode()
    return head


def product(folder: Path, samples: Any, name: str, *, corners: Any = CORNERS) -> Path:
    """Write a product of the polarisations HH and HV; its volume's path."""
    folder.mkdir(exist_ok=True)
    (folder / f"VOL-{name}").write_bytes(struct.pack(">I4BI", 1, 192, 192, 18, 18, 360).ljust(720))
    before = 412 if np.iscomplexobj(samples) else 192
    raw = samples.astype(">c8" if np.iscomplexobj(samples) else ">u2")
    for polarisation, image in zip(("HH", "HV"), raw, strict=True):
        record = before + image[0].nbytes
        head = descriptor(image, before, record, "C*8" if np.iscomplexobj(samples) else "IU2")
        start = [struct.pack(">I4BI", k + 2, 50, 11, 18, 20, record).ljust(before) for k in range(H)]
        lines = b"".join(first + row.tobytes() for first, row in zip(start, image, strict=True))
        (folder / f"IMG-{polarisation}-{name}").write_bytes(bytes(head) + lines)
    leader = bytearray(b" " * (720 + 4096 + 1620))
    if corners is not None:
        leader[4816:4828] = struct.pack(">I4BI", 3, 18, 20, 18, 20, 1620)
        text = "".join(f"{value:16.7f}" for value in corners.ravel())
        leader[4816 + 1072 : 4816 + 1072 + 128] = text.encode()
    (folder / f"LED-{name}").write_bytes(bytes(leader))
    return folder / f"VOL-{name}"


@pytest.mark.parametrize("name", ["ALPSRP123450700-H1.5_UA", "ALOS2015976960-140909-FBDR1.5GUA"])
@pytest.mark.parametrize("samples", [DETECTED, COMPLEX], ids=["1.5", "1.1"])
def test_rows_are_those_that_were_written(samples: Any, name: str, tmp_path: Path) -> None:
    volume = product(tmp_path / "a", samples, name)
    for given in (tmp_path / "a", volume):
        assert [band["name"] for band in describe(str(given))["bands"]] == ["HH", "HV"]
        for k, band in enumerate(("HH", "HV")):
            image = as_image(given, band=band)
            np.testing.assert_array_equal(image.pixels, samples[k].astype(image.pixels.dtype))
            part = open_source(given, band=band).read(Window(7, 3, 20, 18))
            np.testing.assert_array_equal(part.pixels, samples[k, 3:21, 7:27])
    np.testing.assert_array_equal(as_image(tmp_path / "a" / f"IMG-HV-{name}").pixels, samples[1])


def test_corners_of_level_15_locate_it(tmp_path: Path) -> None:
    image = as_image(product(tmp_path / "a", DETECTED, "ALPSRP123450700-H1.5_UA"), band="HH")
    sensor = sensor_of(image.geolocation, image.shape, "a")
    xy = np.array([[0, 0], [W - 1, 0], [W - 1, H - 1], [0, H - 1]], np.float64)
    np.testing.assert_allclose(sensor.image_to_ground(xy, 0.0)[:, ::-1], CORNERS, atol=2e-4)
    middle = sensor.image_to_ground(xy.mean(axis=0)[None], 0.0)[0, ::-1]
    np.testing.assert_allclose(middle, CORNERS.mean(axis=0), atol=2e-4)
    assert as_image(product(tmp_path / "b", DETECTED, "ALPSRP1-H1.5_UA", corners=None), band="HH").geolocation is None
    wild = np.full((4, 2), 500.0)
    assert as_image(product(tmp_path / "c", DETECTED, "ALPSRP1-H1.5_UA", corners=wild), band="HH").geolocation is None


def test_beams_of_scansar_are_bands(tmp_path: Path) -> None:
    product(tmp_path, DETECTED, "ALOS2015976960-140909-WBDR1.1__D")
    # What other programs write beside images is none.
    (tmp_path / "IMG-HH-ALOS2015976960-140909-WBDR1.1__D-F1.aux.xml").write_text("<PAMDataset/>")
    for beam in (1, 2):
        for polarisation in ("HH", "HV"):
            source = tmp_path / f"IMG-{polarisation}-ALOS2015976960-140909-WBDR1.1__D"
            source.with_name(f"{source.name}-F{beam}").write_bytes(source.read_bytes())
    for polarisation in ("HH", "HV"):
        (tmp_path / f"IMG-{polarisation}-ALOS2015976960-140909-WBDR1.1__D").unlink()
    assert [band["name"] for band in describe(str(tmp_path))["bands"]] == ["HH F1", "HH F2", "HV F1", "HV F2"]
    np.testing.assert_array_equal(as_image(tmp_path, band="HV F2").pixels, DETECTED[1])


def test_what_cannot_be_read_is_named(tmp_path: Path) -> None:
    volume = product(tmp_path / "a", DETECTED, "ALPSRP123450700-H1.5_UA")
    image = tmp_path / "a" / "IMG-HH-ALPSRP123450700-H1.5_UA"
    whole = image.read_bytes()
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        for file in sorted((tmp_path / "a").iterdir()):
            archive.write(file, file.name)
    cases = (
        (tmp_path / "a.zip", whole, "which is read unpacked"),
        (volume, whole[:-1], r"is cut short: 30 records of 280 bytes need 9120 bytes, it has 9119"),
        (volume, whole.replace(b"IU2 ", b"CI*2"), r"kind 'CI\*2'.*raw data \(level 1.0\) must be focused"),
        (volume, whole[:186] + b"    90" + whole[192:], "contradicts itself"),
        (volume, whole[:236] + b"    many" + whole[244:], "descriptor is broken"),
        (volume, b"\0" * 4000, "first record is not the descriptor"),
    )
    for given, content, text in cases:
        image.write_bytes(content)
        with pytest.raises(InputError, match=text):
            as_image(given, band="HH")
    for file in (tmp_path / "a").glob("IMG-*"):
        file.unlink()
    with pytest.raises(InputError, match=r"has no image beside it, IMG-HH-ALPSRP123450700-H1\.5_UA"):
        as_image(volume)


@pytest.mark.parametrize(
    ("kind", "dtype", "bits", "group"), [("IU1", "u1", 8, 1), ("IU2", ">u2", 16, 1), ("CIS4", ">i2", 16, 2)]
)
def test_ers_is_read_from_its_folder(kind: str, dtype: str, bits: int, group: int, tmp_path: Path) -> None:
    samples = np.random.default_rng(1).integers(1, 120, (H, group * W)).astype(dtype)
    before, data = 192, samples[0].nbytes
    head = descriptor(samples, before, before + data, kind)
    head[4] = 63
    more = {216: (4, bits), 220: (4, group), 224: (4, group * bits // 8), 232: (4, 1), 272: (2, 1), 274: (2, 1)}
    for at, (width, value) in (more | {244: (4, 0), 256: (4, 0), 260: (4, 0), 264: (4, 0), 288: (4, 0)}).items():
        head[at : at + width] = str(value).rjust(width).encode()
    head[268:272] = b"BSQ "
    start = [struct.pack(">I4BI", k + 2, 50, 11, 18, 20, before + data).ljust(before, b"\0") for k in range(H)]
    lines = b"".join(first + row.tobytes() for first, row in zip(start, samples, strict=True))
    (tmp_path / "DAT_01.001").write_bytes(bytes(head) + lines)
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.write(tmp_path / "DAT_01.001", "SAR_IMP_1PXESA.E1/DAT_01.001")
    wanted = samples.astype(np.float32)
    wanted = wanted[:, ::2] + 1j * wanted[:, 1::2] if group == 2 else wanted
    for given in (tmp_path / "DAT_01.001", tmp_path / "a.zip"):
        image = as_image(given)
        np.testing.assert_array_equal(image.pixels, wanted)
        np.testing.assert_array_equal(open_source(given).read(Window(7, 3, 20, 18)).pixels, wanted[3:21, 7:27])
