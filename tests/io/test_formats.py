"""Every format gives back what a public writer put into it, whole and by windows, with its geography."""

from __future__ import annotations

import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.io import as_image
from featreg.io.bands import Choice, choose, name_of
from featreg.io.raster_files import SAMPLE, scale_by_strips
from featreg.io.raster_source import RasterSource, Window, open_source
from featreg.io.reader import Band, Raster

rasterio = pytest.importorskip("rasterio")
pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

H, W = 60, 90
RNG = np.random.default_rng(5)
AMPLITUDE = (RNG.gamma(2, 30, (H, W)) + 1).astype(np.float32)
BYTES = np.clip(AMPLITUDE, 1, 250).astype(np.uint8)
COMPLEX = np.round(AMPLITUDE * np.exp(1j * RNG.uniform(0, 6, (H, W)))).astype(np.complex64)
CRS = "EPSG:32611"
TRANSFORM = (10.0, 0.0, 500000.0, 0.0, -10.0, 4200000.0)
X, Y = 500000 + 10 * (np.arange(W) + 0.5), 4200000 - 10 * (np.arange(H) + 0.5)


def write(path: Path, array: NDArray[Any], driver: str, place: bool = True, **more: Any) -> Path:
    """Write (H, W) or (B, H, W) with rasterio."""
    bands = array if array.ndim == 3 else array[None]
    names = more.pop("names", ())
    where = {"crs": CRS, "transform": rasterio.Affine(*TRANSFORM)} if place else {}
    size = {"height": bands.shape[1], "width": bands.shape[2], "count": len(bands)}
    with rasterio.open(path, "w", driver=driver, **{"dtype": bands.dtype, **size, **where, **more}) as dataset:
        dataset.write(bands)
        for number, name in enumerate(names, start=1):
            dataset.set_band_description(number, name)
    return path


def virtual(folder: Path) -> Path:
    from rasterio.shutil import copy

    copy(write(folder / "a.tif", AMPLITUDE, "GTiff"), folder / "a.vrt", driver="VRT")
    return folder / "a.vrt"


def archive(folder: Path) -> Path:
    write(folder / "a.tif", AMPLITUDE, "GTiff")
    with zipfile.ZipFile(folder / "p.zip", "w", zipfile.ZIP_DEFLATED) as file:
        file.write(folder / "a.tif", "inside/a.tif")
        file.writestr("readme.txt", "words")
    return folder / "p.zip"


def hdf5(folder: Path, data: NDArray[Any] = AMPLITUDE) -> str:
    h5py = pytest.importorskip("h5py")
    with h5py.File(folder / "a.h5", "w") as file:
        group = file.create_group("science/grids/A")
        group.create_dataset("HH", data=data, chunks=(16, 16), compression="gzip")
        group["xCoordinates"], group["yCoordinates"] = X, Y
        group["projection"] = np.int32(32611)
    return f"{folder / 'a.h5'}:/science/grids/A/HH"


def classic_netcdf(folder: Path) -> Path:
    from scipy.io import netcdf_file

    file: Any
    with netcdf_file(folder / "a.nc", "w") as file:
        for name, values in (("y", Y), ("x", X)):
            file.createDimension(name, len(values))
            file.createVariable(name, "d", (name,))[:] = values
        system = file.createVariable("crs", "i", ())
        system.crs_wkt = rasterio.crs.CRS.from_user_input(CRS).to_wkt()
        image = file.createVariable("amplitude", "f", ("y", "x"))
        image[:] = AMPLITUDE
        image.grid_mapping = "crs"
    return folder / "a.nc"


def netcdf4(folder: Path) -> Path:
    pytest.importorskip("h5netcdf")
    xr = pytest.importorskip("xarray")
    data = xr.DataArray(AMPLITUDE, dims=("y", "x"), coords={"y": Y, "x": X}, name="amplitude").to_dataset()
    data["spatial_ref"] = xr.DataArray(0, attrs={"crs_wkt": rasterio.crs.CRS.from_user_input(CRS).to_wkt()})
    data.amplitude.attrs["grid_mapping"] = "spatial_ref"
    data.to_netcdf(folder / "a.nc", engine="h5netcdf")
    return folder / "a.nc"


def numpy_file(folder: Path) -> Path:
    np.save(folder / "a.npy", AMPLITUDE)
    return folder / "a.npy"


