"""DataArrays of xarray give what their files give, to the last bit, and are never read whole for a window."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import featreg
from featreg.errors import InputError
from featreg.io import as_image, write_geotiff
from featreg.io.raster_source import Window, open_source
from featreg.simulate import sar_pair
from featreg.types import Geolocation, Image

xr = pytest.importorskip("xarray")
rioxarray = pytest.importorskip("rioxarray")
rasterio = pytest.importorskip("rasterio")
pytestmark = [
    pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning"),
    pytest.mark.filterwarnings("ignore::PendingDeprecationWarning"),
]

PAIR = sar_pair((360, 400), rotation_deg=2, shift=(4.0, -3.0), seed=1)
PLACE = Geolocation((10.0, 0.0, 5e5, 0.0, -10.0, 6e6), "EPSG:32632")
DEGREES = Geolocation((0.00013, 0.0, 11.1234567, 0.0, -0.00009, 47.7654321), "EPSG:4326")


def file(
    folder: Path, name: str, array: Any, place: Geolocation | None = PLACE, nodata: Any = None, **more: Any
) -> Path:
    write_geotiff(folder / name, array, place, nodata=nodata)
    if more:
        with rasterio.open(folder / name, "r+") as dataset:
            for key, value in more.items():
                setattr(dataset, key, value)
    return folder / name


def same(one: Image, other: Image) -> None:
    np.testing.assert_array_equal(one.pixels, other.pixels)
    np.testing.assert_array_equal(one.mask, other.mask)
    assert one.scale == other.scale
    a, b = one.geolocation, other.geolocation
    assert (a is None) == (b is None)
    if a is not None and b is not None:
        assert a.transform == b.transform
        assert a.crs == b.crs
        assert (a.gcps is None) == (b.gcps is None)
        if a.gcps is not None and b.gcps is not None:
            np.testing.assert_allclose(a.gcps, b.gcps, atol=1e-12)


GCPS = np.array([[0.0, 0, 11.0, 47.0, 10.0], [60, 0, 11.1, 47.0, 20], [0, 40, 11.0, 46.9, 30], [60, 40, 11.1, 46.9, 5]])
CASES: dict[str, Any] = {
    "uint16 with nodata": (np.uint16, PLACE, 0, {}),
    "float in degrees": (np.float32, DEGREES, None, {}),
    "float with NaN": (np.float32, PLACE, float("nan"), {}),
    "complex": (np.complex64, PLACE, None, {}),
    "packed decibels": (
        np.int16, PLACE, -32768, {"scales": (0.01,), "offsets": (-5.0,), "descriptions": ("Sigma0_VV_db",)}
    ),
    "control points": (np.uint8, Geolocation(crs="EPSG:4326", gcps=GCPS), None, {}),
    "no place": (np.float32, None, None, {}),
}  # fmt: skip


def written(folder: Path, case: str) -> Path:
    dtype, place, nodata, more = CASES[case]
    rng = np.random.default_rng(0)
    values = rng.gamma(2, 60, (50, 70))
    if case == "packed decibels":
        values = values * 10 - 2000
    values = values.astype(dtype)
    if nodata is not None:
        values[:7, :9] = nodata
    return file(folder, "a.tif", values, place, nodata, **more)


@pytest.mark.parametrize("how", [{}, {"masked": True}, {"chunks": 32}], ids=["plain", "masked", "dask"])
@pytest.mark.parametrize("case", sorted(CASES))
def test_an_array_is_the_image_of_its_file(tmp_path: Path, case: str, how: dict[str, Any]) -> None:
    if case == "complex" and "masked" in how:
        pytest.skip("rioxarray masks no complex samples")
    path = written(tmp_path, case)
    with rioxarray.open_rasterio(path, **how) as array:
        same(as_image(array), as_image(path))


@pytest.mark.parametrize("case", ["uint16 with nodata", "packed decibels", "complex", "float in degrees"])
def test_windows_and_overviews_are_those_of_the_file(tmp_path: Path, case: str) -> None:
    path = written(tmp_path, case)
    with rioxarray.open_rasterio(path, chunks=32) as array:
        here, there = open_source(array), open_source(str(path))
        assert (here.shape, here.is_complex, here.known_scale) == (there.shape, there.is_complex, there.known_scale)
        for window in (Window(3, 5, 40, 30), Window(-5, -5, 20, 20), Window(60, 40, 30, 30)):
            a, b = here.read(window), there.read(window)
            np.testing.assert_array_equal(a.pixels, b.pixels)
            np.testing.assert_array_equal(a.mask, b.mask)
        np.testing.assert_array_equal(here.overview(3).pixels, there.overview(3).pixels)
        assert here.identity() == open_source(array).identity()
        assert here.identity() != open_source(array + 1 if case != "complex" else array * 2).identity()


def test_any_order_of_dimensions_and_names_of_bands() -> None:
    values = np.random.default_rng(0).gamma(2, 60, (2, 50, 70)).astype(np.float32)
    array = xr.DataArray(values, dims=("band", "y", "x"), coords={"band": ["VV", "VH"]})
    with pytest.raises(InputError, match=r"has 2 bands.*1 'VV' \(float32\), 2 'VH'"):
        as_image(array)
    for turned in (array, array.transpose("x", "band", "y"), array.expand_dims("time")):
        np.testing.assert_array_equal(as_image(turned, band="VH").pixels, values[1])
        np.testing.assert_array_equal(as_image(turned, band=1).pixels, values[0])
    iq = xr.DataArray(values, dims=("band", "y", "x"), coords={"band": ["i", "q"]})
    np.testing.assert_array_equal(as_image(iq, band="iq").pixels, values[0] + 1j * values[1])
    with pytest.raises(InputError, match="at most one of bands are needed"):
        as_image(xr.DataArray(np.zeros((2, 3, 20, 20)), dims=("time", "band", "y", "x")))


def test_a_part_lies_where_it_was_cut_from(tmp_path: Path) -> None:
    path = file(tmp_path, "a.tif", np.random.default_rng(0).gamma(2, 60, (50, 70)).astype(np.float32), DEGREES)
    assert DEGREES.transform is not None
    a, _, c, _, e, f = DEGREES.transform
    with rioxarray.open_rasterio(path) as array:
        part = as_image(array[0, 10:40, 20:60]).geolocation
        assert part is not None
        assert part.transform == (a, 0.0, c + 20 * a, 0.0, e, f + 10 * e)
        every = as_image(array[0, ::2, ::2]).geolocation
        assert every is not None
        assert every.transform is not None
        np.testing.assert_allclose(every.transform, (2 * a, 0, c - a / 2, 0, 2 * e, f - e / 2), rtol=1e-9)
        turned = as_image(array[0, ::-1]).geolocation
        assert turned is not None
        assert turned.transform is not None
        np.testing.assert_allclose(turned.transform, (a, 0, c, 0, -e, f + 50 * e), rtol=1e-9)


def test_a_window_of_dask_computes_that_window_alone() -> None:
    da = pytest.importorskip("dask.array")
    seen: list[Any] = []

    def chunk(block_info: Any = None) -> Any:
        seen.append(block_info[None]["array-location"])
        return np.random.default_rng(len(seen)).random(block_info[None]["chunk-shape"]).astype(np.float32)

    lazy = da.map_blocks(
        chunk, chunks=((1000,) * 40, (1000,) * 40), dtype=np.float32, meta=np.zeros((0, 0), np.float32)
    )
    source = open_source(xr.DataArray(lazy, dims=("y", "x")), scale="amplitude")
    assert source.shape == (40_000, 40_000)
    seen.clear()
    source.read(Window(12_300, 7_100, 600, 600))
    assert [[tuple(part) for part in where] for where in seen] == [[(7000, 8000), (12000, 13000)]]


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("pair")
    hole = PAIR.secondary.copy()
    hole[:40, :50] = np.nan
    return file(folder, "ref.tif", PAIR.reference), file(folder, "sec.tif", hole, None, float("nan"))


def test_a_match_of_arrays_is_that_of_their_files(pair: tuple[Path, Path]) -> None:
    by_file = featreg.match(*pair)
    with rioxarray.open_rasterio(pair[0]) as one, rioxarray.open_rasterio(pair[1], masked=True) as other:
        by_array = featreg.match(one, other)
        assert by_file.status == "ok"
        np.testing.assert_array_equal(by_array.matches.secondary_xy, by_file.matches.secondary_xy)
        np.testing.assert_array_equal(by_array.model.matrix, by_file.model.matrix)
        assert by_array.reference is not None
        assert by_array.reference.geolocation is not None
        assert by_array.reference.geolocation.transform == PLACE.transform

        # What lies on the reference's grid has its coordinates, place and value for no data.
        aligned = by_array.warp(other)
        assert isinstance(aligned, xr.DataArray)
        np.testing.assert_array_equal(aligned, featreg.warp(by_file, pair[1]))
        assert aligned.rio.crs.to_epsg() == 32632
        assert tuple(aligned.rio.transform())[:6] == PLACE.transform
        assert np.isnan(aligned.rio.nodata)
        assert (one.squeeze() - aligned).shape == one.shape[1:]
        assert aligned.attrs["featreg_status"] == "ok"


@pytest.mark.slow
def test_blocks_of_dask_give_the_bits_of_the_file_in_threads_and_processes(pair: tuple[Path, Path]) -> None:
    by_file = featreg.match(*pair, block=200, executor="serial")
    with rioxarray.open_rasterio(pair[0], chunks=128) as one, rioxarray.open_rasterio(pair[1], chunks=128) as other:
        for executor in ("threads", "processes"):
            by_array = featreg.match(one, other, block=200, executor=executor, workers=2)
            np.testing.assert_array_equal(by_array.matches.secondary_xy, by_file.matches.secondary_xy)
            assert by_array.status == by_file.status


def test_dask_stays_lazy_through_a_warp(pair: tuple[Path, Path]) -> None:
    registration = featreg.match(*pair)
    with rioxarray.open_rasterio(pair[1], chunks=128) as other:
        lazy = featreg.warp(registration, other)
        assert lazy.chunks is not None
        np.testing.assert_array_equal(lazy.compute(), featreg.warp(registration, pair[1]))


def test_the_accessor_registers_one_array_to_another(pair: tuple[Path, Path]) -> None:
    import featreg.xarray

    with rioxarray.open_rasterio(pair[0]) as one, rioxarray.open_rasterio(pair[1], masked=True) as other:
        aligned = other.featreg.register_to(one, resampling="bilinear")
        registration = other.featreg.registration_to(one)
        np.testing.assert_array_equal(aligned, featreg.warp(registration, pair[1], resampling="bilinear"))
        assert aligned.x.variable.identical(one.x.variable)
        assert isinstance(one.featreg.to_image(), Image)


def test_a_secondary_of_another_size_is_refused(pair: tuple[Path, Path]) -> None:
    registration = featreg.match(*pair)
    with pytest.raises(InputError, match=r"has the shape \(300, 400\), that of the result was \(360, 400\)"):
        featreg.warp(registration, PAIR.secondary[:300])


def test_xarray_is_left_alone_where_nobody_uses_it() -> None:
    code = (
        "import sys, numpy as np, featreg\n"
        "a, b = np.random.default_rng(0).gamma(1, 1, (2, 64, 64))\n"
        "featreg.match(a, b)\n"
        "found = [n for n in ('xarray', 'rioxarray', 'dask', 'h5py', 'geopandas', 'sarkit') if n in sys.modules]\n"
        "assert not found, found"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_control_points_follow_the_part_that_is_left(tmp_path: Path) -> None:
    points = np.array([[20.0, 30.0, 5.0, 50.0, 0.0], [60.0, 5.0, 5.1, 50.2, 10.0], [3.0, 50.0, 4.9, 49.9, 0.0]])
    samples = np.random.default_rng(0).gamma(1, 1, (60, 70)).astype(np.float32)
    write_geotiff(tmp_path / "a.tif", samples, Geolocation(crs="EPSG:4326", gcps=points))
    # It has no coordinates as it comes; without them nothing tells that an array was cut.
    bare = rioxarray.open_rasterio(tmp_path / "a.tif")
    counted, middles = (bare.assign_coords(y=np.arange(60) + half, x=np.arange(70) + half) for half in (0.0, 0.5))
    parts = [(bare, (0, 0)), *((whole[:, 8:40, 11:], (11, 8)) for whole in (counted, middles))]
    for part, corner in parts:
        place = as_image(part).geolocation
        assert place is not None
        assert place.gcps is not None
        assert np.allclose(place.gcps, points - [*corner, 0, 0, 0])


@pytest.mark.parametrize("attributes", [{"scale_factor": "two"}, {"add_offset": float("nan")}])
def test_attributes_that_are_no_numbers_are_named(attributes: dict[str, Any]) -> None:
    samples = np.random.default_rng(0).gamma(1, 1, (40, 40))
    with pytest.raises(InputError, match=next(iter(attributes))):
        as_image(xr.DataArray(samples, dims=("y", "x"), attrs=attributes))
    system = xr.Variable((), 0, {"GeoTransform": "1 2 three"})
    with pytest.raises(InputError, match="six numbers"):
        as_image(xr.DataArray(samples, dims=("y", "x"), coords={"spatial_ref": system}))


def test_a_valid_range_of_unpacked_samples() -> None:
    samples = np.random.default_rng(0).gamma(1, 1, (40, 40)) + 1
    samples[0, 0] = 400
    array = xr.DataArray(samples, dims=("y", "x"), attrs={"valid_range": [0, 1000]})
    array.encoding = {"scale_factor": 0.1, "dtype": "int16"}
    assert np.flatnonzero(~as_image(array).mask).tolist() == [0]
