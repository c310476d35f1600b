"""Complex products from file to file: phase, ramps and coherence."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from featreg.errors import InputError, ParameterError
from featreg.geometry import Affine
from featreg.io import as_image, write_geotiff
from featreg.products.coherence import coherence
from featreg.products.phase_ramp import PhaseRamp
from featreg.products.resample import resample
from featreg.products.warping import warp_file
from made.rasters import write_raster
from made.warped_files import MOVE, read, registration

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


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
