"""Products from file to file: the same pixels as in memory, the user's own values, in windows, whole or not at all."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import featreg
from featreg.errors import CancelledError, InputError, ParameterError
from featreg.geometry import Affine
from featreg.interfaces import FailedFit
from featreg.io import as_image, write_geotiff
from featreg.products.coherence import coherence
from featreg.products.files import WINDOW
from featreg.products.lattice import OtherGrids, resized
from featreg.products.phase_ramp import PhaseRamp
from featreg.products.resample import resample
from featreg.products.warping import Product, warp_file
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.types import Geolocation, Matches
from made.rasters import write_raster

rasterio = pytest.importorskip("rasterio")
pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
PLACE = Geolocation((10.0, 0.0, 5e5, 0.0, -10.0, 6e6), "EPSG:32632")
MOVE = Affine(np.array([[0.99, 0.03, 4.3], [-0.03, 1.01, 7.6]]))
SHAPE = (300, 340)


def texture(height: int, width: int, *, seed: int = 0) -> NDArray[np.float32]:
    import cv2

    noise = np.random.default_rng(seed).normal(size=(height, width)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return np.asarray(100.0 + 300.0 * np.abs(smooth), np.float32)


def registration(
    folder: Path, model: Any = MOVE, size: tuple[int, int] = SHAPE, scale: str = "amplitude", status: str = "ok"
) -> Registration:
    paths = {"reference": folder / "ref.tif", "secondary": folder / "sec.tif"}
    images: dict[str, Any] = {role: InputImage(str(path), size, scale) for role, path in paths.items()}
    reason = "" if status == "ok" else "made up"
    return Registration(
        Matches.empty(), {}, np.zeros(0, bool), model, status, reason, provenance={"method": "m"}, **images
    )


def files(
    folder: Path, samples: NDArray[Any], *, place: Geolocation | None = PLACE, nodata: float | None = None
) -> None:
    write_geotiff(folder / "ref.tif", texture(samples.shape[0], samples.shape[1], seed=5), place)
    write_geotiff(folder / "sec.tif", samples, nodata=nodata)


def read(path: Path) -> tuple[NDArray[Any], Any]:
    with rasterio.open(path) as dataset:
        return dataset.read(), dataset.profile | {"tags": dataset.tags(), "image": dataset.tags(ns="IMAGE_STRUCTURE")}


# grid and values
@pytest.mark.parametrize("resampling", ["nearest", "bilinear", "cubic", "lanczos"])
def test_the_file_holds_what_warp_returns(tmp_path: Path, resampling: str) -> None:
    shape = (WINDOW + 70, 200)
    files(tmp_path, texture(*shape))
    reg = registration(tmp_path, size=shape)
    made = warp_file(reg, tmp_path / "sec.tif", tmp_path / "out.tif", resampling=resampling)
    assert isinstance(made, Product)
    assert (made.shape, made.dtype, made.bands, made.georeferenced) == (shape, "float32", (1,), True)
    whole = featreg.warp(reg, tmp_path / "sec.tif", resampling=resampling)
    written = read(tmp_path / "out.tif")[0][0]
    # Positions in a window are counted from its own origin: the same but for rounding, which half a pixel feels.
    same = np.isclose(written, whole, rtol=2e-5, equal_nan=True)
    assert same.all() if resampling != "nearest" else same.mean() > 0.999
    assert made.valid == pytest.approx(np.isfinite(whole).mean())


def test_it_is_a_cloud_optimised_geotiff_in_the_references_place(tmp_path: Path) -> None:
    files(tmp_path, texture(1200, 1100).astype(np.uint16), nodata=0)
    made = warp_file(registration(tmp_path, size=(1200, 1100)), tmp_path / "sec.tif", tmp_path / "out.tif")
    written, profile = read(tmp_path / "out.tif")
    assert profile["image"]["LAYOUT"] == "COG"
    assert profile["tiled"]
    assert profile["crs"].to_epsg() == 32632
    assert tuple(profile["transform"])[:6] == PLACE.transform
    assert (made.dtype, profile["dtype"], profile["nodata"], made.nodata) == ("uint16", "uint16", 0, 0)
    assert profile["tags"]["FEATREG_STATUS"] == "ok"
    with rasterio.open(tmp_path / "out.tif") as dataset:
        assert dataset.overviews(1) == [2, 4]
    valid = resample(as_image(tmp_path / "sec.tif"), MOVE, (1200, 1100)).mask
    np.testing.assert_array_equal(written[0] != 0, valid)
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize(
    "place",
    [
        Geolocation(gcps=np.array([[0, 0, 10, 50, 5], [339, 0, 11, 50, 5], [0, 299, 10, 49, 5.0]]), crs="EPSG:4326"),
        Geolocation(
            rpcs={
                "line_off": 1.0, "samp_off": 2.0, "line_scale": 3.0, "samp_scale": 4.0, "lat_off": 5.0,
                "lat_scale": 1.0, "long_off": 7.0, "long_scale": 1.0, "height_off": 9.0, "height_scale": 1.0,
                "line_num_coeff": [0.0, 0, 1] + [0.0] * 17, "line_den_coeff": [1.0] + [0.0] * 19,
                "samp_num_coeff": [0.0, 1] + [0.0] * 18, "samp_den_coeff": [1.0] + [0.0] * 19,
                "err_bias": 1.0, "err_rand": 1.0,
            }
        ),
    ],
    ids=["gcps", "rpcs"],
)  # fmt: skip
def test_rpcs_and_gcps_of_the_reference_go_along(tmp_path: Path, place: Geolocation) -> None:
    files(tmp_path, texture(*SHAPE), place=place)
    warp_file(registration(tmp_path), tmp_path / "sec.tif", tmp_path / "out.tif")
    found = as_image(tmp_path / "out.tif").geolocation
    assert found is not None
    if place.gcps is not None:
        assert found.gcps is not None
        np.testing.assert_allclose(found.gcps, place.gcps)
    else:
        assert found.rpcs is not None
        assert found.rpcs["samp_off"] == 2.0
        assert list(found.rpcs["samp_num_coeff"])[:3] == [0, 1, 0]


@pytest.mark.parametrize(
    ("dtype", "nodata", "expected"),
    [
        ("uint8", None, ("uint8", 0)), ("uint16", 7, ("uint16", 7)), ("int16", None, ("int16", -32768)),
        ("int32", 0, ("int32", 0)), ("float32", -99, ("float32", -99)), ("float64", None, ("float32", None)),
        ("uint64", None, ("float32", None)), ("float64", -1.7976931348623157e308, ("float32", None)),
    ],
)  # fmt: skip
def test_samples_keep_dtype_and_nodata(
    tmp_path: Path, dtype: str, nodata: float | None, expected: tuple[str, float | None]
) -> None:
    samples = np.clip(texture(*SHAPE) - 90, 8, 250).astype(dtype)
    files(tmp_path, samples, nodata=nodata)
    made = warp_file(registration(tmp_path, Affine(np.eye(3)[:2])), tmp_path / "sec.tif", tmp_path / "out.tif")
    written, profile = read(tmp_path / "out.tif")
    assert profile["dtype"] == made.dtype == expected[0]
    np.testing.assert_array_equal(written[0], samples.astype(expected[0]))
    assert np.isnan(profile["nodata"]) if expected[1] is None else profile["nodata"] == expected[1]


def test_a_valid_sample_never_becomes_nodata(tmp_path: Path) -> None:
    samples = np.full(SHAPE, 40, np.uint8)
    samples[100:200, 100:200] = 0  # data: the file names no value for none
    samples[150, 150] = 255
    files(tmp_path, samples)
    made = warp_file(registration(tmp_path), tmp_path / "sec.tif", tmp_path / "out.tif")
    valid = resample(as_image(tmp_path / "sec.tif"), MOVE, SHAPE).mask
    np.testing.assert_array_equal(read(tmp_path / "out.tif")[0][0] != made.nodata, valid)


@pytest.mark.parametrize("scale", ["intensity", "db"])
def test_intensity_and_decibels_come_back_as_they_were(tmp_path: Path, scale: str) -> None:
    amplitude = texture(*SHAPE)
    samples = amplitude**2 if scale == "intensity" else 20 * np.log10(amplitude) - 70
    files(tmp_path, samples.astype(np.float32))
    warp_file(registration(tmp_path, scale=scale), tmp_path / "sec.tif", tmp_path / "out.tif", resampling="cubic")
    written = read(tmp_path / "out.tif")[0][0]
    image = resample(as_image(tmp_path / "sec.tif", scale=scale), MOVE, SHAPE, resampling="cubic")
    wanted = image.pixels**2 if scale == "intensity" else 20 * np.log10(np.where(image.mask, image.pixels, 1))
    np.testing.assert_allclose(written[image.mask], wanted[image.mask], rtol=1e-4)
    assert np.isnan(written[~image.mask]).all()


def test_the_files_own_scale_and_offset_stay(tmp_path: Path) -> None:
    raw = texture(*SHAPE).astype(np.uint16)
    write_geotiff(tmp_path / "ref.tif", raw)
    path = write_raster(tmp_path / "sec.tif", raw[None], nodata=0)
    with rasterio.open(path, "r+") as dataset:
        dataset.scales, dataset.offsets = [0.5], [3.0]
    warp_file(registration(tmp_path, Affine(np.eye(3)[:2])), path, tmp_path / "out.tif")
    with rasterio.open(tmp_path / "out.tif") as dataset:
        assert (dataset.scales, dataset.offsets) == ((0.5,), (3.0,))
        np.testing.assert_array_equal(dataset.read(1), raw)


def test_bands(tmp_path: Path) -> None:
    bands = np.stack([texture(*SHAPE, seed=k) for k in (0, 1, 2)]).astype(np.uint16)
    write_geotiff(tmp_path / "ref.tif", texture(*SHAPE))
    path = write_raster(tmp_path / "sec.tif", bands, nodata=0)
    made = warp_file(registration(tmp_path), path, tmp_path / "all.tif")
    assert made.bands == (1, 2, 3)
    every = read(tmp_path / "all.tif")[0]
    assert every.shape == (3, *SHAPE)
    for number in (1, 3):
        assert warp_file(registration(tmp_path), path, tmp_path / "one.tif", band=number).bands == (number,)
        np.testing.assert_array_equal(read(tmp_path / "one.tif")[0][0], every[number - 1])
    with pytest.raises(InputError, match="has 3 bands, band 4 was asked for"):
        warp_file(registration(tmp_path), path, tmp_path / "one.tif", band=4)


def test_any_number_of_workers_gives_the_same_file(tmp_path: Path) -> None:
    files(tmp_path, texture(WINDOW + 100, WINDOW + 40).astype(np.uint16))
    reg = registration(tmp_path, size=(WINDOW + 100, WINDOW + 40))
    for workers in (1, 3):
        warp_file(reg, tmp_path / "sec.tif", tmp_path / f"{workers}.tif", workers=workers)
    np.testing.assert_array_equal(read(tmp_path / "1.tif")[0], read(tmp_path / "3.tif")[0])


def test_a_window_that_shows_much_of_the_secondary_is_read_in_parts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files(tmp_path, texture(*SHAPE).astype(np.uint16))
    warp_file(registration(tmp_path), tmp_path / "sec.tif", tmp_path / "a.tif")
    monkeypatch.setattr("featreg.products.rendering.MOST_READ", 5000)
    warp_file(registration(tmp_path), tmp_path / "sec.tif", tmp_path / "b.tif")
    a, b = (read(tmp_path / name)[0].astype(int) for name in ("a.tif", "b.tif"))
    assert np.abs(a - b).max() <= 1


def test_beyond_the_width_that_opencv_takes(tmp_path: Path) -> None:
    wide = np.tile(texture(40, 1000), (1, 34)).astype(np.uint16)
    wide[:, 33500] = 1000
    files(tmp_path, wide)
    reg = registration(tmp_path, Affine(np.array([[1.0, 0, 5], [0, 1, 2]])), wide.shape)
    warp_file(reg, tmp_path / "sec.tif", tmp_path / "out.tif")
    written = read(tmp_path / "out.tif")[0][0]
    np.testing.assert_array_equal(written[:-2, :-5], wide[2:, 5:])


@pytest.mark.parametrize("factor", [2, 3])
def test_one_fit_serves_a_file_with_smaller_pixels(tmp_path: Path, factor: int, caplog: Any) -> None:
    files(tmp_path, texture(*SHAPE))
    reg = registration(tmp_path)
    whole = featreg.warp(reg, tmp_path / "sec.tif", resampling="bilinear")
    fine = np.kron(read(tmp_path / "sec.tif")[0][0], np.ones((factor, factor), np.float32))
    write_geotiff(tmp_path / "fine.tif", fine)
    warp_file(reg, tmp_path / "fine.tif", tmp_path / "out.tif", resampling="bilinear")
    assert f"{factor} times as many pixels" in caplog.text
    out = read(tmp_path / "out.tif")[0][0]
    both = np.isfinite(out) & np.isfinite(whole)

    # Blocks of equal pixels: no shift between the two, only less smoothing.
    def mean_shift(axis: int) -> float:
        slope = np.gradient(whole, axis=axis)
        good = both & np.isfinite(slope)
        return float((slope[good] * (out - whole)[good]).sum() / (slope[good] ** 2).sum())

    assert abs(mean_shift(0)) < 0.02
    assert abs(mean_shift(1)) < 0.02
    stated = warp_file(reg, tmp_path / "fine.tif", tmp_path / "b.tif", secondary_scale=factor, resampling="bilinear")
    np.testing.assert_array_equal(read(tmp_path / "b.tif")[0][0], out)
    assert stated.shape == SHAPE


def test_georeferencing_tells_the_pixel_size_and_the_corner(tmp_path: Path) -> None:
    samples = texture(*SHAPE)
    write_geotiff(tmp_path / "ref.tif", samples)
    write_geotiff(tmp_path / "sec.tif", samples, PLACE)
    a, b, c, d, e, f = (10.0, 0.0, 5e5, 0.0, -10.0, 6e6)
    write_geotiff(tmp_path / "part.tif", samples[40:, 25:], Geolocation((a, b, c + 250, d, e, f - 400), PLACE.crs))
    reg = registration(tmp_path)
    warp_file(reg, tmp_path / "part.tif", tmp_path / "part_out.tif")
    warp_file(reg, tmp_path / "sec.tif", tmp_path / "out.tif")
    part, whole = (read(tmp_path / name)[0][0] for name in ("part_out.tif", "out.tif"))
    both = np.isfinite(part)
    assert both.mean() > 0.6
    np.testing.assert_allclose(part[both], whole[both], rtol=1e-5)


def test_a_reference_with_other_pixels_is_a_grid_too(tmp_path: Path) -> None:
    files(tmp_path, texture(*SHAPE))
    write_geotiff(tmp_path / "half.tif", texture(SHAPE[0] // 2, SHAPE[1] // 2))
    made = warp_file(registration(tmp_path), tmp_path / "sec.tif", tmp_path / "o.tif", like=tmp_path / "half.tif")
    assert made.shape == (150, 170)
    model = OtherGrids(MOVE, resized((2, 2)), resized((1, 1)))
    wanted = resample(as_image(tmp_path / "sec.tif"), model, (150, 170))
    np.testing.assert_allclose(read(tmp_path / "o.tif")[0][0][wanted.mask], wanted.pixels[wanted.mask], rtol=1e-5)


# complex samples
def test_a_complex_file_keeps_its_phase(tmp_path: Path, band_limited: Callable[..., NDArray[np.complex64]]) -> None:
    samples = band_limited(200, 0)
    quantised = (samples / np.abs(samples).max() * 3000).round().astype(np.complex64)
    write_geotiff(tmp_path / "ref.tif", quantised)
    write_raster(tmp_path / "sec.tif", quantised[None], dtype="complex_int16")
    made = warp_file(registration(tmp_path, size=(200, 200)), tmp_path / "sec.tif", tmp_path / "out.tif")
    assert (made.dtype, made.nodata) == ("complex64", None)
    written = read(tmp_path / "out.tif")[0][0]
    wanted = resample(as_image(quantised), MOVE, (200, 200))
    np.testing.assert_allclose(written[wanted.mask], wanted.pixels[wanted.mask], atol=0.05)
    assert np.isnan(written[~wanted.mask]).all()
    np.testing.assert_array_equal(as_image(tmp_path / "out.tif").mask, wanted.mask)


def test_deramping_keeps_the_coherence_of_a_chirp(
    tmp_path: Path, band_limited: Callable[..., NDArray[np.complex64]]
) -> None:
    side, dx, dy = 384, 0.4, 0.5
    f = np.fft.fftfreq(side)
    plain = band_limited(side, 1)
    shifted = np.fft.ifft2(np.fft.fft2(plain) * np.exp(2j * np.pi * (f * dx + f[:, None] * dy)))
    y, x = np.mgrid[:side, :side]
    # The reference is the continuous scene, ramp and all, at (x + dx, y + dy): what the aligned image must be.
    centre = np.array([(side - 1) / 2] * 2)
    ramp = PhaseRamp(
        np.array([-30.0, 50, 0, 8, 16 * side / 384 * 100, 0, 0, 0, 0]), tuple(centre), side / 2, (1, 1), (1, 1)
    )
    write_geotiff(tmp_path / "sec.tif", plain * ramp.factor(x, y, 1))
    write_geotiff(tmp_path / "ref.tif", (shifted * ramp.factor(x + dx, y + dy, 1)).astype(np.complex64))
    reg = registration(tmp_path, Affine(np.array([[1, 0, dx], [0, 1, dy]])), (side, side))
    got = {
        way: warp_file(
            reg, tmp_path / "sec.tif", tmp_path / "o.tif", deramp=way, coherence=tmp_path / "c.tif", workers=2
        )
        for way in (False, True)
    }
    without, with_it, found = got[False].coherence, got[True].coherence, got[True].ramp
    assert without is not None
    assert with_it is not None
    assert isinstance(found, PhaseRamp)
    assert without < 0.97
    assert with_it > 0.995
    assert min(found.concentration) > 0.95
    assert found.coefficients[4] == pytest.approx(ramp.coefficients[4], abs=10)
    values = read(tmp_path / "c.tif")[0][0]
    assert np.nanmean(values) == pytest.approx(with_it, abs=1e-6)


@pytest.mark.realdata
def test_a_round_trip_of_a_real_tops_burst(realdata: Path, tmp_path: Path) -> None:
    source = realdata / "slc" / "sentinel1_iw3_vv_slc.tif"
    if not source.is_file():
        pytest.skip(f"no {source}")
    image = as_image(source)
    there, back = (Affine(np.array([[1, 0, s * 0.3], [0, 1, s * 0.5]])) for s in (1, -1))
    figures = {}
    for deramp in (False, True):
        reg = registration(tmp_path, there, image.shape)
        warp_file(reg, source, tmp_path / "there.tif", like=image.shape, deramp=deramp)
        reg = registration(tmp_path, back, image.shape)
        warp_file(reg, tmp_path / "there.tif", tmp_path / "back.tif", like=image.shape, deramp=deramp)
        found = coherence(image, read(tmp_path / "back.tif")[0][0], window=9)
        figures[deramp] = float(np.nanmean(found))
    assert figures[True] > 0.996
    assert figures[False] < 0.96


# what a user gets wrong
def test_misuse_leaves_nothing_behind(tmp_path: Path) -> None:
    files(tmp_path, texture(*SHAPE))
    reg, sec, out = registration(tmp_path), tmp_path / "sec.tif", tmp_path / "out.tif"
    write_geotiff(tmp_path / "small.tif", texture(40, 60))
    cases: list[tuple[Any, dict[str, Any], str]] = [
        (InputError, {"secondary": tmp_path / "none.tif"}, "no such file"),
        (InputError, {"secondary": tmp_path / "small.tif"}, "60 x 40 pixels, but the secondary of the result was 340"),
        (InputError, {"like": tmp_path / "small.tif"}, "60 x 40 pixels, but the reference of the result was 340 x 300"),
        (InputError, {"output": sec}, "would replace an input"),
        (InputError, {"output": tmp_path / "ref.tif"}, "would replace an input"),
        (InputError, {"output": tmp_path / "none" / "o.tif"}, "existing, writable folder"),
        (InputError, {"output": tmp_path}, "is a directory"),
        (ParameterError, {"resampling": "linear"}, "'bilinear'"),
        (ParameterError, {"deramp": True}, "need complex ones"),
        (ParameterError, {"coherence": tmp_path / "c.tif"}, "need complex ones"),
        (ParameterError, {"secondary_scale": -1.0}, "must be > 0"),
        (ParameterError, {"secondary_scale": (1.0, 2.0, 3.0)}, "one number or two"),
        (InputError, {"like": (0, 340)}, r"its \(H, W\)"),
        (ParameterError, {"coherence_window": (3,)}, "odd number"),
        (ParameterError, {"coherence_window": 2.5}, "odd number"),
        (InputError, {"registration": registration(tmp_path, FailedFit("2 points"))}, r"no model \(2 points\)"),
    ]
    before = read(sec)[0]
    for error, change, words in cases:
        given: dict[str, Any] = {"registration": reg, "secondary": sec, "output": out} | change
        with pytest.raises(error, match=words):
            warp_file(**given)
    assert not out.exists()
    assert not list(tmp_path.glob(".*"))
    np.testing.assert_array_equal(read(sec)[0], before)


def test_coherence_needs_a_complex_reference_at_hand(
    tmp_path: Path, band_limited: Callable[..., NDArray[np.complex64]]
) -> None:
    samples = band_limited(128, 0)
    write_geotiff(tmp_path / "sec.tif", samples)
    reg = registration(tmp_path, size=(128, 128))
    with pytest.raises(InputError, match="needs the reference image"):
        warp_file(reg, tmp_path / "sec.tif", tmp_path / "o.tif", coherence=tmp_path / "c.tif")
    write_geotiff(tmp_path / "ref.tif", np.abs(samples))
    with pytest.raises(InputError, match="the reference holds float32"):
        warp_file(reg, tmp_path / "sec.tif", tmp_path / "o.tif", coherence=tmp_path / "c.tif")
    with pytest.raises(InputError, match="also the output"):
        warp_file(reg, tmp_path / "sec.tif", tmp_path / "o.tif", coherence=tmp_path / "o.tif")


def test_coherence_is_that_of_one_band(tmp_path: Path, band_limited: Callable[..., NDArray[np.complex64]]) -> None:
    samples = band_limited(128, 0)
    write_raster(tmp_path / "sec.tif", np.stack([samples, 2 * samples]))
    write_geotiff(tmp_path / "ref.tif", samples)
    reg, out = registration(tmp_path, Affine(np.eye(3)[:2]), (128, 128)), tmp_path / "o.tif"
    with pytest.raises(ParameterError, match="has 2 bands, the coherence is that of one"):
        warp_file(reg, tmp_path / "sec.tif", out, coherence=tmp_path / "c.tif")
    made = warp_file(reg, tmp_path / "sec.tif", out, band=2, coherence=tmp_path / "c.tif")
    assert made.coherence == pytest.approx(1, abs=1e-5)


def test_the_scale_in_the_result_is_that_of_the_file_by_any_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files(tmp_path, texture(*SHAPE))
    reg = registration(tmp_path, scale="intensity")
    monkeypatch.chdir(tmp_path)
    for name in (tmp_path / "sec.tif", "sec.tif"):
        warp_file(reg, name, tmp_path / f"{str(name)[0] == '/'}.tif", resampling="bilinear")
    absolute, relative = (read(tmp_path / f"{name}.tif")[0] for name in (True, False))
    np.testing.assert_array_equal(absolute, relative)


def test_progress_and_cancel(tmp_path: Path) -> None:
    files(tmp_path, texture(40, 3 * WINDOW))
    reg = registration(tmp_path, size=(40, 3 * WINDOW))
    seen: list[tuple[int, int]] = []
    stop = threading.Event()

    def progress(done: int, total: int) -> None:
        seen.append((done, total))
        stop.set()

    with pytest.raises(CancelledError, match="after 1 of 3"):
        warp_file(reg, tmp_path / "sec.tif", tmp_path / "o.tif", progress=progress, cancel=stop)
    assert not (tmp_path / "o.tif").exists()
    warp_file(reg, tmp_path / "sec.tif", tmp_path / "o.tif", progress=lambda *n: seen.append(n))
    assert seen == [(1, 3), (1, 3), (2, 3), (3, 3)]
