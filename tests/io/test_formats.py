"""Every format gives back what a public writer put into it, whole and by windows, with its geography."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray

from featreg.errors import InputError
from featreg.io import as_image
from featreg.io.raster_source import Window, open_source
from made.placed_rasters import AMPLITUDE, BYTES, COMPLEX, CRS, TRANSFORM, H, W, archive, safe, write

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
X, Y = 500000 + 10 * (np.arange(W) + 0.5), 4200000 - 10 * (np.arange(H) + 0.5)


def virtual(folder: Path) -> Path:
    from rasterio.shutil import copy

    copy(write(folder / "a.tif", AMPLITUDE, "GTiff"), folder / "a.vrt", driver="VRT")
    return folder / "a.vrt"


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
