"""Where the conventions of CF say a grid lies, against GDAL and pyproj: units, standard names, parameters, order."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.io import as_image
from featreg.io.cf_places import factor_of, turns, valid_ends
from featreg.io.gridded import within_range

H, W = 20, 30
SAMPLES = np.random.default_rng(1).gamma(2, 30, (H, W)).astype(np.float32)
LAMBERT = {
    "grid_mapping_name": "lambert_azimuthal_equal_area", "longitude_of_projection_origin": 10.0,
    "latitude_of_projection_origin": 52.0, "false_easting": 4321000.0, "false_northing": 3210000.0,
    "semi_major_axis": 6378137.0, "inverse_flattening": 298.257222101,
}  # fmt: skip


def grid(path: Path, axes: dict[str, tuple[Any, dict[str, Any]]], mapping: dict[str, Any] | None, **image: Any) -> Path:
    """A netCDF file with `sea` along the axes, in their order, as h5py writes one."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        shape = [len(values) for values, _ in axes.values()]
        file["sea"] = image.pop("samples", SAMPLES).reshape(shape)
        for number, (name, (values, said)) in enumerate(axes.items()):
            file[name] = np.asarray(values)
            file[name].attrs.update(said)
            file[name].make_scale(name)
            file["sea"].dims[number].attach_scale(file[name])
        if mapping is not None:
            file["grid"] = np.int32(0)
            file["grid"].attrs.update(mapping)
            file["sea"].attrs["grid_mapping"] = "grid"
        file["sea"].attrs.update(image)
    return path


def axis(first: float, step: float, count: int, unit: str, standard: str = "") -> tuple[Any, dict[str, Any]]:
    said = {"units": unit} | ({"standard_name": standard} if standard else {})
    return first + step * np.arange(count), said


def test_kilometres_and_standard_names_and_parameters(tmp_path: Path) -> None:
    pyproj = pytest.importorskip("pyproj")
    axes = {
        "yc": axis(3200.0, -0.5, H, "km", "projection_y_coordinate"),
        "xc": axis(4300.0, 0.5, W, "km", "projection_x_coordinate"),
    }
    place = as_image(grid(tmp_path / "a.nc", axes, LAMBERT)).geolocation
    assert place is not None
    assert place.transform == pytest.approx((500, 0, 4300000 - 250, 0, -500, 3200000 + 250))
    assert place.crs is not None
    ways = (pyproj.CRS.from_wkt(place.crs), pyproj.CRS.from_epsg(3035))
    ours, wanted = (pyproj.Transformer.from_crs("EPSG:4326", w, always_xy=True).transform(11.0, 50.0) for w in ways)
    assert ours == pytest.approx(wanted, abs=0.01)


