"""Headers that say what is not so, or what cannot be read here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio

from featreg.errors import InputError
from featreg.io import as_image
from featreg.io.raster_source import Window, open_source
from made.placed_rasters import BYTES, write

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


def test_samples_that_begin_like_a_bitmap_are_none(tmp_path: Path) -> None:
    raw = BYTES.copy()
    raw[0, :2] = list(b"BM")
    np.testing.assert_array_equal(as_image(write(tmp_path / "a.dat", raw, "ENVI")).pixels, raw)


def test_a_header_that_states_more_than_its_bytes_hold(tmp_path: Path) -> None:
    profile = {"driver": "GTiff", "height": 40_000, "width": 40_000, "count": 1, "dtype": "uint16", "tiled": True}
    with rasterio.open(tmp_path / "a.tif", "w", sparse_ok=True, **profile):
        pass
    with pytest.raises(InputError, match=r"states 40000 x 40000 pixels \(3.2 GB\)"):
        as_image(tmp_path / "a.tif")
    assert open_source(tmp_path / "a.tif").read(Window(20_000, 20_000, 600, 600)).shape == (600, 600)


def test_rpc_that_cannot_be_read_are_named_and_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write(tmp_path / "a.tif", BYTES, "GTiff")
    names = [f"{axis}_{part}_COEFF" for axis in ("LINE", "SAMP") for part in ("NUM", "DEN")]
    held = dict.fromkeys(names, " ".join(["1"] * 20))
    held |= {f"{n}_{w}": "1" for n in ("LINE", "SAMP", "LAT", "LONG", "HEIGHT") for w in ("OFF", "SCALE")}
    held["LINE_OFF"] = "no number"
    items = "".join(f'<MDI key="{key}">{value}</MDI>' for key, value in held.items())
    (tmp_path / "a.tif.aux.xml").write_text(f'<PAMDataset><Metadata domain="RPC">{items}</Metadata></PAMDataset>')
    image = as_image(path)
    assert "RPC coefficients cannot be read" in caplog.text
    assert image.geolocation is not None
    assert image.geolocation.rpcs is None


def test_a_codec_that_is_not_built_in_is_named(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", BYTES, "GTiff", compress="lzw")
    content = path.read_bytes()
    # Tag 259, a short, once; 34712 is a JPEG 2000 codec of Leadtools that no build of GDAL has.
    at = content.index(b"\x03\x01\x03\x00\x01\x00\x00\x00")
    path.write_bytes(content[: at + 8] + (34712).to_bytes(2, "little") + content[at + 10 :])
    with pytest.raises(InputError, match=r"compressed in a way that the library installed here cannot read"):
        as_image(path)


@pytest.mark.parametrize(
    ("standard", "text"),
    [("urn:SICD:0.5.0", r"is a SICD of version 0.5.0, and 1.1.0, .* are read"), ("urn:SIDD:3.0.0", "")],
)
def test_standards_of_nitf_are_named(standard: str, text: str, tmp_path: Path) -> None:
    pytest.importorskip("sarkit")
    path = write(tmp_path / "a.ntf", BYTES, "NITF", False)
    with path.open("ab") as file:
        file.write(f'<X xmlns="{standard}"/>'.encode())
    if text:
        with pytest.raises(InputError, match=text):
            as_image(path)
    else:
        np.testing.assert_array_equal(as_image(path).pixels, BYTES)
