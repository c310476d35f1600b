"""Resampling against functions known everywhere, and what is allowed to count as data."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray

from featreg.errors import InputError, ParameterError
from featreg.interfaces import FailedFit, Model
from featreg.io import as_image
from featreg.products.in_memory import warp
from featreg.products.resample import TILE, resample
from featreg.results.input_image import InputImage
from featreg.results.registration import Registration
from featreg.types import FloatArray, Image, Matches

LINEAR = np.array([[0.98, 0.05, 7.3], [-0.04, 1.01, 5.6]])


class Affine(Model):
    """Just enough of a model for these tests: x -> A x + t."""

    minimum = 3

    def __init__(self, rows: NDArray[np.float64] = LINEAR) -> None:
        self.rows = rows

    @classmethod
    def from_estimate(cls, reference_xy: FloatArray, secondary_xy: FloatArray, weights: Any = None) -> Any:
        return FailedFit("not fitted here")

    def __call__(self, xy: Any) -> FloatArray:
        return np.asarray(xy @ self.rows[:, :2].T + self.rows[:, 2])

    @property
    def inverse(self) -> Model:
        linear = np.linalg.inv(self.rows[:, :2])
        return Affine(np.column_stack([linear, -linear @ self.rows[:, 2]]))

    @property
    def parameters(self) -> Mapping[str, Any]:
        return {"rows": self.rows}


def shift(dx: float, dy: float) -> Affine:
    return Affine(np.array([[1.0, 0, dx], [0, 1, dy]]))


def smooth(x: NDArray[Any], y: NDArray[Any]) -> NDArray[np.float64]:
    return np.asarray(10 + np.sin(x / 4) * np.cos(y / 5) + 0.5 * np.sin(x / 3 + y / 4))


def made(height: int = 120, width: int = 150) -> Image:
    y, x = np.mgrid[:height, :width].astype(float)
    return as_image(smooth(x, y))


def expected(model: Affine, shape: tuple[int, int]) -> NDArray[np.float64]:
    y, x = np.mgrid[: shape[0], : shape[1]]
    xy = model(np.column_stack([x.ravel(), y.ravel()]).astype(float))
    return smooth(xy[:, 0], xy[:, 1]).reshape(shape)


def registration(model: Any, status: str = "ok", image: InputImage | None = None) -> Registration:
    reason = "" if status == "ok" else "too few points"
    return Registration(Matches.empty(), {}, np.zeros(0, bool), model, status, reason, reference=image)


@pytest.mark.parametrize(("resampling", "tolerance"), [("bilinear", 0.03), ("cubic", 1.5e-3), ("lanczos", 8e-3)])
def test_an_affine_of_a_smooth_image_is_exact_to_the_kernel(resampling: str, tolerance: float) -> None:
    out = resample(made(), Affine(), (110, 130), resampling=resampling)
    assert out.mask.sum() > 0.8 * out.mask.size
    assert np.abs(out.pixels - expected(Affine(), (110, 130)))[out.mask].max() < tolerance


def test_nearest_takes_the_pixel_whose_centre_is_nearest() -> None:
    image = made()
    out = resample(image, shift(0.4, -0.4), image.shape, resampling="nearest")
    np.testing.assert_array_equal(out.pixels, image.pixels)
    out = resample(image, shift(0.6, 0), image.shape, resampling="nearest")
    np.testing.assert_array_equal(out.pixels[:, :-1], image.pixels[:, 1:])
    assert not out.mask[:, -1].any()


@pytest.mark.parametrize("resampling", ["nearest", "bilinear", "cubic", "lanczos"])
def test_whole_pixels_are_copied_up_to_the_border(resampling: str) -> None:
    image = made()
    np.testing.assert_array_equal(resample(image, shift(0, 0), image.shape, resampling=resampling).pixels, image.pixels)
    out = resample(image, shift(3 + 1e-12, -2 - 1e-12), image.shape, resampling=resampling)
    np.testing.assert_array_equal(out.pixels[2:, :-3], image.pixels[:-2, 3:])
    assert out.mask.sum() == (image.shape[0] - 2) * (image.shape[1] - 3)


@pytest.mark.parametrize(("resampling", "support"), [("nearest", 1), ("bilinear", 2), ("cubic", 4), ("lanczos", 8)])
def test_support_that_touches_an_invalid_pixel_or_the_outside_is_invalid(resampling: str, support: int) -> None:
    samples = made().pixels.copy()
    samples[60, 70] = np.nan
    out = resample(as_image(samples), shift(0.3, 0.3), samples.shape, resampling=resampling)
    inner = out.mask[40:80, 50:90]
    assert (~inner).sum() == support**2
    assert not out.pixels[~out.mask].any()
    low, high = (support - 1) // 2, support // 2
    wanted = np.zeros(samples.shape, bool)
    wanted[low : samples.shape[0] - high, low : samples.shape[1] - high] = True
    wanted[40:80, 50:90] = inner
    np.testing.assert_array_equal(out.mask, wanted)


@pytest.mark.parametrize("resampling", ["bilinear", "lanczos"])
def test_opencv_agrees_where_its_table_of_positions_is_exact(resampling: str) -> None:
    import cv2

    samples = np.random.default_rng(0).random((60, 70), dtype=np.float32)
    y, x = np.mgrid[:60, :70].astype(np.float32)
    flag = cv2.INTER_LINEAR if resampling == "bilinear" else cv2.INTER_LANCZOS4
    theirs = cv2.remap(samples, x + np.float32(5 / 32), y + np.float32(21 / 32), flag)
    ours = resample(as_image(samples), shift(5 / 32, 21 / 32), samples.shape, resampling=resampling)
    np.testing.assert_allclose(ours.pixels[ours.mask], np.maximum(theirs, 0)[ours.mask], atol=2e-5)


def test_parabolas_through_cubic_and_planes_through_bilinear() -> None:
    y, x = np.mgrid[:40, :50].astype(float)
    plane, bowl = 5 + 2 * x + 3 * y, 3 + 0.1 * x**2 + 0.2 * y**2
    where = shift(0.37, 0.81)
    out = resample(as_image(plane), where, (40, 50), resampling="bilinear")
    np.testing.assert_allclose(out.pixels[out.mask], (plane + 2 * 0.37 + 3 * 0.81)[out.mask], rtol=1e-6)
    out = resample(as_image(bowl), where, (40, 50), resampling="cubic")
    np.testing.assert_allclose(
        out.pixels[out.mask], (3 + 0.1 * (x + 0.37) ** 2 + 0.2 * (y + 0.81) ** 2)[out.mask], 1e-5
    )


def test_complex_samples_keep_their_phase() -> None:
    y, x = np.mgrid[:80, :90].astype(float)

    def signal(x: NDArray[Any], y: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(smooth(x, y) * np.exp(1j * (x / 3 - y / 4)))

    out = resample(as_image(signal(x, y)), shift(0.25, 0.6), (80, 90))
    assert out.pixels.dtype == np.complex64
    wanted = signal(x + 0.25, y + 0.6)
    assert np.abs(np.angle(out.pixels * wanted.conj())[out.mask]).max() < 8e-3  # radians
    assert np.abs(out.pixels - wanted)[out.mask].max() < 0.08


def test_a_strip_wider_than_opencv_takes_is_precise_at_its_far_end() -> None:
    image = made(24, 40000)
    move = shift(-0.37, 0.25)
    out = resample(image, move, image.shape, resampling="cubic")
    assert out.mask[8:16, 39000:39990].all()
    assert np.abs(out.pixels - expected(move, image.shape))[out.mask].max() < 1.5e-3


def test_tiles_leave_no_seam_and_there_and_back_is_the_same() -> None:
    image = made(TILE + 40, 70)
    there = resample(image, Affine(), image.shape)
    whole = expected(Affine(), image.shape)
    assert np.abs(there.pixels - whole)[there.mask].max() < 8e-3
    back = resample(there, Affine().inverse, image.shape)
    assert back.mask.sum() > 0.3 * back.mask.size
    assert np.abs(back.pixels - image.pixels)[back.mask].max() < 16e-3


def test_amplitude_never_swings_below_zero() -> None:
    samples = np.zeros((40, 40), np.float32)
    samples[20, 20] = 1000
    out = resample(as_image(samples), shift(0.4, 0.4), (40, 40))
    assert out.pixels.min() == 0
    assert out.mask.sum() == 33 * 33


def test_where_the_model_is_not_finite_or_far_away() -> None:
    def model(xy: FloatArray) -> FloatArray:
        out = xy.copy()
        out[xy[:, 0] < 10] = np.nan
        out[xy[:, 0] > 30] = 1e300
        out[xy[:, 1] < 5] = -np.inf
        return out

    out = resample(made(), model, (40, 50))
    wanted = np.zeros((40, 50), bool)
    wanted[5:, 10:31] = True
    np.testing.assert_array_equal(out.mask, wanted)


def test_an_8_bit_source_is_8_bit_after_nearest_only() -> None:
    image = as_image(np.random.default_rng(0).integers(0, 255, (40, 40), dtype=np.uint8))
    assert resample(image, shift(0, 1), (40, 40), resampling="nearest").source_dtype == "uint8"
    assert resample(image, shift(0, 1), (40, 40)).source_dtype == "float32"


def test_misuse_of_resample() -> None:
    with pytest.raises(ParameterError, match="did you mean 'bilinear'"):
        resample(made(), shift(0, 0), (10, 10), resampling="linear")
    with pytest.raises(ParameterError, match="shape must be"):
        resample(made(), shift(0, 0), (10, 0))
    with pytest.raises(InputError, match="must return"):
        resample(made(), lambda xy: xy[:-1], (10, 10))


REFERENCE = InputImage("r.tif", (110, 130))


def test_warp_puts_nan_where_there_is_no_data() -> None:
    image = made()
    out = warp(registration(Affine(), image=REFERENCE), image.pixels.copy())
    same = resample(image, Affine(), (110, 130))
    assert out.dtype == np.float32
    np.testing.assert_array_equal(np.isnan(out), ~same.mask)
    np.testing.assert_array_equal(out[same.mask], same.pixels[same.mask])
    complex_out = warp(registration(Affine(), image=REFERENCE), image.pixels * np.complex64(1j))
    assert complex_out.dtype == np.complex64
    hole = complex_out[~same.mask]
    assert np.isnan(hole.real).all()
    assert np.isnan(hole.imag).all()


def test_warp_knows_the_reference_from_like(tmp_path: Path) -> None:
    reg = registration(shift(0, 0))
    np.save(tmp_path / "ref.npy", made(30, 50).pixels)
    for like in ((30, 50), made(30, 50), np.zeros((30, 50)), tmp_path / "ref.npy"):
        np.testing.assert_array_equal(warp(reg, made(), like=like), made().pixels[:30, :50])
    # Of the reference its size alone is wanted, whichever band was matched.
    size: dict[str, Any] = {"driver": "GTiff", "width": 50, "height": 30, "count": 2, "dtype": "uint8"}
    with rasterio.open(tmp_path / "ref.tif", "w", transform=rasterio.Affine.translation(9, 9), **size):
        pass
    np.testing.assert_array_equal(warp(reg, made(), like=tmp_path / "ref.tif"), made().pixels[:30, :50])
    with pytest.raises(InputError, match="like="):
        warp(reg, made())
    with pytest.raises(InputError, match="like must be"):
        warp(reg, made(), like=(30, 50, 3))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="like must be"):
        warp(reg, made(), like=np.zeros(5))


def test_warp_without_a_model_and_with_an_untrusted_one(caplog: pytest.LogCaptureFixture) -> None:
    with pytest.raises(InputError, match=r"no model \(only 2 points\)"):
        warp(registration(FailedFit("only 2 points"), "unreliable", REFERENCE), made())
    warp(registration(shift(0, 0), "unreliable", REFERENCE), made())
    assert "unreliable (too few points)" in caplog.text