def test_angles_of_a_geostationary_view_are_metres_at_its_height(tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    height = 35786023.0
    view = {
        "grid_mapping_name": "geostationary", "perspective_point_height": height, "semi_major_axis": 6378137.0,
        "semi_minor_axis": 6356752.31414, "longitude_of_projection_origin": -75.0, "sweep_angle_axis": "x",
        "latitude_of_projection_origin": 0.0,
    }  # fmt: skip
    axes = {"y": axis(0.1, -0.001, H, "rad"), "x": axis(-0.05, 0.001, W, "rad")}
    place = as_image(grid(tmp_path / "a.nc", axes, view)).geolocation
    assert place is not None
    assert place.transform == pytest.approx(tuple(v * height for v in (1e-3, 0, -0.0505, 0, -1e-3, 0.1005)))
    assert "Geostationary" in str(place.crs)
    assert factor_of("microradian", None, view) == pytest.approx(height * 1e-6)
    assert factor_of("rad", None, {}) is None


def test_units_count_against_those_of_the_coordinate_system() -> None:
    rasterio = pytest.importorskip("rasterio")
    kilometres = rasterio.crs.CRS.from_string("+proj=utm +zone=33 +datum=WGS84 +units=km").to_wkt()
    assert factor_of("km", kilometres, {}) == pytest.approx(1.0)
    assert factor_of("km", rasterio.crs.CRS.from_epsg(32633).to_wkt(), {}) == pytest.approx(1000.0)
    assert factor_of("m", None, {}) == 1.0


def test_what_lies_along_x_and_then_y_is_turned(tmp_path: Path) -> None:
    axes = {"lon": axis(10.0, 0.01, W, "degrees_east"), "lat": axis(50.0, -0.01, H, "degrees_north")}
    image = as_image(grid(tmp_path / "a.nc", axes, None, samples=SAMPLES.T))
    np.testing.assert_array_equal(image.pixels, SAMPLES)
    assert image.geolocation is not None
    assert image.geolocation.transform == pytest.approx((0.01, 0, 9.995, 0, -0.01, 50.005))


def test_longitudes_may_leap_at_the_date_line(tmp_path: Path) -> None:
    east = (179.9 + 0.01 * np.arange(W) + 180) % 360 - 180
    axes = {"lat": axis(50.0, -0.01, H, "degrees_north"), "lon": (east, {"units": "degrees_east"})}
    place = as_image(grid(tmp_path / "a.nc", axes, None)).geolocation
    assert place is not None
    assert place.transform == pytest.approx((0.01, 0, 179.895, 0, -0.01, 50.005))
    np.testing.assert_allclose(turns(np.array([359.0, 0.0, 1.0])), [359, 360, 361])


def test_longitudes_and_latitudes_of_every_pixel_are_no_choice(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    row, col = np.mgrid[:H, :W]
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["sigma0"], file["latitude"], file["longitude"] = SAMPLES, 40 - 1e-3 * row, 10 + 1e-3 * col
    image = as_image(tmp_path / "a.h5")
    np.testing.assert_array_equal(image.pixels, SAMPLES)
    assert image.band == "sigma0"
    np.testing.assert_allclose(as_image(tmp_path / "a.h5", band="latitude").pixels, 40 - 1e-3 * row, rtol=1e-6)


def test_what_netcdf_never_wrote_is_no_data(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    from scipy.io import netcdf_file

    unwritten = np.float32(9.969209968386869e36)
    samples = SAMPLES.copy()
    samples[:3] = unwritten
    with h5py.File(tmp_path / "a.nc", "w") as file:
        file.create_dataset("sea", data=samples, fillvalue=unwritten)
    made: Any
    with netcdf_file(tmp_path / "b.nc", "w") as made:
        made.createDimension("y", H)
        made.createDimension("x", W)
        made.createVariable("sea", "f", ("y", "x"))[:] = samples
    for name in ("a.nc", "b.nc"):
        np.testing.assert_array_equal(as_image(tmp_path / name).mask[:, 0], np.arange(H) >= 3)
    # In HDF5 that is no netCDF, what stands where nothing was written is a number as any other.
    with h5py.File(tmp_path / "c.h5", "w") as file:
        file.create_dataset("sea", data=np.maximum(samples, 0), fillvalue=samples[5, 5])
    assert as_image(tmp_path / "c.h5").mask[5, 5]


def test_fractions_beside_whole_samples_are_unpacked_ends() -> None:
    packed = np.zeros(1, np.int16)
    said = {"valid_min": np.float32(-0.2), "valid_max": np.float32(1.0), "scale_factor": 1e-4}
    assert valid_ends(said, packed) == pytest.approx((-2000, 10000), rel=1e-6)
    assert valid_ends(said | {"scale_factor": -1e-4}, packed) == pytest.approx((-10000, 2000), rel=1e-6)
    assert valid_ends({"valid_range": np.array([0, 9], np.int16), "scale_factor": 0.5}, packed) == (0, 9)
    assert valid_ends({"valid_max": 3.5}, packed) == (None, 3.5)


def test_unpacked_ends_below_the_offset_are_no_bytes_above_127() -> None:
    packed = np.array([[0, 100, 200, 255]], np.uint8)
    said = {"scale_factor": np.float32(0.1), "add_offset": np.float32(5), "valid_min": np.float32(0)}
    shown = within_range(packed, said, np.dtype(np.int8), unsigned=True)
    assert shown is not None
    assert shown.all()
    # Stored ends of bytes that stand as signed ones: -56 is 200.
    stored = within_range(packed, {"valid_max": np.int8(-56)}, np.dtype(np.int8), unsigned=True)
    np.testing.assert_array_equal(stored, [[True, True, True, False]])
