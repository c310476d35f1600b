"""Virtual rasters are read where they are images put together, and refused where they lead elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError
from featreg.io import as_image
from featreg.io.xml_text import DoctypeError, root_of

rasterio = pytest.importorskip("rasterio")

H, W = 60, 90
AMPLITUDE = (np.random.default_rng(5).gamma(2, 30, (H, W)) + 1).astype(np.float32)
CRS = "EPSG:32611"


def write(path: Path) -> None:
    place = {"crs": CRS, "transform": rasterio.Affine(10.0, 0.0, 500000.0, 0.0, -10.0, 4200000.0)}
    with rasterio.open(path, "w", driver="GTiff", dtype="float32", height=H, width=W, count=1, **place) as dataset:
        dataset.write(AMPLITUDE, 1)


def vrt(path: Path, source: str, extra: str = "", relative: int = 1, subclass: str = "") -> Path:
    path.write_text(
        f'<VRTDataset rasterXSize="{W}" rasterYSize="{H}"><SRS>{CRS}</SRS>'
        f"<GeoTransform>500000, 10, 0, 4200000, 0, -10</GeoTransform>"
        f'<VRTRasterBand dataType="Float32" band="1"{subclass}>{extra}<SimpleSource>'
        f'<SourceFilename relativeToVRT="{relative}">{source}</SourceFilename><SourceBand>1</SourceBand>'
        "</SimpleSource></VRTRasterBand></VRTDataset>"
    )
    return path


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"source": "../secret.tif"}, "reaches outside its folder"),
        ({"source": "/vsicurl/http://example.org/a.tif", "relative": 0}, "reaches outside its folder"),
        ({"source": "/etc/hostname", "relative": 0}, "reaches outside its folder"),
        ({"source": "wms.xml"}, "its source wms.xml"),
        ({"source": "missing.tif"}, "is not there"),
        ({"source": "a.tif", "extra": "<PixelFunctionLanguage>Python</PixelFunctionLanguage>",
          "subclass": ' subClass="VRTDerivedRasterBand"'}, "runs code"),
        ({"source": "loop.vrt"}, "rest on each other"),
    ],
)  # fmt: skip
def test_virtual_rasters_that_do_more_are_refused(change: dict[str, Any], text: str, tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for name in ("secret.tif", "in/a.tif"):
        write(tmp_path / name)
    (tmp_path / "in" / "wms.xml").write_text("<GDAL_WMS><Service name='TMS'/></GDAL_WMS>")
    vrt(tmp_path / "in" / "loop.vrt", "loop.vrt")
    path = vrt(tmp_path / "in" / "b.vrt", **change)
    with pytest.raises(InputError, match=text):
        as_image(path)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("<SourceFilename", "<sourcefilename"),
        ("<SourceFilename", '<SourceFilename xmlns="a"'),
        ("<SourceFilename", '<SourceFilename RELATIVETOVRT="0"'),
        ("<SourceFilename", '<SourceFilename relativetoVRT="0"'),
        ("<SimpleSource>", '<SimpleSource SourceFilename="SECRET">'),
        ("<VRTRasterBand", "<subClass>VRTWarpedDataset</subClass><VRTRasterBand"),
    ],
)
def test_virtual_rasters_that_gdal_reads_otherwise_are_refused(old: str, new: str, tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for name in ("secret.tif", "in/a.tif"):
        write(tmp_path / name)
    path = vrt(tmp_path / "in" / "b.vrt", "a.tif")
    as_image(path)
    text = path.read_text()
    assert old in text
    text = text.replace(old, new.replace("SECRET", str(tmp_path / "secret.tif")))
    path.write_text(text.replace("</SourceFilename>", f"</{new[1:15]}>") if new[1:15].islower() else text)
    with pytest.raises(InputError, match=r"spells '.*' oddly"):
        as_image(path)


def test_a_name_of_the_working_folder_is_none_of_the_virtual_raster(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in ("in", "here"):
        (tmp_path / folder).mkdir()
        write(tmp_path / folder / "a.tif")
    path = vrt(tmp_path / "in" / "b.vrt", "a.tif", relative=0)
    monkeypatch.chdir(tmp_path / "here")
    with pytest.raises(InputError, match="reaches outside its folder"):
        as_image(path)
    monkeypatch.chdir(tmp_path / "in")
    np.testing.assert_array_equal(as_image(path).pixels, AMPLITUDE)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_a_doctype_is_seen_in_every_encoding(encoding: str) -> None:
    text = f'<?xml version="1.0" encoding="{encoding}"?><!DOCTYPE a [<!ENTITY b "cc">]><a>&b;</a>'
    with pytest.raises(DoctypeError):
        root_of(text.encode(encoding))
    assert root_of(b"<a>c</a>").text == "c"


def test_warped_virtual_rasters_are_read(tmp_path: Path) -> None:
    from rasterio.shutil import copy
    from rasterio.vrt import WarpedVRT

    write(tmp_path / "a.tif")
    with rasterio.open(tmp_path / "a.tif") as dataset, WarpedVRT(dataset, crs="EPSG:4326", nodata=0) as warped:
        copy(warped, tmp_path / "w.vrt", driver="VRT")
        wanted, transform = warped.read(1), tuple(warped.transform)[:6]
    image = as_image(tmp_path / "w.vrt")
    np.testing.assert_array_equal(image.pixels, wanted)
    np.testing.assert_array_equal(image.mask, wanted != 0)
    assert image.geolocation is not None
    assert image.geolocation.transform == pytest.approx(transform)
    text = (tmp_path / "w.vrt").read_text()
    for old, new, said in (
        ("a.tif</SourceDataset>", "../a.tif</SourceDataset>", "reaches outside its folder"),
        ("<Transformer>", "<Transformer><RPCTransformer><DEMPath>a.tif</DEMPath></RPCTransformer>", "a 'DEMPath'"),
        ("<Transformer>", '<Transformer DEMPath="a.tif">', "spells 'DEMPath' oddly"),
        ("<Transformer>", "<Transformer><demPath>a.tif</demPath>", "spells 'demPath' oddly"),
    ):
        assert old in text
        (tmp_path / "x.vrt").write_text(text.replace(old, new))
        with pytest.raises(InputError, match=said):
            as_image(tmp_path / "x.vrt")


def test_virtual_rasters_on_bare_samples_are_read(tmp_path: Path) -> None:
    AMPLITUDE.tofile(tmp_path / "a.raw")
    text = (
        f'<VRTDataset rasterXSize="{W}" rasterYSize="{H}"><VRTRasterBand dataType="Float32" band="1" '
        'subClass="VRTRawRasterBand"><SourceFilename relativeToVRT="1">a.raw</SourceFilename>'
        f"<ImageOffset>0</ImageOffset><PixelOffset>4</PixelOffset><LineOffset>{4 * W}</LineOffset>"
        "<ByteOrder>LSB</ByteOrder></VRTRasterBand></VRTDataset>"
    )
    (tmp_path / "a.vrt").write_text(text)
    np.testing.assert_array_equal(as_image(tmp_path / "a.vrt").pixels, AMPLITUDE)
    (tmp_path / "a.vrt").write_text(text.replace("a.raw", "/etc/hostname"))
    with pytest.raises(InputError, match="reaches outside its folder"):
        as_image(tmp_path / "a.vrt")


def test_pansharpened_virtual_rasters_and_doctypes_are_refused(tmp_path: Path) -> None:
    kind = "VRTPansharpenedDataset"
    (tmp_path / "a.vrt").write_text(f'<VRTDataset rasterXSize="50" rasterYSize="50" subClass="{kind}"/>')
    with pytest.raises(InputError, match=rf"kind {kind}.*gdal_translate a.vrt a.tif"):
        as_image(tmp_path / "a.vrt")
    path = vrt(tmp_path / "b.vrt", "a.tif")
    path.write_text('<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]>' + path.read_text())
    with pytest.raises(InputError, match="DOCTYPE"):
        as_image(path)
