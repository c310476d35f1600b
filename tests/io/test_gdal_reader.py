"""What GDAL has manners of its own for: masks of single bands, palettes, blocks, headers, local coordinate systems."""

from __future__ import annotations

import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError
from featreg.geolocation import sensor_of
from featreg.io import as_image
from featreg.io.gdal_confined import within_archive, within_folder
from featreg.io.raster_source import Window, open_source
from made.rasters import write_raster

rasterio = pytest.importorskip("rasterio")
pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

H, W = 40, 50
RNG = np.random.default_rng(3)
BYTES = RNG.integers(1, 250, (H, W)).astype(np.uint8)


def test_a_mask_file_may_hold_a_mask_for_each_band(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.tif", np.stack([BYTES, BYTES[::-1]]))
    shown = np.stack([np.arange(W) >= 7, np.arange(W) < 30])[:, None].repeat(H, axis=1)
    # Without the flag that one mask holds for the whole dataset.
    with rasterio.open(
        tmp_path / "a.tif.msk", "w", driver="GTiff", dtype="uint8", height=H, width=W, count=2
    ) as dataset:
        dataset.write(shown.astype(np.uint8) * 255)
        dataset.update_tags(INTERNAL_MASK_FLAGS_1="0", INTERNAL_MASK_FLAGS_2="0")
    for band in (1, 2):
        np.testing.assert_array_equal(as_image(path, band=band).mask, shown[band - 1])
        part = open_source(str(path), band=band).read(Window(3, 4, 40, 30))
        np.testing.assert_array_equal(part.mask, shown[band - 1][4:34, 3:43])


def test_nodata_of_a_palette_is_an_entry_and_no_gray_value(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.tif", BYTES, nodata=200, photometric="palette")
    with rasterio.open(path, "r+") as dataset:
        # Entry 10 is black with value 0, entry 9 is the gray value 200.
        colours = {i: (i, i, i, 255) for i in range(256)} | {10: (0, 0, 0, 255), 9: (200, 200, 200, 255)}
        dataset.write_colormap(1, colours)
    image = as_image(path)
    np.testing.assert_array_equal(image.mask, BYTES != 200)
    assert (image.pixels[BYTES == 9] == 200).all()
    assert (image.pixels[BYTES == 10] == 0).all()


@pytest.mark.parametrize("dtype", ["uint8", "int16", "float32"])
def test_numbers_of_a_palette_that_is_not_there_stand_for_themselves(tmp_path: Path, dtype: str) -> None:
    samples = BYTES.astype(dtype)
    path = write_raster(tmp_path / "a.tif", samples)
    with rasterio.open(path, "r+") as dataset:
        dataset.colorinterp = [rasterio.enums.ColorInterp.palette]
    with rasterio.open(path) as dataset:
        assert dataset.colorinterp[0].name == "palette"
    np.testing.assert_array_equal(as_image(path).pixels, samples)
    np.testing.assert_array_equal(open_source(str(path)).read(Window(3, 4, 20, 10)).pixels, samples[4:14, 3:23])


def test_colours_of_signed_numbers_are_for_display(tmp_path: Path) -> None:
    heights = BYTES.astype(np.int16) * 7
    path = write_raster(tmp_path / "a.bil", heights, "EHdr")
    # What is not listed has no colour, and no opacity either.
    (tmp_path / "a.clr").write_text("7 255 0 0\n5000 0 0 255\n")
    with rasterio.open(path) as dataset:
        assert dataset.colorinterp[0].name == "palette"
    image = as_image(path)
    assert image.mask.all()
    np.testing.assert_array_equal(image.pixels, heights)
    with pytest.raises(InputError, match="describes an image; give the image beside it"):
        as_image(tmp_path / "a.clr")


def test_one_block_is_not_read_where_the_file_cannot_hold_it(tmp_path: Path) -> None:
    (tmp_path / "a.pgm").write_bytes(b"P5\n400000000 20\n255\n" + bytes(1000))
    with pytest.raises(InputError, match=r"states 400000000 x 1 pixels in one block \(0.4 GB\) in 1020 bytes"):
        open_source(str(tmp_path / "a.pgm"), scale="amplitude").read(Window(0, 0, 32, 32))


def test_what_is_packed_twice_is_not_unpacked(tmp_path: Path) -> None:
    size = {"height": 40_000, "width": 30_000, "count": 1, "dtype": "uint8"}
    with rasterio.open(tmp_path / "a.tif", "w", driver="GTiff", compress="deflate", sparse_ok=True, **size):
        pass
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.write(tmp_path / "a.tif", "a.tif")
    with pytest.raises(InputError, match=r"a.zip:a.tif: states 30000 x 40000 pixels \(1.2 GB\) in \d+ bytes"):
        open_source(str(tmp_path / "a.zip"), scale="amplitude")


def test_headers_of_er_mapper_begin_in_any_case_and_after_comments(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.ers", BYTES, "ERS")
    text = path.read_text()
    assert text.startswith("DatasetHeader Begin")
    for header in ("datasetheader begin" + text[19:], "# a comment\n\n  " + text):
        path.write_text(header)
        np.testing.assert_array_equal(as_image(path).pixels, BYTES)


def test_hdf5_may_begin_behind_a_block_of_the_user(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.bin", "w", userblock_size=2048) as file:
        file["amplitude"] = BYTES
    with (tmp_path / "a.bin").open("r+b") as raw:
        raw.write(b"whatever a user likes")
    np.testing.assert_array_equal(as_image(tmp_path / "a.bin").pixels, BYTES)


def test_a_local_coordinate_system_leads_nowhere_and_is_named(tmp_path: Path) -> None:
    crs = rasterio.crs.CRS.from_wkt('LOCAL_CS["site",UNIT["metre",1]]')
    path = write_raster(tmp_path / "a.tif", BYTES, crs=crs, transform=rasterio.Affine(2, 0, 5, 0, -2, 9))
    image = as_image(path)
    with pytest.raises(InputError, match="does not lead to longitude and latitude"):
        sensor_of(image.geolocation, image.shape, "a.tif")


def test_a_transform_that_was_left_in_memory_is_none(tmp_path: Path) -> None:
    from featreg.io.gdal_reader import _is_nothing

    assert _is_nothing((4.7e-310, 0.0, 4.7e-310, 6.9e-310, 5e-324, 6.9e-310))
    assert _is_nothing((1.0, 0.0, np.nan, 0.0, 1.0, 0.0))
    assert not _is_nothing((1e-9, 0.0, 5.0, 0.0, -1e-9, 5.0))
    path = write_raster(tmp_path / "a.pgm", BYTES, "PNM")
    assert as_image(path).geolocation is None


def test_measurements_of_radarsat_constellation_are_named_by_polarisation(tmp_path: Path) -> None:
    (tmp_path / "imagery").mkdir()
    objects = ""
    for name, gain in (("VV", 1), ("VH", 2)):
        write_raster(tmp_path / "imagery" / f"{name}.tif", BYTES.astype(np.uint16) * gain)
        objects += f'<dataObject><byteStream><fileLocation href="./imagery/{name}.tif"/></byteStream></dataObject>'
    (tmp_path / "manifest.safe").write_text(f"<XFDU><dataObjectSection>{objects}</dataObjectSection></XFDU>")
    np.testing.assert_array_equal(as_image(tmp_path, band="VH").pixels, 2.0 * BYTES)


def test_a_header_of_jpeg_2000_that_states_too_much_is_refused_before_it_is_decoded(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.jp2", BYTES, "JP2OpenJPEG")
    content = bytearray(path.read_bytes())
    # The heights of image and tile stand behind the mark of the size; each part would be decoded in vain.
    at = content.index(b"\xff\x4f\xff\x51") + 4
    for place in (at + 8, at + 24):
        content[place : place + 4] = (600_000).to_bytes(4, "big")
    box = content.index(b"ihdr") + 4
    content[box : box + 4] = (600_000).to_bytes(4, "big")
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"states 50 x 600000 pixels \(0.03 GB\) in \d+ bytes"):
        open_source(str(path)).read(Window(0, 0, 32, 32))


def test_tall_blocks_of_jpeg_2000_are_decoded_once(tmp_path: Path) -> None:
    tall = np.repeat(BYTES, 60, axis=0)
    path = write_raster(tmp_path / "a.jp2", tall, "JP2OpenJPEG", QUALITY="100", REVERSIBLE="YES", BLOCKYSIZE=2400)
    from featreg.io import gdal_reader
    from featreg.io.opening import open_reader

    assert not open_reader(path).whole
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gdal_reader, "CACHE_BYTES", 50_000)
        reader = open_reader(path)
        assert reader.whole
        np.testing.assert_array_equal(reader.read(0).samples, tall)


@pytest.mark.parametrize("inside", [True, False])
@pytest.mark.parametrize(
    "said", ["http://127.0.0.1:9/a.tif", "/vsicurl/http://127.0.0.1:9/a.tif", ":::BASE:::../a.tif"]
)
def test_overviews_elsewhere_are_refused_before_anyone_looks_for_them(tmp_path: Path, said: str, inside: bool) -> None:
    path = write_raster(tmp_path / "a.tif", BYTES)
    if inside:
        with rasterio.open(path, "r+") as dataset:
            dataset.update_tags(ns="OVERVIEWS", OVERVIEW_FILE=said)
    else:
        entry = f'<Metadata domain="OVERVIEWS"><MDI key="OVERVIEW_FILE">{said}</MDI></Metadata>'
        Path(f"{path}.aux.xml").write_text(f"<PAMDataset>{entry}</PAMDataset>")
    with pytest.raises(InputError, match="names overviews elsewhere"):
        as_image(path)


def virtual(source: str, relative: int = 0) -> str:
    named = f'<SourceFilename relativeToVRT="{relative}">{source}</SourceFilename><SourceBand>1</SourceBand>'
    band = f'<VRTRasterBand dataType="Byte" band="1"><SimpleSource>{named}</SimpleSource></VRTRasterBand>'
    return f'<VRTDataset rasterXSize="{W}" rasterYSize="{H}">{band}</VRTDataset>'


@pytest.mark.parametrize(
    ("suffix", "kind"),
    [(".ovr", "overviews"), (".msk", "a mask"), (".Ovr", "overviews"), (".mSK", "a mask"), (".msk.ovr", "overviews")],
)
@pytest.mark.parametrize("archived", [False, True])
def test_a_virtual_raster_is_no_file_of_overviews_and_no_mask(
    tmp_path: Path, suffix: str, kind: str, archived: bool
) -> None:
    path = write_raster(tmp_path / "a.tif", BYTES)
    Path(f"{path}{suffix}").write_text(virtual("http://127.0.0.1:9/a.tif"))
    if archived:
        with zipfile.ZipFile(tmp_path / "all.zip", "w") as archive:
            for name in ("a.tif", f"a.tif{suffix}"):
                archive.write(tmp_path / name, name)
        path = tmp_path / "all.zip"
    with pytest.raises(InputError, match=rf"a\.tif\{suffix}: is not a file of {kind} as its name says"):
        as_image(path)


def test_overviews_beside_an_image_change_nothing(tmp_path: Path) -> None:
    path = write_raster(tmp_path / "a.tif", BYTES)
    with rasterio.Env(TIFF_USE_OVR=True), rasterio.open(path, "r+") as dataset:
        dataset.build_overviews([2])
    assert Path(f"{path}.ovr").is_file()
    np.testing.assert_array_equal(as_image(path).pixels, BYTES)


def test_a_header_among_the_sources_of_a_virtual_raster_names_no_file_elsewhere(tmp_path: Path) -> None:
    home = tmp_path / "home"
    home.mkdir()
    (tmp_path / "secret.raw").write_bytes(BYTES.tobytes())
    size = f"NrOfLines = {H}\nNrOfCellsPerLine = {W}\nNrOfBands = 1\n"
    for name in ("../secret.raw", "known.raw"):
        (home / "known.raw").write_bytes(BYTES.tobytes())
        (home / "a.ers").write_text(
            f'DatasetHeader Begin\nVersion = "6.0"\nDataFile = "{name}"\nDataSetType = ERStorage\nDataType = Raster\n'
            f"ByteOrder = LSBFirst\nRasterInfo Begin\nCellType = Unsigned8BitInteger\n{size}RasterInfo End\n"
            "DatasetHeader End\n"
        )
        (home / "a.vrt").write_text(virtual("a.ers", 1))
        if name == "known.raw":
            np.testing.assert_array_equal(as_image(home / "a.vrt").pixels, BYTES)
        else:
            with pytest.raises(InputError, match="reaches outside its folder"):
                as_image(home / "a.vrt")


def test_a_virtual_raster_written_out_in_another_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "a.vrt").write_text(virtual("\n  &lt;VRTDataset&gt;\n  &lt;/VRTDataset&gt;"))
    with pytest.raises(InputError, match="reaches outside its folder") as caught:
        as_image(tmp_path / "a.vrt")
    assert "\n" not in str(caught.value)


def test_a_header_inside_an_archive_leads_nowhere_else() -> None:
    reader: Any = SimpleNamespace(reached=["/vsizip/{a.zip}/b.pix", "/tmp/secret"], close=lambda: None)
    with pytest.raises(InputError, match="reaches outside the archive"):
        within_archive("a.zip", reader)
    reader.reached = reader.reached[:1]
    assert within_archive("a.zip", reader) is reader
    with pytest.raises(InputError, match="reaches outside its folder"):
        within_folder(Path("a.pix"), reader)