def matlab(folder: Path) -> Path:
    from scipy.io import savemat

    savemat(folder / "a.mat", {"z": COMPLEX})
    return folder / "a.mat"


def new_matlab(folder: Path) -> Path:
    """As MATLAB saves with -v7.3: a user block before the HDF5, axes the other way round, complex as a pair."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(folder / "a.mat", "w", userblock_size=512) as file:
        pair = np.empty((W, H), [("real", "f8"), ("imag", "f8")])
        pair["real"], pair["imag"] = COMPLEX.real.T, COMPLEX.imag.T
        file["z"] = pair
        file["z"].attrs["MATLAB_class"] = np.bytes_("double")
    with (folder / "a.mat").open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    return folder / "a.mat"


def safe(folder: Path) -> Path:
    from rasterio.control import GroundControlPoint

    root = folder / "S1A_IW_GRDH_1SDV_x.SAFE"
    (root / "measurement").mkdir(parents=True)
    gcps = [GroundControlPoint(r, c, -118 + c * 1e-4, 34 - r * 1e-4, 12.0) for r in (0, H) for c in (0, W // 2, W)]
    objects = ""
    for pol, gain in (("vv", 1), ("vh", 2)):
        name = f"measurement/s1a-iw-grd-{pol}-20200101t000000-20200101t000025-030000-036fd5-001.tiff"
        write(root / name, (AMPLITUDE * gain).astype(np.uint16), "GTiff", False, crs="EPSG:4326", gcps=gcps)
        objects += f'<dataObject><byteStream><fileLocation href="./{name}"/></byteStream></dataObject>'
    (root / "manifest.safe").write_text(f"<XFDU><dataObjectSection>{objects}</dataObjectSection></XFDU>")
    return root


TILES: dict[str, Any] = {"tiled": True, "blockxsize": 16, "blockysize": 16}
Made = tuple[Any, dict[str, Any], NDArray[Any]]
#: Format -> what a folder is given: the source, how it is read, and what must come out.
FORMATS: dict[str, Callable[[Path], Made]] = {
    "GTiff": lambda d: (write(d / "a.tif", AMPLITUDE, "GTiff", **TILES), {}, AMPLITUDE),
    "COG": lambda d: (write(d / "a.tif", AMPLITUDE, "COG"), {}, AMPLITUDE),
    "VRT": lambda d: (virtual(d), {}, AMPLITUDE),
    "ENVI": lambda d: (write(d / "a.dat", AMPLITUDE, "ENVI"), {}, AMPLITUDE),
    "ENVI complex": lambda d: (write(d / "a.slc", COMPLEX, "ENVI"), {}, COMPLEX),
    "ISCE": lambda d: (write(d / "a.slc", COMPLEX, "ISCE", False), {}, COMPLEX),
    "ROI_PAC": lambda d: (write(d / "a.slc", COMPLEX, "ROI_PAC"), {}, COMPLEX),
    "HFA": lambda d: (write(d / "a.img", AMPLITUDE, "HFA"), {}, AMPLITUDE),
    "ERS": lambda d: (write(d / "a.ers", AMPLITUDE, "ERS"), {}, AMPLITUDE),
    "EHdr": lambda d: (write(d / "a.bil", AMPLITUDE, "EHdr"), {}, AMPLITUDE),
    "PCIDSK": lambda d: (write(d / "a.pix", AMPLITUDE, "PCIDSK"), {}, AMPLITUDE),
    "JP2": lambda d: (write(d / "a.jp2", BYTES, "JP2OpenJPEG", QUALITY="100", REVERSIBLE="YES"), {}, BYTES),
    "NITF": lambda d: (write(d / "a.ntf", BYTES, "NITF", False), {}, BYTES),
    "PNG": lambda d: (write(d / "a.png", BYTES, "PNG", False), {}, BYTES),
    "BMP": lambda d: (write(d / "a.bmp", BYTES, "BMP", False), {}, BYTES),
    "JPEG": lambda d: (write(d / "a.jpg", BYTES * 0 + np.arange(W, dtype=np.uint8), "JPEG", False, QUALITY=100), {},
                       np.broadcast_to(np.arange(W), (H, W))),
    "NPY": lambda d: (numpy_file(d), {}, AMPLITUDE),
    "MATLAB": lambda d: (matlab(d), {}, COMPLEX),
    "MATLAB 7.3": lambda d: (new_matlab(d), {}, COMPLEX),
    "HDF5": lambda d: (hdf5(d), {}, AMPLITUDE),
    "HDF5 complex": lambda d: (hdf5(d, COMPLEX).partition(":")[0], {"band": "HH"}, COMPLEX),
    "netCDF": lambda d: (netcdf4(d), {"band": "amplitude"}, AMPLITUDE),
    "netCDF classic": lambda d: (classic_netcdf(d), {}, AMPLITUDE),
    "GIF": lambda d: (write(d / "a.gif", BYTES, "GIF"), {}, BYTES),
    "PNM": lambda d: (write(d / "a.pgm", BYTES, "PNM", False), {}, BYTES),
    "RMF": lambda d: (write(d / "a.mtw", AMPLITUDE.astype("f8"), "RMF", MTW="ON"), {}, AMPLITUDE),
    "AAIGrid": lambda d: (write(d / "a.asc", BYTES.astype("i4"), "AAIGrid"), {}, BYTES),
    "RST": lambda d: (write(d / "a.rst", AMPLITUDE, "RST"), {}, AMPLITUDE),
    "SAGA": lambda d: (write(d / "a.sdat", AMPLITUDE, "SAGA"), {}, AMPLITUDE),
    "RRASTER": lambda d: (write(d / "a.grd", AMPLITUDE, "RRASTER"), {}, AMPLITUDE),
    "GSBG": lambda d: (write(d / "a.grd", AMPLITUDE, "GSBG"), {}, AMPLITUDE),
    "VICAR": lambda d: (write(d / "a.vic", AMPLITUDE, "VICAR", False), {}, AMPLITUDE),
    "ISIS3": lambda d: (write(d / "a.cub", AMPLITUDE, "ISIS3"), {}, AMPLITUDE),
    "PDS4": lambda d: (write(d / "a.xml", AMPLITUDE, "PDS4", False), {}, AMPLITUDE),
    "PAux": lambda d: (write(d / "a.raw", AMPLITUDE, "PAux"), {}, AMPLITUDE),
    "LAN": lambda d: (write(d / "a.lan", BYTES, "LAN"), {}, BYTES),
    "MFF": lambda d: (write(d / "a.hdr", BYTES, "MFF", False), {}, BYTES),
    "ZIP": lambda d: (archive(d), {}, AMPLITUDE),
    "/vsizip": lambda d: (f"/vsizip/{archive(d)}/inside/a.tif", {}, AMPLITUDE),
    "SAFE": lambda d: (safe(d), {"band": "vh"}, (AMPLITUDE * 2).astype(np.uint16)),
    "I and Q": lambda d: (write(d / "a.tif", np.stack([COMPLEX.real, COMPLEX.imag]), "GTiff"), {"band": "iq"}, COMPLEX),
    "bands": lambda d: (write(d / "a.tif", np.stack([BYTES, AMPLITUDE]).astype("f4"), "GTiff", names=["VV", "VH"]),
                        {"band": "VH"}, AMPLITUDE),
}  # fmt: skip
#: Those that cannot say where they lie, or that say it in a header that is not written here.
NOWHERE = ("ISCE", "NITF", "PNG", "BMP", "JPEG", "NPY", "MATLAB", "MATLAB 7.3", "PNM", "VICAR", "MFF", "PDS4")
#: Those that keep the place without its coordinate system, or in other words for the same.
NO_SYSTEM = ("ROI_PAC", "RMF", "AAIGrid", "RST", "SAGA", "RRASTER", "GSBG", "ISIS3", "PAux", "LAN")


@pytest.mark.parametrize("kind", FORMATS)
def test_whole_and_windows_hold_what_was_written(kind: str, tmp_path: Path) -> None:
    source, reading, wanted = FORMATS[kind](tmp_path)
    whole = as_image(source, **reading)
    np.testing.assert_allclose(whole.pixels, wanted, rtol=1e-6, atol=2.0 if kind == "JPEG" else 0)
    assert whole.is_complex == np.iscomplexobj(wanted)
    opened = open_source(str(source), **reading)
    assert (opened.shape, opened.is_complex, opened.known_scale) == (whole.shape, whole.is_complex, whole.scale)
    part = opened.read(Window(7, 11, 40, 30))
    np.testing.assert_array_equal(part.pixels, whole.pixels[11:41, 7:47])
    np.testing.assert_array_equal(part.mask, whole.mask[11:41, 7:47])
    assert opened.overview(3).shape == (H // 3, W // 3)
    for place in (whole.geolocation, opened.geolocation):
        if kind in NOWHERE:
            assert place is None or place.transform is None
        elif kind == "SAFE":
            assert place is not None
            assert place.gcps is not None
            np.testing.assert_allclose(place.gcps[4], [W // 2 - 0.5, H - 0.5, -118 + W // 2 * 1e-4, 34 - H * 1e-4, 12])
        else:
            assert place is not None
            assert place.transform == pytest.approx(TRANSFORM)
            if kind not in NO_SYSTEM:
                assert rasterio.crs.CRS.from_wkt(place.crs) == rasterio.crs.CRS.from_user_input(CRS)
    identity = opened.identity()
    assert identity == open_source(str(source), **reading).identity()


def test_names_of_datasets_are_those_of_gdal_too(tmp_path: Path) -> None:
    file = hdf5(tmp_path).partition(":")[0]
    for name in (f'HDF5:"{file}"://science/grids/A/HH', f"HDF5:{file}://science/grids/A/HH", f"{file}:HH"):
        np.testing.assert_array_equal(as_image(name).pixels, AMPLITUDE)
    np.testing.assert_array_equal(as_image(f"NETCDF:{classic_netcdf(tmp_path)}:amplitude").pixels, AMPLITUDE)
    with pytest.raises(InputError, match="no band '/HX', known: HH"):
        as_image(f"{file}:/HX")
    with pytest.raises(InputError, match="names a dataset already"):
        as_image(f"{file}:HH", band="HV")


def test_the_suffix_decides_nothing(tmp_path: Path) -> None:
    write(tmp_path / "a.tif", BYTES, "GTiff").rename(tmp_path / "a.png")
    np.testing.assert_array_equal(as_image(tmp_path / "a.png").pixels, BYTES)
    numpy_file(tmp_path).rename(tmp_path / "a.dat")
    np.testing.assert_array_equal(as_image(tmp_path / "a.dat").pixels, AMPLITUDE)


def test_a_header_and_a_name_without_a_file_are_named(tmp_path: Path) -> None:
    write(tmp_path / "a.img", AMPLITUDE, "ENVI")
    with pytest.raises(InputError, match=r"a\.hdr: is a header; give the raster beside it"):
        as_image(tmp_path / "a.hdr")
    with pytest.raises(InputError, match="GDAL finds no such file"):
        as_image("/vsizip/nothing.zip/a.tif")


def test_samples_that_begin_like_a_bitmap_are_none(tmp_path: Path) -> None:
    raw = BYTES.copy()
    raw[0, :2] = list(b"BM")
    np.testing.assert_array_equal(as_image(write(tmp_path / "a.dat", raw, "ENVI")).pixels, raw)


def test_of_several_bands_one_must_be_named(tmp_path: Path) -> None:
    names = ["Sigma0_VV", "Gamma0_VV", "Sigma0_VH"]
    path = write(tmp_path / "a.tif", np.stack([AMPLITUDE * k for k in (1, 2, 3)]), "GTiff", names=names)
    with pytest.raises(InputError, match=r"has 3 bands, state which one as band .*1 'Sigma0_VV' .*3 'Sigma0_VH'"):
        as_image(path)
    assert as_image(path, band="vh").band == "Sigma0_VH"
    np.testing.assert_array_equal(as_image(path, band="gamma0").pixels, AMPLITUDE * 2)
    for band in (3, "3", "Sigma0_VH", "VH"):
        np.testing.assert_array_equal(as_image(path, band=band).pixels, AMPLITUDE * 3)
    with pytest.raises(InputError, match="2 bands go by 'VV', write more of the name"):
        as_image(path, band="VV")
    with pytest.raises(InputError, match="did you mean 'Sigma0_VH'"):
        as_image(path, band="Sigma0_HH")
    with pytest.raises(InputError, match="band 4 was asked for"):
        RasterSource(str(path), band=4).checked()


def test_pairs_of_i_and_q_are_told_by_their_names(tmp_path: Path) -> None:
    parts = np.stack([COMPLEX.imag, COMPLEX.real, 2 * COMPLEX.real, 2 * COMPLEX.imag]).astype(np.int16)
    path = write(tmp_path / "a.tif", parts, "GTiff", names=["q_VV", "i_VV", "i_VH", "q_VH"])
    with pytest.raises(InputError, match="or 'iq' for complex samples"):
        as_image(path)
    with pytest.raises(InputError, match="2 pairs of I and Q, write iq:NAME"):
        as_image(path, band="iq")
    image = as_image(path, band="iq:VV")
    np.testing.assert_array_equal(image.pixels, COMPLEX)
    assert image.band == "iq:vv"
    np.testing.assert_array_equal(as_image(path, band="iq:vh").pixels, 2 * COMPLEX)


def test_colours_and_palettes_become_luminance(tmp_path: Path) -> None:
    rgb = RNG.integers(0, 256, (3, H, W)).astype(np.uint8)
    wanted = np.tensordot([0.299, 0.587, 0.114], rgb.astype(float), 1)
    alpha = np.full((H, W), 255, np.uint8)
    alpha[:9] = 0
    path = write(tmp_path / "a.tif", np.stack([*rgb, alpha]), "GTiff", photometric="RGB", alpha="YES")
    for image in (as_image(path), open_source(str(path)).read(Window(0, 0, W, H))):
        np.testing.assert_array_equal(image.mask, alpha > 0)
        np.testing.assert_allclose(image.pixels[image.mask], wanted[alpha > 0], atol=0.501)
    np.testing.assert_array_equal(as_image(path, band="rgb").pixels, as_image(path).pixels)
    np.testing.assert_array_equal(as_image(path, band=2).pixels[9:], rgb[1, 9:])
    with rasterio.open(tmp_path / "p.png", "w", driver="PNG", height=H, width=W, count=1, dtype="uint8") as dataset:
        dataset.write(BYTES, 1)
        dataset.write_colormap(1, {i: (i, 255 - i, 7, 255 if i != 9 else 0) for i in range(256)})
    image = as_image(tmp_path / "p.png")
    palette = 0.299 * BYTES + 0.587 * (255.0 - BYTES) + 0.114 * 7
    np.testing.assert_array_equal(image.mask, BYTES != 9)
    np.testing.assert_allclose(image.pixels[image.mask], palette[BYTES != 9], atol=0.501)


def test_a_pair_of_parts_is_asked_for_by_what_only_it_has(tmp_path: Path) -> None:
    names = [f"{part}_IW{swath}_{name}" for swath in (1, 2) for name in ("VV", "VH") for part in "iq"]
    bands = [Band(name, (H, W), "float32") for name in names]
    for k in range(4):
        choice = Choice("iq", (2 * k, 2 * k + 1))
        asked = name_of(bands, choice)
        assert choose(bands, asked, "a") == choice
    assert name_of(bands[:4], Choice("iq", (0, 1))) == "iq:vv"
    with pytest.raises(InputError, match="has no band '²'"):
        choose(bands, "²", "a")


@pytest.mark.parametrize("dtype", ["int16", "float32"])
def test_parts_that_are_scaled_keep_their_holes(dtype: str, tmp_path: Path) -> None:
    parts = np.stack([COMPLEX.real, COMPLEX.imag]).astype(dtype)
    parts[:, :7] = -9999
    path = write(tmp_path / "a.tif", parts, "GTiff", names=["i", "q"], nodata=-9999)
    with rasterio.open(path, "r+") as dataset:
        dataset.scales, dataset.offsets = (0.001, 0.001), (0.0, 0.0)
    image = as_image(path, band="iq")
    np.testing.assert_array_equal(image.mask[:, 0], np.arange(H) >= 7)
    np.testing.assert_allclose(image.pixels[7:], COMPLEX[7:] * 0.001, rtol=1e-6)


def test_the_scale_is_told_from_no_more_than_memory_holds() -> None:
    read = []

    def of(window: Window) -> Raster:
        read.append(window.width * window.height)
        return Raster(np.ones((4, 4), np.float32), "float32")

    assert scale_by_strips((5, 10**12), of, None, lambda window: None, "a") == "amplitude"
    assert sum(read) <= 5 * SAMPLE**2


def test_a_product_that_names_files_outside_is_refused(tmp_path: Path) -> None:
    root = safe(tmp_path)
    write(tmp_path / "x.tiff", AMPLITUDE, "GTiff")
    manifest = root / "manifest.safe"
    manifest.write_text('<X><fileLocation href="measurement/../../x.tiff"/></X>')
    with pytest.raises(InputError, match="outside the product"):
        as_image(root)
    shutil.copy(tmp_path / "x.tiff", root / "measurement" / "y.tiff")
    manifest.write_text('<X><fileLocation href="measurement/y.tiff"/></X>')
    assert as_image(root).shape == AMPLITUDE.shape
    # The mask beside a measurement is opened with it.
    (root / "measurement" / "y.tiff.msk").write_text(
        f'<VRTDataset rasterXSize="{AMPLITUDE.shape[1]}" rasterYSize="{AMPLITUDE.shape[0]}"><VRTRasterBand band="1" '
        f'dataType="Byte"><SimpleSource><SourceFilename>{tmp_path / "x.tiff"}</SourceFilename></SimpleSource>'
        "</VRTRasterBand></VRTDataset>"
    )
    with pytest.raises(InputError, match="is not a file of a mask"):
        as_image(root)
    manifest.write_text('<X><fileLocation href="measurement/gone.tiff"/></X>')
    with pytest.raises(InputError, match=r"names 1 measurements, and none is there, such as 'measurement/gone.tiff'"):
        as_image(root)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="directory without a product"):
        as_image(tmp_path / "empty")


def test_a_product_with_one_polarisation_only(tmp_path: Path) -> None:
    root = safe(tmp_path)
    next((root / "measurement").glob("*-vh-*")).unlink()
    np.testing.assert_array_equal(as_image(root).pixels, AMPLITUDE.astype(np.uint16))
    with pytest.raises(InputError, match="band 'VH'"):
        as_image(root, band="VH")


def test_a_safe_product_in_an_archive(tmp_path: Path) -> None:
    root = safe(tmp_path)
    with zipfile.ZipFile(tmp_path / "s.zip", "w") as file:
        for path in root.rglob("*"):
            file.write(path, path.relative_to(tmp_path))
    np.testing.assert_array_equal(as_image(tmp_path / "s.zip", band="VV").pixels, AMPLITUDE.astype(np.uint16))
    with pytest.raises(InputError, match=r"has 2 bands.*1 'VV' .*2 'VH'"):
        as_image(tmp_path / "s.zip")


def test_an_archive_of_several_images_lists_them(tmp_path: Path) -> None:
    path = archive(tmp_path)
    with zipfile.ZipFile(path, "a") as file:
        file.write(tmp_path / "a.tif", "b.tif")
    with pytest.raises(InputError, match=r"holds 2 images, name one as .*p.zip:NAME; in it: inside/a.tif, b.tif"):
        as_image(path)
    np.testing.assert_array_equal(as_image(f"{path}:b.tif").pixels, AMPLITUDE)


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


def test_negative_intensities_are_very_dark_data(tmp_path: Path) -> None:
    noisy = (AMPLITUDE**2).astype(np.float32)
    noisy[::7, ::5] *= -0.01
    path = write(tmp_path / "a.tif", noisy, "GTiff")
    for image in (as_image(path, scale="intensity"), open_source(path, scale="intensity").read(Window(0, 0, W, H))):
        assert image.mask.all()
        np.testing.assert_allclose(image.pixels, np.sqrt(np.maximum(noisy, 0)), rtol=1e-6)


def test_linear_samples_with_negatives_are_told_from_decibels(tmp_path: Path) -> None:
    sigma0 = RNG.gamma(1.0, 0.08, (H, W)).astype(np.float32) - 0.004
    assert 0.03 < (sigma0 < 0).mean() < 0.08
    assert as_image(write(tmp_path / "a.tif", sigma0, "GTiff")).scale == "intensity"
    assert as_image(write(tmp_path / "b.tif", sigma0, "GTiff", names=["Sigma0_VV"])).scale == "intensity"
    db = (10 * np.log10(np.maximum(sigma0, 1e-4))).astype(np.float32)
    assert as_image(write(tmp_path / "c.tif", db, "GTiff")).scale == "db"
    assert as_image(write(tmp_path / "d.tif", db, "GTiff", names=["sigma0"])).scale == "db"
    bright = write(tmp_path / "e.tif", db - db.min(), "GTiff", names=["VV_dB"])
    assert as_image(bright).scale == open_source(bright).known_scale == "db"


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
