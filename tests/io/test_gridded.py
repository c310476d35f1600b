"""Images in HDF5 and netCDF: packed, with places for every pixel, and linked to other files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from featreg.errors import InputError
from featreg.io import as_image
from featreg.io.raster_source import Window, open_source

pytest.importorskip("rasterio")

H, W = 60, 90
AMPLITUDE = (np.random.default_rng(5).gamma(2, 30, (H, W)) + 1).astype(np.float32)
BYTES = np.clip(AMPLITUDE, 1, 250).astype(np.uint8)


def test_an_hdf5_file_does_not_lead_to_others(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["science/grids/A/HH"] = AMPLITUDE
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file["link"] = h5py.ExternalLink("a.h5", "/science/grids/A/HH")
        file.create_dataset("raw", (H, W), "f4", external=[(str(tmp_path / "a.h5"), 0, 4 * H * W)])
        layout = h5py.VirtualLayout((H, W), "f4")
        layout[:] = h5py.VirtualSource(str(tmp_path / "a.h5"), "/science/grids/A/HH", (H, W))
        file.create_virtual_dataset("virtual", layout)
        file["table"] = np.ones(9)
    for name in ("link", "raw", "virtual"):
        with pytest.raises(InputError, match="holds no image"):
            as_image(f"{tmp_path / 'b.h5'}:/{name}")


def test_longitudes_and_latitudes_of_every_pixel_become_control_points(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    row, col = np.mgrid[:H, :W]
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["amplitude"], file["lat"], file["lon"] = AMPLITUDE, 40 - 1e-4 * row, 10 + 1e-4 * col
    place = as_image(f"{tmp_path / 'a.h5'}:amplitude").geolocation
    assert place is not None
    assert place.gcps is not None
    np.testing.assert_allclose(place.gcps[:, 2:4], [10, 40] + place.gcps[:, :2] * [1e-4, -1e-4], atol=1e-9)


def test_packed_values_of_netcdf_are_unpacked(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        packed = np.round(AMPLITUDE * 10).astype(np.int16)
        packed[:5] = -1
        file["a"] = packed
        file["a"].attrs.update({"scale_factor": 0.1, "add_offset": 2.0, "_FillValue": np.int16(-1)})
    image = as_image(tmp_path / "a.h5")
    np.testing.assert_array_equal(image.mask[:, 0], np.arange(H) >= 5)
    np.testing.assert_allclose(image.pixels[5:], packed[5:] * 0.1 + 2, rtol=1e-6)


def test_unsigned_numbers_of_classic_netcdf(tmp_path: Path) -> None:
    from scipy.io import netcdf_file

    file: Any
    with netcdf_file(tmp_path / "a.nc", "w") as file:
        file.createDimension("y", H)
        file.createDimension("x", W)
        band = file.createVariable("Band1", "b", ("y", "x"))
        band[:] = np.where(np.arange(H)[:, None] < 7, 255, BYTES).astype(np.uint8).view(np.int8)
        band._Unsigned = "true"
        band._FillValue = np.int8(-1)
    image = as_image(tmp_path / "a.nc")
    assert image.source_dtype == "uint8"
    np.testing.assert_array_equal(image.mask[:, 0], np.arange(H) >= 7)
    np.testing.assert_array_equal(image.pixels[7:], BYTES[7:])


def test_missing_values_and_valid_ranges_of_netcdf(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    rng = np.random.default_rng(0)
    samples = rng.integers(1, 200, (32, 40)).astype(np.int16)
    samples[0, :4] = -9, -8, 5000, -7
    cases = (
        ({"missing_value": np.array([-9, -8], np.int16)}, {0, 1}),
        ({"missing_value": np.int16(-9), "_FillValue": np.int16(-8)}, {0, 1}),
        ({"valid_range": np.array([0, 1000], np.int16), "scale_factor": 0.5}, {0, 1, 2, 3}),
        ({"valid_max": np.int16(1000), "valid_min": np.int16(-8)}, {0, 2}),
    )
    for number, (attributes, hidden) in enumerate(cases):
        path = tmp_path / f"{number}.h5"
        with h5py.File(path, "w") as file:
            file["sea"] = samples
            file["sea"].attrs.update(attributes)
        image = as_image(path, scale="intensity")
        assert set(np.flatnonzero(~image.mask[0]).tolist()) == hidden, attributes
        assert image.mask[1:].all()
        window = open_source(path, scale="intensity").read(Window(0, 0, 20, 20))
        assert np.array_equal(window.mask, image.mask[:20, :20])
